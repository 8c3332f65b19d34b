//! A peer that writes whatever it can, whenever it can, to everything that it can write.
//!
//! Before each look of the honest end the attacker may change any words of its own region. The
//! honest end must stay inside its memory (`Region` panics otherwise), never panic, end within a
//! fixed number of looks, return only messages within the bounds, count what it saw, and work
//! again at once when the peer has been replaced by an honest one.
//!
//! The seeds are fixed. `TAKT_CHANNEL_SEEDS` sets how many there are, for a longer run.

use std::cell::{Cell, RefCell};
use std::env;
use std::rc::Rc;

use takt_channel::{
    Geometry, Policy, QueuingDestination, QueuingSource, ReadError, ReceiveError,
    SamplingDestination, SamplingSource, SendError, Ticks, Tsc, offset,
};

use crate::memory::{Queue, Region, Watched};

const SEEDS: u64 = 300;
/// Operations of the honest end under each seed.
const OPERATIONS: u32 = 300;
const MAXIMUM: usize = 20;
/// Attempts of one operation, times the looks of one attempt: epoch, counters, slot, message.
const LOOKS: u32 = 4 * (1 + 3 + 4 + MAXIMUM.div_ceil(8) as u32);

fn seeds() -> std::ops::Range<u64> {
    let count = env::var("TAKT_CHANNEL_SEEDS").map_or(SEEDS, |text| text.parse().unwrap());
    0..count
}

/// SplitMix64: small, and good enough to be nasty.
#[derive(Clone)]
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }
}

struct Attacker {
    random: Random,
    region: Region,
    bytes: usize,
    slot_bytes: usize,
    /// Attacks before one look in so many.
    seldom: u64,
    looks: Rc<Cell<u32>>,
}

impl Attacker {
    fn new(seed: u64, region: Region, bytes: usize, geometry: &Geometry) -> Attacker {
        let mut random = Random(seed);
        let seldom = [1, 2, 8, 50][random.below(4) as usize];
        let slot_bytes = geometry.slot_bytes();
        Attacker { random, region, bytes, slot_bytes, seldom, looks: Rc::default() }
    }

    fn before_look(&mut self) {
        self.looks.set(self.looks.get() + 1);
        if self.random.below(self.seldom) == 0 {
            for _ in 0..1 + self.random.below(3) {
                self.attack();
            }
        }
    }

    fn attack(&mut self) {
        let slots = (self.bytes - offset::SLOT) / self.slot_bytes;
        let at = match self.random.below(10) {
            0..4 => [offset::EPOCH, offset::FIRST, offset::WRITTEN][self.random.below(3) as usize],
            4..9 if slots > 0 => {
                let slot = self.random.below(slots as u64) as usize;
                let field = [offset::SEQUENCE, offset::LENGTH, offset::STAMP, offset::PAYLOAD];
                let field = field[self.random.below(4) as usize];
                offset::SLOT + slot * self.slot_bytes + field
            }
            _ => self.random.below(self.bytes as u64 / 8) as usize * 8,
        };
        let value = self.value(at);
        self.region.poke(at, value);
    }

    /// Nonsense, limits, and what is nearly right.
    fn value(&mut self, at: usize) -> u64 {
        let near = self.random.below(8).wrapping_sub(4);
        let written = self.region.peek(offset::WRITTEN);
        match self.random.below(12) {
            0 => self.random.next(),
            1 => 0,
            2 => u64::MAX,
            3 => (1_u64 << 62).wrapping_add(near),
            4 => (1_u64 << 63).wrapping_add(near),
            5 => (MAXIMUM as u64).wrapping_add(near),
            6 | 7 => self.region.peek(at).wrapping_add(near),
            8 | 9 => written.wrapping_add(near),
            _ => written.wrapping_add(near).wrapping_mul(2),
        }
    }
}

fn shared(attacker: Attacker) -> (Rc<RefCell<Attacker>>, Rc<Cell<u32>>) {
    let looks = attacker.looks.clone();
    (Rc::new(RefCell::new(attacker)), looks)
}

/// Bytes beyond the longest message, which no reader may touch.
const CANARY: [u8; 8] = [0xa5; 8];

fn buffer() -> [u8; MAXIMUM + CANARY.len()] {
    let mut buffer = [0; MAXIMUM + CANARY.len()];
    buffer[MAXIMUM..].copy_from_slice(&CANARY);
    buffer
}

