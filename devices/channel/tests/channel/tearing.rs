//! An honest source that gets between any two looks of a reader, as often as it likes.
//!
//! Exhaustive in the place of the interruption and in the number of messages written there; the
//! models in `tests/loom.rs` also interrupt the source.

use std::cell::Cell;
use std::rc::Rc;

use takt_channel::{
    Geometry, Policy, QueuingDestination, ReadError, ReceiveError, SPARE, SamplingDestination,
    SamplingSource, Ticks, Tsc,
};

use crate::memory::{Queue, Region, Watched, number_of, whole};

const MAXIMUM: usize = 20;
/// Looks of the longest operation that meets no other.
const LOOKS: usize = 16;

#[test]
fn a_sample_is_whole_and_the_newest_wherever_the_source_interrupts() {
    for place in 0..LOOKS {
        for burst in 0..3 * u64::from(SPARE) {
            let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
            let region = Region::source(&geometry);
            let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
            let looks = Rc::new(Cell::new(0));
            let n = Rc::new(Cell::new(0));
            let (seen, written) = (looks.clone(), n.clone());
            let mut write = move |times| {
                for _ in 0..times {
                    written.set(written.get() + 1);
                    source.write(&whole(written.get(), MAXIMUM), Tsc(written.get())).unwrap();
                }
            };
            let armed = Rc::new(Cell::new(false));
            let watched = {
                let armed = armed.clone();
                Watched::new(region, move || {
                    if !armed.get() {
                        // The destination is being opened; then there is one message to read.
                        return;
                    }
                    seen.set(seen.get() + 1);
                    if seen.get() == 1 {
                        write(1);
                    }
                    if seen.get() == place + 1 {
                        write(burst);
                    }
                })
            };
            let mut destination =
                SamplingDestination::open(watched, &geometry, Ticks(1000)).unwrap();
            armed.set(true);
            let mut buffer = [0; MAXIMUM];
            let sample = destination.read(&mut buffer, Tsc(0)).unwrap();
            let got = number_of(sample.bytes, sample.stamp, MAXIMUM);
            assert!(got == 1 || got == n.get(), "{place} {burst}: {got}");
            assert_eq!(destination.status().counters.hostile, 0);
        }
    }
}

#[test]
fn a_read_that_is_lapped_every_time_is_unstable_after_a_bounded_number_of_looks() {
    let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
    let region = Region::source(&geometry);
    let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
    let looks = Rc::new(Cell::new(0));
    let seen = looks.clone();
    let watched = Watched::new(region, move || {
        seen.set(seen.get() + 1);
        for _ in 0..geometry.slots() {
            source.write(&[1; MAXIMUM], Tsc(0)).unwrap();
        }
    });
    let mut destination = SamplingDestination::open(watched, &geometry, Ticks(1)).unwrap();
    looks.set(0);
    let error = destination.read(&mut [0; MAXIMUM], Tsc(0)).unwrap_err();
    assert_eq!((error, destination.status().counters.unstable), (ReadError::Unstable, 1));
    assert!(looks.get() <= 1 + 4 * 9, "{}", looks.get());
}

#[test]
fn a_queue_that_overwrites_stays_in_order_wherever_the_source_interrupts() {
    for depth in 1..4 {
        for place in 0..LOOKS {
            for burst in 0..3 * u64::from(depth + SPARE) {
                interrupt_a_queue(depth, place, burst);
            }
        }
    }
}

/// Fills a queue, and sends `burst` messages before look number `place` of each of the following
/// operations of the destination.
fn interrupt_a_queue(depth: u32, place: usize, burst: u64) {
    let queue = Queue::new(MAXIMUM as u32, depth, Policy::Overwrite);
    let mut source = queue.source();
    let sent = Rc::new(Cell::new(0_u64));
    let looks = Rc::new(Cell::new(usize::MAX));
    let (n, seen) = (sent.clone(), looks.clone());
    let mut send = move |times| {
        for _ in 0..times {
            n.set(n.get() + 1);
            source.send(&whole(n.get(), MAXIMUM), Tsc(n.get())).unwrap();
        }
    };
    let mut at_start = true;
    let watched = Watched::new(queue.messages.clone(), move || {
        let look = seen.get();
        if look == usize::MAX {
            return;
        }
        seen.set(look + 1);
        if look == 0 && at_start {
            at_start = false;
            send(u64::from(depth));
        }
        if look == place {
            send(burst);
        }
    });
    let own = queue.acknowledgement.clone();
    let mut destination = QueuingDestination::open(watched, own, &queue.geometry).unwrap();
    let (mut last, mut received, mut overflows) = (0, 0, 0);
    for _ in 0..6 {
        looks.set(0);
        let mut buffer = [0; MAXIMUM];
        match destination.receive(&mut buffer) {
            Ok(message) => {
                let n = number_of(message.bytes, message.stamp, MAXIMUM);
                assert!(n > last, "{depth} {place} {burst}: {n} after {last}");
                assert_eq!(message.overflowed, n > last + 1, "{depth} {place} {burst}: {n}");
                overflows += u64::from(message.overflowed);
                (last, received) = (n, received + 1);
            }
            Err(error) => assert!(matches!(error, ReceiveError::Empty), "{error}"),
        }
    }
    looks.set(usize::MAX);
    let status = destination.status();
    let counters = status.counters;
    assert_eq!(counters.lost + received + u64::from(status.waiting), sent.get());
    assert_eq!((counters.hostile, counters.unstable), (0, 0));
    assert!(overflows <= counters.lost);
}
