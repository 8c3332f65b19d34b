//! Models of both channels: every interleaving of small cases, and every value that a load may
//! return under the memory model of C11, which is weaker than that of x86-64.
//!
//! ```text
//! RUSTFLAGS="--cfg loom" cargo test -p takt-channel --test loom --release
//! ```
//!
//! Under `cfg(loom)` there is one spare slot instead of three and an operation tries twice instead
//! of four times: laps and failures then happen within few steps.

#![cfg(loom)]

use std::sync::Arc;

use loom::sync::atomic::{AtomicU64, Ordering, fence};
use loom::thread;
use takt_channel::{
    Geometry, Load, Policy, QueuingDestination, QueuingSource, ReadError, ReceiveError,
    SamplingDestination, SamplingSource, SendError, Store, Ticks, Tsc,
};

/// A region whose accesses are those of `OwnPages` and `PeerPages`, step by step. The dimensions
/// never change, so that the header is plain memory and no step of the model.
#[derive(Clone)]
struct Region {
    header: Arc<Vec<u64>>,
    rest: Arc<Vec<AtomicU64>>,
    /// Stores left before the owner dies.
    stores: usize,
}

/// Words of the header that never change.
const HEADER: usize = 8;
/// For an owner that lives on.
const FOR_EVER: usize = usize::MAX;

/// Takes down the header while it is formatted.
struct Header(Vec<u64>);

impl Load for Header {
    fn words(&self) -> usize {
        self.0.len()
    }

    fn load(&self, word: usize) -> u64 {
        self.0[word]
    }
}

impl Store for Header {
    fn store(&mut self, word: usize, value: u64) {
        self.0[word] = value;
    }
}

impl Region {
    fn source(geometry: &Geometry) -> Region {
        let mut header = Header(vec![0; geometry.source_bytes() / 8]);
        geometry.format_source(&mut header).unwrap();
        Region::new(header)
    }

    fn destination(geometry: &Geometry) -> Region {
        let mut header = Header(vec![0; geometry.destination_bytes() / 8]);
        geometry.format_destination(&mut header).unwrap();
        Region::new(header)
    }

    fn new(header: Header) -> Region {
        let rest = header.0[HEADER..].iter().map(|_| AtomicU64::new(0)).collect();
        Region { header: Arc::new(header.0), rest: Arc::new(rest), stores: FOR_EVER }
    }

    fn mortal(&self, stores: usize) -> Region {
        Region { stores, ..self.clone() }
    }
}

impl Load for Region {
    fn words(&self) -> usize {
        self.header.len()
    }

    fn load(&self, word: usize) -> u64 {
        if word < HEADER {
            return self.header[word];
        }
        let value = self.rest[word - HEADER].load(Ordering::Relaxed);
        fence(Ordering::Acquire);
        value
    }
}

impl Store for Region {
    fn store(&mut self, word: usize, value: u64) {
        if self.stores == 0 {
            return;
        }
        self.stores = self.stores.saturating_sub(usize::from(self.stores != FOR_EVER));
        self.rest[word - HEADER].store(value, Ordering::Release);
    }
}

const MAXIMUM: usize = 8;

/// Stamp, length and payload of message `n` all differ from those of any other.
fn whole(n: u64) -> Vec<u8> {
    vec![n as u8; n as usize]
}

fn number_of(bytes: &[u8], stamp: Tsc) -> u64 {
    assert_eq!(bytes, whole(stamp.0), "torn");
    stamp.0
}

fn receive(
    destination: &mut QueuingDestination<Region, Region>,
) -> Result<(u64, bool), ReceiveError> {
    let mut buffer = [0; MAXIMUM];
    let received = destination.receive(&mut buffer)?;
    Ok((number_of(received.bytes, received.stamp), received.overflowed))
}

struct Queue {
    geometry: Geometry,
    messages: Region,
    acknowledgement: Region,
}

impl Queue {
    fn new(depth: u32, policy: Policy) -> Queue {
        let geometry = Geometry::queuing(MAXIMUM as u32, depth, policy).unwrap();
        Queue {
            messages: Region::source(&geometry),
            acknowledgement: Region::destination(&geometry),
            geometry,
        }
    }

    fn source(&self, stores: usize) -> QueuingSource<Region, Region> {
        let own = self.messages.mortal(stores);
        QueuingSource::open(own, self.acknowledgement.clone(), &self.geometry).unwrap()
    }

    fn destination(&self) -> QueuingDestination<Region, Region> {
        let own = self.acknowledgement.clone();
        QueuingDestination::open(self.messages.clone(), own, &self.geometry).unwrap()
    }
}

#[test]
fn a_sample_is_whole_and_never_older_than_the_one_before() {
    loom::model(|| {
        let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
        let region = Region::source(&geometry);
        let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
        let mut destination = SamplingDestination::open(region, &geometry, Ticks(9)).unwrap();
        source.write(&whole(1), Tsc(1)).unwrap();
        let writer = thread::spawn(move || {
            // Two slots: the third message is written over the first.
            (2..=3).for_each(|n| source.write(&whole(n), Tsc(n)).unwrap());
        });
        let mut buffer = [0; MAXIMUM];
        let sample = destination.read(&mut buffer, Tsc(0)).unwrap();
        let seen = number_of(sample.bytes, sample.stamp);
        writer.join().unwrap();
        let sample = destination.read(&mut buffer, Tsc(0)).unwrap();
        assert!(seen <= 3);
        assert_eq!(number_of(sample.bytes, sample.stamp), 3);
        assert_eq!(destination.status().counters.hostile, 0);
    });
}