#[test]
fn a_sampling_destination_survives_a_hostile_source() {
    let (mut hostile, mut unstable, mut delivered) = (0, 0, 0);
    for seed in seeds() {
        let geometry = Geometry::sampling(MAXIMUM as u32).unwrap();
        let mut region = Region::source(&geometry);
        let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
        let bytes = geometry.source_bytes();
        let (attacker, looks) = shared(Attacker::new(seed, region.clone(), bytes, &geometry));
        let peaceful = Rc::new(Cell::new(true));
        let (evil, peace) = (attacker.clone(), peaceful.clone());
        let watched = Watched::new(region.clone(), move || {
            if !peace.get() {
                evil.borrow_mut().before_look();
            }
        });
        let mut destination = SamplingDestination::open(watched, &geometry, Ticks(10)).unwrap();
        peaceful.set(false);
        for _ in 0..OPERATIONS {
            if attacker.borrow_mut().random.below(3) == 0 {
                source.write(b"honest", Tsc(5)).unwrap();
            }
            let before = destination.status().counters;
            looks.set(0);
            let mut buffer = buffer();
            let sample = destination.read(&mut buffer, Tsc(5)).map(|s| s.bytes.len());
            assert!(looks.get() <= LOOKS, "seed {seed}: {} looks", looks.get());
            assert_eq!(buffer[MAXIMUM..], CANARY, "seed {seed}");
            let after = destination.status().counters;
            match sample {
                Ok(length) => {
                    assert!((1..=MAXIMUM).contains(&length), "seed {seed}: {length}");
                    delivered += 1;
                }
                Err(ReadError::Hostile(_)) => assert_eq!(after.hostile, before.hostile + 1),
                Err(ReadError::Unstable) => assert_eq!(after.unstable, before.unstable + 1),
                Err(error) => assert_eq!(error, ReadError::NeverWritten, "seed {seed}"),
            }
        }
        peaceful.set(true);
        geometry.format_source(&mut region).unwrap();
        let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
        let mut buffer = buffer();
        assert_eq!(destination.read(&mut buffer, Tsc(9)), Err(ReadError::NeverWritten));
        source.write(b"restored", Tsc(9)).unwrap();
        assert_eq!(destination.read(&mut buffer, Tsc(9)).unwrap().bytes, b"restored", "{seed}");
        hostile += destination.status().counters.hostile;
        unstable += destination.status().counters.unstable;
    }
    assert!(hostile > 0 && unstable > 0 && delivered > 0, "{hostile} {unstable} {delivered}");
}

#[test]
fn a_queuing_destination_survives_a_hostile_source() {
    let (mut hostile, mut delivered, mut overflowed) = (0, 0, 0);
    for seed in seeds() {
        let policy = if seed % 2 == 0 { Policy::Refuse } else { Policy::Overwrite };
        let queue = Queue::new(MAXIMUM as u32, 1 + (seed % 3) as u32, policy);
        let mut source = queue.source();
        let (geometry, mut region) = (queue.geometry, queue.messages.clone());
        let bytes = geometry.source_bytes();
        let (attacker, looks) = shared(Attacker::new(seed, region.clone(), bytes, &geometry));
        let peaceful = Rc::new(Cell::new(true));
        let (evil, peace) = (attacker.clone(), peaceful.clone());
        let watched = Watched::new(region.clone(), move || {
            if !peace.get() {
                evil.borrow_mut().before_look();
            }
        });
        let own = queue.acknowledgement.clone();
        let mut destination = QueuingDestination::open(watched, own, &geometry).unwrap();
        peaceful.set(false);
        for _ in 0..OPERATIONS {
            let action = attacker.borrow_mut().random.below(8);
            if action < 3 {
                // Refused when it is full.
                let _ = source.send(b"honest", Tsc(5));
            }
            looks.set(0);
            if action == 7 {
                destination.clear();
                assert!(looks.get() <= LOOKS, "seed {seed}: {} looks", looks.get());
                continue;
            }
            let before = counters(&mut destination, &peaceful);
            let mut buffer = buffer();
            let received = destination.receive(&mut buffer).map(|r| (r.bytes.len(), r.overflowed));
            assert!(looks.get() <= LOOKS, "seed {seed}: {} looks", looks.get());
            assert_eq!(buffer[MAXIMUM..], CANARY, "seed {seed}");
            let after = counters(&mut destination, &peaceful);
            match received {
                Ok((length, overflow)) => {
                    assert!((1..=MAXIMUM).contains(&length), "seed {seed}: {length}");
                    delivered += 1;
                    overflowed += u32::from(overflow);
                }
                Err(ReceiveError::Hostile(_)) => assert!(after.hostile > before.hostile),
                Err(ReceiveError::Unstable) => assert_eq!(after.unstable, before.unstable + 1),
                Err(error) => assert_eq!(error, ReceiveError::Empty, "seed {seed}"),
            }
        }
        peaceful.set(true);
        geometry.format_source(&mut region).unwrap();
        let mut source = queue.source();
        let mut buffer = buffer();
        // Finds the new life; nothing is waiting in it yet.
        assert!(destination.receive(&mut buffer).is_err(), "seed {seed}");
        for round in 0..10_u8 {
            source.send(&[round], Tsc(9)).unwrap();
            assert_eq!(destination.receive(&mut buffer).unwrap().bytes, [round], "seed {seed}");
        }
        hostile += destination.status().counters.hostile;
    }
    assert!(hostile > 0 && delivered > 0 && overflowed > 0, "{hostile} {delivered} {overflowed}");
}

