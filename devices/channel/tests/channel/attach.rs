//! Owners that follow each other at one end: no message is made void, and the other end does not notice.

use takt_channel::{
    Geometry, Policy, QueuingDestination, QueuingSource, ReadError, ReceiveError,
    SamplingDestination, SamplingSource, SendError, Ticks, Tsc, offset,
};

use crate::memory::{Mortal, Queue, Region, number_of, whole};

const MAXIMUM: usize = 20;
const BOTH: [Policy; 2] = [Policy::Refuse, Policy::Overwrite];

fn source(queue: &Queue) -> QueuingSource<Region, Region> {
    let (own, peer) = (queue.messages.clone(), queue.acknowledgement.clone());
    QueuingSource::attach(own, peer, &queue.geometry).unwrap()
}

fn destination(queue: &Queue) -> QueuingDestination<Region, Region> {
    let (peer, own) = (queue.messages.clone(), queue.acknowledgement.clone());
    QueuingDestination::attach(peer, own, &queue.geometry).unwrap()
}

/// What a destination that lives for one call receives, and whether an overflow was told with it.
fn receive(queue: &Queue) -> Result<(Vec<u8>, bool), ReceiveError> {
    let mut buffer = [0; MAXIMUM];
    let mut destination = destination(queue);
    destination.receive(&mut buffer).map(|r| (r.bytes.to_vec(), r.overflowed))
}

#[test]
fn messages_of_sources_that_follow_each_other_all_arrive_in_order() {
    for policy in BOTH {
        let queue = Queue::new(20, 3, policy);
        let mut last = queue.destination();
        for n in 0..20_u8 {
            source(&queue).send(&[n], Tsc(0)).unwrap();
            if n % 3 == 2 {
                for n in n - 2..=n {
                    assert_eq!(last.receive(&mut [0; MAXIMUM]).unwrap().bytes, [n]);
                }
            }
        }
        let counters = last.status().counters;
        assert_eq!((counters.peer_starts, counters.hostile, counters.lost), (0, 0, 0));
    }
}

#[test]
fn destinations_that_follow_each_other_take_each_message_once() {
    for policy in BOTH {
        let queue = Queue::new(20, 3, policy);
        let mut source = queue.source();
        for round in 0..10_u8 {
            (0..3).for_each(|n| source.send(&[round, n], Tsc(0)).unwrap());
            (0..3).for_each(|n| assert_eq!(receive(&queue), Ok((vec![round, n], false))));
            assert_eq!(receive(&queue), Err(ReceiveError::Empty));
        }
        let counters = source.status().counters;
        assert_eq!((counters.peer_starts, counters.hostile), (0, 0));
    }
}

#[test]
fn a_queue_stays_full_for_the_next_source() {
    let queue = Queue::new(20, 2, Policy::Refuse);
    (0..2).for_each(|n| source(&queue).send(&[n], Tsc(0)).unwrap());
    assert_eq!(source(&queue).send(b"x", Tsc(0)), Err(SendError::Full));
    assert_eq!(source(&queue).status().waiting, 2);
    assert_eq!(receive(&queue), Ok((vec![0], false)));
    source(&queue).send(&[2], Tsc(0)).unwrap();
    assert_eq!(receive(&queue), Ok((vec![1], false)));
    assert_eq!(receive(&queue), Ok((vec![2], false)));
}

#[test]
fn a_destination_that_was_never_open_gets_what_was_sent_before() {
    let queue = Queue::new(20, 2, Policy::Refuse);
    queue.source().send(b"early", Tsc(0)).unwrap();
    assert_eq!(receive(&queue), Ok((b"early".to_vec(), false)));
}

#[test]
fn what_an_open_made_void_stays_void() {
    for policy in BOTH {
        let queue = Queue::new(20, 2, policy);
        queue.source().send(b"void", Tsc(0)).unwrap();
        queue.source();
        assert_eq!(receive(&queue), Err(ReceiveError::Empty), "by the source");
        source(&queue).send(b"void", Tsc(0)).unwrap();
        queue.destination();
        assert_eq!(receive(&queue), Err(ReceiveError::Empty), "by the destination");
        assert_eq!(destination(&queue).status().counters.hostile, 0);
        assert_eq!(source(&queue).status().counters.hostile, 0);
    }
}

#[test]
fn an_overflow_between_two_destinations_is_told_to_the_second() {
    let queue = Queue::new(20, 2, Policy::Overwrite);
    (0..5).for_each(|n| source(&queue).send(&[n], Tsc(0)).unwrap());
    assert_eq!(receive(&queue), Ok((vec![3], true)));
    assert_eq!(receive(&queue), Ok((vec![4], false)));
}

#[test]
fn attaching_stores_nothing() {
    let queue = Queue::new(20, 2, Policy::Refuse);
    let sampling = Geometry::sampling(20).unwrap();
    let region = Region::source(&sampling);
    SamplingSource::open(region.clone(), &sampling).unwrap().write(b"x", Tsc(0)).unwrap();
    queue.destination();
    queue.source().send(b"x", Tsc(0)).unwrap();
    let all = || [&region, &queue.messages, &queue.acknowledgement].map(Region::snapshot);
    let before = all();
    source(&queue);
    destination(&queue);
    SamplingSource::attach(region.clone(), &sampling).unwrap();
    assert_eq!(all(), before);
}