#[test]
fn a_sampling_source_that_dies_anywhere_and_starts_again_tears_nothing() {
    // Opening and the first message have eight stores, each further message six.
    for stores in 8..=14 {
        loom::model(move || {
            let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
            let region = Region::source(&geometry);
            let mut destination =
                SamplingDestination::open(region.clone(), &geometry, Ticks(9)).unwrap();
            let mut first = SamplingSource::open(region.mortal(stores), &geometry).unwrap();
            first.write(&whole(1), Tsc(1)).unwrap();
            let writer = thread::spawn(move || {
                first.write(&whole(2), Tsc(2)).unwrap();
                let mut second = SamplingSource::open(region, &geometry).unwrap();
                second.write(&whole(3), Tsc(3)).unwrap();
            });
            let mut buffer = [0; MAXIMUM];
            match destination.read(&mut buffer, Tsc(0)) {
                Ok(sample) => assert!(number_of(sample.bytes, sample.stamp) <= 3),
                Err(error) => {
                    assert!(matches!(error, ReadError::NeverWritten | ReadError::Unstable));
                }
            }
            writer.join().unwrap();
            let sample = destination.read(&mut buffer, Tsc(0)).unwrap();
            assert_eq!(number_of(sample.bytes, sample.stamp), 3);
            assert_eq!(destination.status().counters.hostile, 0);
        });
    }
}

#[test]
fn a_queue_that_refuses_loses_nothing_and_keeps_the_order() {
    loom::model(|| {
        let queue = Queue::new(1, Policy::Refuse);
        let (mut source, mut destination) = (queue.source(FOR_EVER), queue.destination());
        let writer = thread::spawn(move || {
            let sent = (1..=3).filter(|&n| match source.send(&whole(n), Tsc(n)) {
                Ok(()) => true,
                Err(error) => {
                    assert_eq!(error, SendError::Full);
                    false
                }
            });
            let sent: Vec<u64> = sent.collect();
            assert_eq!(source.status().counters.hostile, 0);
            sent
        });
        let mut got = Vec::new();
        let mut take = |times| {
            for _ in 0..times {
                match receive(&mut destination) {
                    Ok((n, overflowed)) => {
                        assert!(!overflowed);
                        got.push(n);
                    }
                    Err(error) => assert_eq!(error, ReceiveError::Empty),
                }
            }
        };
        take(2);
        let sent = writer.join().unwrap();
        take(1);
        assert_eq!(got, sent);
        assert_eq!(destination.status().counters.hostile, 0);
    });
}

#[test]
fn a_queue_that_overwrites_keeps_the_order_and_tells_of_every_loss() {
    loom::model(|| {
        let queue = Queue::new(1, Policy::Overwrite);
        let (mut source, mut destination) = (queue.source(FOR_EVER), queue.destination());
        source.send(&whole(1), Tsc(1)).unwrap();
        let writer = thread::spawn(move || {
            (2..=3).for_each(|n| source.send(&whole(n), Tsc(n)).unwrap());
        });
        let mut last = 0;
        let mut got = 0;
        let mut take = |destination: &mut QueuingDestination<_, _>| match receive(destination) {
            Ok((n, overflowed)) => {
                assert!(n > last);
                assert_eq!(overflowed, n > last + 1, "{n} after {last}");
                (last, got) = (n, got + 1);
            }
            Err(error) => assert!(matches!(error, ReceiveError::Empty | ReceiveError::Unstable)),
        };
        take(&mut destination);
        writer.join().unwrap();
        take(&mut destination);
        take(&mut destination);
        let counters = destination.status().counters;
        assert_eq!((last, got + counters.lost, counters.hostile), (3, 3, 0));
    });
}

#[test]
fn a_queuing_source_that_dies_anywhere_and_starts_again_tears_nothing() {
    for stores in 0..=8 {
        loom::model(move || {
            let queue = Queue::new(1, Policy::Refuse);
            let mut destination = queue.destination();
            let (messages, acknowledgement) =
                (queue.messages.clone(), queue.acknowledgement.clone());
            let writer = thread::spawn(move || {
                let queue = Queue { messages, acknowledgement, ..queue };
                let mut first = queue.source(stores);
                // Whether it gets that far is the model's business.
                let _ = first.send(&whole(1), Tsc(1));
                let mut second = queue.source(FOR_EVER);
                second.send(&whole(2), Tsc(2)).unwrap();
                assert_eq!(second.status().counters.hostile, 0);
            });
            let mut got = Vec::new();
            let mut take = |times| {
                for _ in 0..times {
                    match receive(&mut destination) {
                        Ok((n, _)) => got.push(n),
                        Err(error) => {
                            assert!(matches!(error, ReceiveError::Empty | ReceiveError::Unstable));
                        }
                    }
                }
            };
            take(1);
            writer.join().unwrap();
            take(2);
            assert!(got == [2] || got == [1, 2], "{got:?}");
            assert_eq!(destination.status().counters.hostile, 0);
        });
    }
}

#[test]
fn a_destination_that_starts_again_does_not_disturb_the_source() {
    loom::model(|| {
        let queue = Queue::new(1, Policy::Refuse);
        let mut source = queue.source(FOR_EVER);
        let mut first = queue.destination();
        source.send(&whole(1), Tsc(1)).unwrap();
        let reader = thread::spawn(move || {
            receive(&mut first).unwrap();
            let mut second = queue.destination();
            match receive(&mut second) {
                Ok((n, _)) => assert!((2..=3).contains(&n)),
                Err(error) => assert_eq!(error, ReceiveError::Empty),
            }
            assert_eq!(second.status().counters.hostile, 0);
        });
        // Refused while the destination has not taken the one before.
        let _ = (2..=3).map(|n| source.send(&whole(n), Tsc(n))).last();
        reader.join().unwrap();
        assert_eq!(source.status().counters.hostile, 0);
    });
}
