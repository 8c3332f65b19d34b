//! What a bystander sees, that neither end notices it, and that no lie takes it in.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use takt_channel::{
    Bystander, Claim, Geometry, LookError, OpenError, Policy, SamplingSource, Sight, Tsc, offset,
};

use crate::memory::{Queue, Region, Watched};

const MAXIMUM: u32 = 20;

fn beside(queue: &Queue) -> Bystander<Region> {
    let regions = (queue.messages.clone(), queue.acknowledgement.clone());
    Bystander::queuing(regions.0, regions.1, &queue.geometry).unwrap()
}

fn sight(written: u64, waiting: u32, overwritten: u64, newest: Option<u64>) -> Sight {
    Sight { written, waiting, overwritten, newest: newest.map(Tsc) }
}

#[test]
fn a_sampling_channel_has_an_age_and_no_queue() {
    let geometry = Geometry::sampling(MAXIMUM).unwrap();
    let region = Region::source(&geometry);
    let bystander = Bystander::sampling(region.clone(), &geometry).unwrap();
    assert_eq!(bystander.look(), Ok(sight(0, 0, 0, None)));
    let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
    (1..=9).for_each(|n| source.write(b"x", Tsc(10 * n)).unwrap());
    assert_eq!(bystander.look(), Ok(sight(9, 0, 0, Some(90))));
    // A new life has written nothing yet.
    SamplingSource::open(region, &geometry).unwrap();
    assert_eq!(bystander.look(), Ok(sight(0, 0, 0, None)));
}

#[test]
fn a_queue_fills_and_empties() {
    let queue = Queue::new(MAXIMUM, 3, Policy::Refuse);
    let bystander = beside(&queue);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    for n in 1..=3 {
        source.send(b"x", Tsc(n)).unwrap();
        assert_eq!(bystander.look(), Ok(sight(n, n as u32, 0, Some(n))));
    }
    assert!(source.send(b"x", Tsc(4)).is_err());
    assert_eq!(bystander.look(), Ok(sight(3, 3, 0, Some(3))));
    destination.receive(&mut [0; MAXIMUM as usize]).unwrap();
    assert_eq!(bystander.look(), Ok(sight(3, 2, 0, Some(3))));
    // Opening either end empties the queue.
    let mut source = queue.source();
    assert_eq!(bystander.look(), Ok(sight(0, 0, 0, None)));
    source.send(b"x", Tsc(5)).unwrap();
    assert_eq!(bystander.look(), Ok(sight(1, 1, 0, Some(5))));
    queue.destination();
    assert_eq!(bystander.look(), Ok(sight(1, 0, 0, Some(5))));
}

#[test]
fn what_was_overwritten_is_told_until_the_destination_has_noticed() {
    let queue = Queue::new(MAXIMUM, 2, Policy::Overwrite);
    let bystander = beside(&queue);
    let (mut source, mut destination) = (queue.source(), queue.destination());
    (1..=7).for_each(|n| source.send(b"x", Tsc(n)).unwrap());
    assert_eq!(bystander.look(), Ok(sight(7, 2, 5, Some(7))));
    destination.receive(&mut [0; MAXIMUM as usize]).unwrap();
    assert_eq!(bystander.look(), Ok(sight(7, 1, 0, Some(7))));
}

#[test]
fn neither_end_notices_a_bystander() {
    let queue = Queue::new(MAXIMUM, 2, Policy::Overwrite);
    let mut source = queue.source();
    (1..=7).for_each(|n| source.send(b"x", Tsc(n)).unwrap());
    let before = (queue.messages.snapshot(), queue.acknowledgement.snapshot());
    beside(&queue).look().unwrap();
    assert_eq!((queue.messages.snapshot(), queue.acknowledgement.snapshot()), before);
}

#[test]
fn lies_are_called_so() {
    let far = 1 << 62;
    for policy in [Policy::Refuse, Policy::Overwrite] {
        let spoilt = |spoil: &dyn Fn(&Queue)| {
            let queue = Queue::new(MAXIMUM, 2, policy);
            let _destination = queue.destination();
            let mut source = queue.source();
            (1..=2).for_each(|n| source.send(b"x", Tsc(n)).unwrap());
            spoil(&queue);
            beside(&queue).look()
        };
        let counter = Err(LookError::Hostile(Claim::Counter));
        for written in [far, u64::MAX] {
            assert_eq!(spoilt(&|q| q.messages.poke(offset::WRITTEN, written)), counter);
        }
        assert_eq!(spoilt(&|q| q.messages.poke(offset::FIRST, 3)), counter);
        assert_eq!(spoilt(&|q| q.acknowledgement.poke(offset::READ, 3)), counter);
        let too_many = spoilt(&|q| q.messages.poke(offset::WRITTEN, 3));
        let slot = offset::SLOT + 64;
        let old = spoilt(&|q| q.messages.poke(slot + offset::SEQUENCE, 3));
        assert_eq!(old, Err(LookError::Hostile(Claim::Sequence)));
        let expected = match policy {
            Policy::Refuse => Claim::Counter,
            // One of three is overwritten; but the slot of the third is empty.
            Policy::Overwrite => Claim::Sequence,
        };
        assert_eq!(too_many, Err(LookError::Hostile(expected)));
        assert_eq!(
            spoilt(&|q| q.messages.poke(slot + offset::SEQUENCE, 100)),
            Err(LookError::Unstable)
        );
    }
}