#[test]
fn a_sampling_source_that_is_followed_keeps_its_message_and_its_stamp() {
    let geometry = Geometry::sampling(20).unwrap();
    let region = Region::source(&geometry);
    let attach = || SamplingDestination::attach(region.clone(), &geometry, Ticks(9)).unwrap();
    let read = |mut end: SamplingDestination<Region>| {
        end.read(&mut [0; MAXIMUM], Tsc(5)).map(|sample| (sample.bytes.to_vec(), sample.stamp))
    };
    assert_eq!(read(attach()), Err(ReadError::NeverWritten));
    let mut opened = SamplingDestination::open(region.clone(), &geometry, Ticks(9)).unwrap();
    for n in 0..10_u8 {
        let mut source = SamplingSource::attach(region.clone(), &geometry).unwrap();
        source.write(&[n], Tsc(u64::from(n))).unwrap();
        // One that only attaches sees it too, as often as it likes.
        let expected = Ok((vec![n], Tsc(u64::from(n))));
        assert_eq!(read(attach()), expected);
        assert_eq!(read(attach()), expected);
        assert_eq!(opened.read(&mut [0; MAXIMUM], Tsc(5)).unwrap().bytes, [n]);
    }
    assert_eq!(opened.status().counters.peer_starts, 0);
    SamplingSource::open(region.clone(), &geometry).unwrap();
    assert_eq!(read(attach()), Err(ReadError::NeverWritten), "the source began anew");
}

#[test]
fn a_source_that_ends_within_a_message_has_not_sent_it() {
    for (policy, stores) in BOTH.into_iter().flat_map(|p| (0..40).map(move |s| (p, s))) {
        let queue = Queue::new(MAXIMUM as u32, 2, policy);
        let (mut last, mut next) = (queue.destination(), 1);
        let mut receive = || {
            let mut buffer = [0; MAXIMUM];
            let received = last.receive(&mut buffer)?;
            Ok::<_, ReceiveError>(number_of(received.bytes, received.stamp, MAXIMUM))
        };
        let own =
            Mortal { region: queue.messages.clone(), stores: std::rc::Rc::new(stores.into()) };
        let mut first =
            QueuingSource::attach(own, queue.acknowledgement.clone(), &queue.geometry).unwrap();
        (1..=2).for_each(|n| first.send(&whole(n, MAXIMUM), Tsc(n)).unwrap());
        // Whatever it got to the end of is there, and the next owner goes on behind it.
        while let Ok(n) = receive() {
            assert_eq!(n, next, "{policy:?} {stores}");
            next += 1;
        }
        for n in 5..10 {
            source(&queue).send(&whole(n, MAXIMUM), Tsc(n)).unwrap();
            assert_eq!(receive(), Ok(n), "{policy:?} {stores}");
        }
        assert_eq!(last.status().counters.hostile, 0, "{policy:?} {stores}");
    }
}

#[test]
fn a_source_whose_own_counters_contradict_each_other_begins_anew() {
    for policy in BOTH {
        let queue = Queue::new(20, 2, policy);
        let mut destination = queue.destination();
        queue.source().send(b"void", Tsc(0)).unwrap();
        queue.messages.poke(offset::FIRST, 2);
        let epoch = queue.messages.peek(offset::EPOCH);
        let mut source = source(&queue);
        assert_eq!(queue.messages.peek(offset::EPOCH), epoch + 1);
        assert_eq!(queue.messages.peek(offset::FIRST), 1);
        assert_eq!(destination.receive(&mut [0; MAXIMUM]), Err(ReceiveError::Empty));
        source.send(b"new", Tsc(0)).unwrap();
        assert_eq!(destination.receive(&mut [0; MAXIMUM]).unwrap().bytes, b"new");
    }
    let geometry = Geometry::sampling(20).unwrap();
    let region = Region::source(&geometry);
    region.poke(offset::WRITTEN, 1 << 62);
    SamplingSource::attach(region.clone(), &geometry).unwrap();
    assert_eq!((region.peek(offset::FIRST), region.peek(offset::EPOCH)), (1 << 62, 1));
}

#[test]
fn a_destination_whose_own_counter_is_wrong_goes_on_behind_the_source() {
    for policy in BOTH {
        for read in [2, 1000, 1 << 62, u64::MAX] {
            let queue = Queue::new(20, 2, policy);
            let mut source = queue.source();
            source.send(b"1", Tsc(0)).unwrap();
            queue.acknowledgement.poke(offset::READ, read);
            // The first look corrects it, whatever it says.
            let _ = receive(&queue);
            while receive(&queue).is_ok() {}
            source.send(b"2", Tsc(0)).unwrap();
            assert_eq!(receive(&queue), Ok((b"2".to_vec(), false)), "{policy:?} {read}");
        }
    }
}

#[test]
fn attaching_checks_the_header_and_the_direction_as_opening_does() {
    let queue = Queue::new(20, 2, Policy::Refuse);
    let other = Geometry::queuing(20, 3, Policy::Refuse).unwrap();
    let sampling = Geometry::sampling(20).unwrap();
    let (m, a) = (&queue.messages, &queue.acknowledgement);
    assert!(QueuingSource::attach(m.clone(), a.clone(), &other).is_err());
    assert!(QueuingSource::attach(m.clone(), a.clone(), &sampling).is_err());
    assert!(QueuingDestination::attach(m.clone(), a.clone(), &other).is_err());
    assert!(QueuingDestination::attach(a.clone(), m.clone(), &queue.geometry).is_err());
    assert!(SamplingSource::attach(m.clone(), &sampling).is_err());
    assert!(SamplingDestination::attach(m.clone(), &sampling, Ticks(1)).is_err());
    let region = Region::source(&sampling);
    assert!(SamplingDestination::attach(region, &sampling, Ticks(0)).is_err(), "refresh period");
}
