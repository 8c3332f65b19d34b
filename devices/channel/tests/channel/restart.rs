//! An end dies after any number of stores, starts again, and the other end just goes on.

use std::cell::Cell;
use std::rc::Rc;

use takt_channel::{
    Geometry, Policy, QueuingDestination, QueuingSource, ReadError, ReceiveError,
    SamplingDestination, SamplingSource, Ticks, Tsc,
};

use crate::memory::{Mortal, Queue, Region, number_of, whole};

const MAXIMUM: usize = 20;
/// More stores than any tested life makes.
const STORES: usize = 40;
const BOTH: [Policy; 2] = [Policy::Refuse, Policy::Overwrite];

fn mortal(region: &Region, stores: usize) -> Mortal {
    Mortal { region: region.clone(), stores: Rc::new(Cell::new(stores)) }
}

#[test]
fn a_sampling_source_that_dies_anywhere_leaves_whole_messages_only() {
    for stores in 0..STORES {
        let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
        let region = Region::source(&geometry);
        let mut destination =
            SamplingDestination::open(region.clone(), &geometry, Ticks(100)).unwrap();
        let mut read = || {
            let mut buffer = [0; MAXIMUM];
            let sample = destination.read(&mut buffer, Tsc(0))?;
            Ok::<_, ReadError>(number_of(sample.bytes, sample.stamp, MAXIMUM))
        };
        let mut first = SamplingSource::open(mortal(&region, stores), &geometry).unwrap();
        (1..5).for_each(|n| first.write(&whole(n, MAXIMUM), Tsc(n)).unwrap());
        match read() {
            Ok(n) => assert!((1..5).contains(&n), "{stores}"),
            Err(error) => assert_eq!(error, ReadError::NeverWritten, "{stores}"),
        }
        let mut second = SamplingSource::open(region.clone(), &geometry).unwrap();
        assert_eq!(read(), Err(ReadError::NeverWritten), "{stores}");
        for n in 5..10 {
            second.write(&whole(n, MAXIMUM), Tsc(n)).unwrap();
            assert_eq!(read(), Ok(n), "{stores}");
        }
        assert_eq!(destination.status().counters.hostile, 0, "{stores}");
    }
}

#[test]
fn a_queuing_source_that_dies_anywhere_leaves_whole_messages_only() {
    for (policy, stores) in BOTH.into_iter().flat_map(|p| (0..STORES).map(move |s| (p, s))) {
        let queue = Queue::new(MAXIMUM as u32, 2, policy);
        let mut destination = queue.destination();
        let mut receive = || {
            let mut buffer = [0; MAXIMUM];
            let received = destination.receive(&mut buffer)?;
            Ok::<_, ReceiveError>(number_of(received.bytes, received.stamp, MAXIMUM))
        };
        let own = mortal(&queue.messages, stores);
        let peer = queue.acknowledgement.clone();
        let mut first = QueuingSource::open(own, peer, &queue.geometry).unwrap();
        // Refused once it is full; what matters is where it dies.
        let _ = (1..5).map(|n| first.send(&whole(n, MAXIMUM), Tsc(n))).last();
        match receive() {
            Ok(n) => assert!((1..5).contains(&n), "{policy:?} {stores}"),
            Err(error) => assert_eq!(error, ReceiveError::Empty, "{policy:?} {stores}"),
        }
        let mut second = queue.source();
        for n in 5..10 {
            second.send(&whole(n, MAXIMUM), Tsc(n)).unwrap();
            assert_eq!(receive(), Ok(n), "{policy:?} {stores}");
            assert_eq!(receive(), Err(ReceiveError::Empty), "{policy:?} {stores}");
        }
        assert_eq!(destination.status().counters.hostile, 0, "{policy:?} {stores}");
        assert_eq!(second.status().counters.hostile, 0, "{policy:?} {stores}");
    }
}

#[test]
fn a_source_that_restarts_does_not_wait_for_a_destination_that_is_not_there() {
    let queue = Queue::new(MAXIMUM as u32, 2, Policy::Refuse);
    queue.destination();
    for life in 0..10 {
        let mut source = queue.source();
        for n in 0..2 {
            source.send(&whole(n, MAXIMUM), Tsc(n)).unwrap();
        }
        assert_eq!(source.status().waiting, 2, "{life}");
        assert_eq!(source.status().counters.hostile, 0);
    }
}

#[test]
fn a_destination_that_dies_anywhere_does_not_stop_the_source() {
    for (policy, stores) in BOTH.into_iter().flat_map(|p| (0..12).map(move |s| (p, s))) {
        let queue = Queue::new(MAXIMUM as u32, 2, policy);
        let mut source = queue.source();
        let own = mortal(&queue.acknowledgement, stores);
        let mut first =
            QueuingDestination::open(queue.messages.clone(), own, &queue.geometry).unwrap();
        for n in 0..4 {
            // Refused when the dead one no longer takes anything.
            let _ = source.send(&whole(n, MAXIMUM), Tsc(n));
            let _ = first.receive(&mut [0; MAXIMUM]);
        }
        let mut second = queue.destination();
        for n in 5..10 {
            source.send(&whole(n, MAXIMUM), Tsc(n)).unwrap();
            let mut buffer = [0; MAXIMUM];
            let received = second.receive(&mut buffer).unwrap();
            assert_eq!(number_of(received.bytes, received.stamp, MAXIMUM), n);
        }
        assert_eq!(source.status().counters.hostile, 0, "{policy:?} {stores}");
        assert_eq!(second.status().counters.hostile, 0, "{policy:?} {stores}");
    }
}