/// Honest ends that work between any two looks are never called liars, and what is seen of them
/// could have been seen at one instant.
#[test]
fn honest_ends_may_do_anything_at_any_time() {
    for policy in [Policy::Refuse, Policy::Overwrite] {
        for place in 0..8 {
            for (what, always) in (0..10).map(|case| (case % 5, case >= 5)) {
                let queue = Queue::new(MAXIMUM, 2, policy);
                let (mut source, mut destination) = (queue.source(), queue.destination());
                (1..=2).for_each(|n| source.send(b"x", Tsc(n)).unwrap());
                let (messages, acknowledgement) = (&queue.messages, &queue.acknowledgement);
                let looks = Rc::new(Cell::new(0));
                let act = {
                    let (looks, again) = (
                        looks.clone(),
                        Queue {
                            geometry: queue.geometry,
                            messages: messages.clone(),
                            acknowledgement: acknowledgement.clone(),
                        },
                    );
                    move || {
                        looks.set(looks.get() + 1);
                        let due = looks.get() == place + 1;
                        if !(due || always && looks.get() > place) {
                            return;
                        }
                        let mut buffer = [0; MAXIMUM as usize];
                        match what {
                            0 => {
                                let _ = source.send(b"x", Tsc(9));
                            }
                            1 => {
                                let _ = destination.receive(&mut buffer);
                            }
                            2 => {
                                // A new life, which fills the queue.
                                source = again.source();
                                (0..2).for_each(|_| source.send(b"x", Tsc(9)).unwrap_or(()));
                            }
                            3 => destination = again.destination(),
                            _ => (0..9).for_each(|n| {
                                let _ = source.send(b"x", Tsc(n));
                                let _ = destination.receive(&mut buffer);
                            }),
                        }
                    }
                };
                let act: Rc<RefCell<dyn FnMut()>> = Rc::new(RefCell::new(act));
                let watched = |region: &Region| {
                    let act = act.clone();
                    Watched::new(region.clone(), move || (act.borrow_mut())())
                };
                let (source, destination) = (watched(messages), watched(acknowledgement));
                let bystander = Bystander::queuing(source, destination, &queue.geometry).unwrap();
                let sight = bystander.look();
                assert!(looks.get() > place, "{place}: never reached");
                let case = format!("{policy:?} {place} {what} {always}: {sight:?}");
                match sight {
                    Ok(sight) => {
                        assert!(sight.waiting <= 2, "{case}");
                        assert!(u64::from(sight.waiting) <= sight.written, "{case}");
                    }
                    // They may go on too fast, but one disturbance is not.
                    Err(error) => assert!(always && error == LookError::Unstable, "{case}"),
                }
            }
        }
    }
}

#[test]
fn whatever_lies_there_a_look_ends_and_stays_inside() {
    let mut state = 1u64;
    let mut random = move || {
        // Marsaglia's xorshift with the triple 13, 7, 17.
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    for round in 0..2000 {
        let policy = if round % 2 == 0 { Policy::Refuse } else { Policy::Overwrite };
        let queue = Queue::new(MAXIMUM, 2, policy);
        for at in (0..queue.geometry.source_bytes()).step_by(8) {
            queue.messages.poke(at, random() >> (random() % 64));
        }
        for at in (0..queue.geometry.destination_bytes()).step_by(8) {
            queue.acknowledgement.poke(at, random() >> (random() % 64));
        }
        if let Ok(sight) = beside(&queue).look() {
            assert!(sight.waiting <= 2, "{sight:?}");
        }
    }
}

#[test]
fn a_bystander_knows_what_it_stands_by() {
    let queuing = Geometry::queuing(MAXIMUM, 2, Policy::Refuse).unwrap();
    let sampling = Geometry::sampling(MAXIMUM).unwrap();
    let short = || Region::zeroed(64);
    let error = |made: Result<Bystander<Region>, OpenError>| made.unwrap_err();
    assert_eq!(
        error(Bystander::sampling(Region::source(&queuing), &queuing)),
        OpenError::NotSampling
    );
    let (a, b) = (Region::source(&sampling), short());
    assert_eq!(error(Bystander::queuing(a, b, &sampling)), OpenError::NotQueuing);
    assert!(matches!(error(Bystander::sampling(short(), &sampling)), OpenError::TooSmall { .. }));
    let (a, b) = (Region::source(&queuing), short());
    assert!(matches!(error(Bystander::queuing(a, b, &queuing)), OpenError::TooSmall { .. }));
}