/// The counters, read while the attacker looks away.
fn counters(
    destination: &mut QueuingDestination<Watched<impl FnMut()>, Region>,
    peaceful: &Cell<bool>,
) -> takt_channel::Counters {
    peaceful.set(true);
    let counters = destination.status().counters;
    peaceful.set(false);
    counters
}

#[test]
fn a_queuing_source_survives_a_hostile_destination() {
    let (mut hostile, mut sent, mut full) = (0, 0, 0);
    for seed in seeds() {
        let policy = if seed % 2 == 0 { Policy::Refuse } else { Policy::Overwrite };
        let depth = 1 + (seed % 3) as u32;
        let queue = Queue::new(MAXIMUM as u32, depth, policy);
        let (geometry, mut region) = (queue.geometry, queue.acknowledgement.clone());
        let bytes = geometry.destination_bytes();
        let (attacker, looks) = shared(Attacker::new(seed, region.clone(), bytes, &geometry));
        let peaceful = Rc::new(Cell::new(true));
        let (evil, peace) = (attacker.clone(), peaceful.clone());
        let watched = Watched::new(region.clone(), move || {
            if !peace.get() {
                evil.borrow_mut().before_look();
            }
        });
        let own = queue.messages.clone();
        let mut source = QueuingSource::open(own, watched, &geometry).unwrap();
        let mut honest = queue.destination();
        peaceful.set(false);
        for _ in 0..OPERATIONS {
            if attacker.borrow_mut().random.below(3) == 0 {
                // Empty now and then.
                let _ = honest.receive(&mut buffer());
            }
            looks.set(0);
            match source.send(b"message", Tsc(0)) {
                Ok(()) => sent += 1,
                Err(error) => {
                    assert_eq!((error, policy), (SendError::Full, Policy::Refuse));
                    full += 1;
                }
            }
            assert!(looks.get() <= 2, "seed {seed}: {} looks", looks.get());
            assert!(source.status().waiting <= depth, "seed {seed}");
        }
        peaceful.set(true);
        geometry.format_destination(&mut region).unwrap();
        let mut honest = queue.destination();
        let mut buffer = buffer();
        for round in 0..10_u8 {
            source.send(&[round], Tsc(9)).unwrap();
            assert_eq!(honest.receive(&mut buffer).unwrap().bytes, [round], "seed {seed}");
        }
        hostile += source.status().counters.hostile;
    }
    assert!(hostile > 0 && sent > 0 && full > 0, "{hostile} {sent} {full}");
}

/// An end whose own partition has written nonsense to the end's own region too, and that attaches
/// to it again and again while the peer goes on.
#[test]
fn ends_that_attach_survive_hostile_peers_and_their_own_damage() {
    let mut delivered = 0;
    for seed in seeds() {
        let policy = if seed % 2 == 0 { Policy::Refuse } else { Policy::Overwrite };
        let queue = Queue::new(MAXIMUM as u32, 1 + (seed % 3) as u32, policy);
        let geometry = queue.geometry;
        let (messages, acknowledgement) = (&queue.messages, &queue.acknowledgement);
        let attackers = [(messages, geometry.source_bytes()), (acknowledgement, 128)]
            .map(|(region, bytes)| shared(Attacker::new(seed, region.clone(), bytes, &geometry)));
        let watched = |region: &Region| {
            let evil = attackers.clone();
            Watched::new(region.clone(), move || {
                evil.iter().for_each(|(attacker, _)| attacker.borrow_mut().before_look());
            })
        };
        for _ in 0..OPERATIONS / 4 {
            let (mut whole, mut taken) = (messages.clone(), acknowledgement.clone());
            geometry.format_source(&mut whole).unwrap();
            geometry.format_destination(&mut taken).unwrap();
            attackers.iter().for_each(|(_, looks)| looks.set(0));
            // The attacker may have damaged the header between two looks of the check.
            if let Ok(mut source) =
                QueuingSource::attach(whole, watched(acknowledgement), &geometry)
            {
                let _ = source.send(b"message", Tsc(0));
                assert!(source.status().waiting <= 3);
            }
            geometry.format_source(&mut messages.clone()).unwrap();
            if let Ok(mut end) = QueuingDestination::attach(watched(messages), taken, &geometry) {
                let mut buffer = buffer();
                if let Ok(received) = end.receive(&mut buffer) {
                    assert!((1..=MAXIMUM).contains(&received.bytes.len()), "seed {seed}");
                    delivered += 1;
                }
                assert_eq!(buffer[MAXIMUM..], CANARY, "seed {seed}");
            }
            let looks: u32 = attackers.iter().map(|(_, looks)| looks.get()).sum();
            assert!(looks <= 4 * LOOKS, "seed {seed}: {looks} looks");
        }
        geometry.format_source(&mut messages.clone()).unwrap();
        geometry.format_destination(&mut acknowledgement.clone()).unwrap();
        let (mut source, mut destination) = (queue.source(), queue.destination());
        source.send(b"restored", Tsc(0)).unwrap();
        assert_eq!(destination.receive(&mut buffer()).unwrap().bytes, b"restored", "seed {seed}");
    }
    assert!(delivered > 0);
}
