//! Memory for tests: regions that several ends share, and that can misbehave on demand.

use std::cell::{Cell, RefCell};
use std::rc::Rc;

use takt_channel::{Geometry, Load, Policy, QueuingDestination, QueuingSource, Store};

/// A region that everybody holding a clone of it sees.
#[derive(Clone, Debug)]
pub struct Region(Rc<RefCell<Vec<u64>>>);

impl Region {
    pub fn zeroed(bytes: usize) -> Region {
        assert_eq!(bytes % 8, 0);
        Region(Rc::new(RefCell::new(vec![0; bytes / 8])))
    }

    /// The source's region of a channel, with its header.
    pub fn source(geometry: &Geometry) -> Region {
        let mut region = Region::zeroed(geometry.source_bytes());
        geometry.format_source(&mut region).unwrap();
        region
    }

    /// The destination's region of a channel, with its header.
    pub fn destination(geometry: &Geometry) -> Region {
        let mut region = Region::zeroed(geometry.destination_bytes());
        geometry.format_destination(&mut region).unwrap();
        region
    }

    /// Writes at a byte offset, as a foreign program would.
    pub fn poke(&self, offset: usize, value: u64) {
        assert_eq!(offset % 8, 0);
        self.0.borrow_mut()[offset / 8] = value;
    }

    /// All words of the region as they are now.
    pub fn snapshot(&self) -> Vec<u64> {
        self.0.borrow().clone()
    }

    pub fn peek(&self, offset: usize) -> u64 {
        assert_eq!(offset % 8, 0);
        self.0.borrow()[offset / 8]
    }
}

impl Load for Region {
    fn words(&self) -> usize {
        self.0.borrow().len()
    }

    fn load(&self, word: usize) -> u64 {
        // Stricter than real pages: no end may ever look outside.
        self.0.borrow()[word]
    }
}

impl Store for Region {
    fn store(&mut self, word: usize, value: u64) {
        self.0.borrow_mut()[word] = value;
    }
}

/// Both ends of a queuing channel and their regions.
pub struct Queue {
    pub geometry: Geometry,
    pub messages: Region,
    pub acknowledgement: Region,
}

impl Queue {
    pub fn new(maximum: u32, depth: u32, policy: Policy) -> Queue {
        let geometry = Geometry::queuing(maximum, depth, policy).unwrap();
        let messages = Region::source(&geometry);
        Queue { geometry, messages, acknowledgement: Region::destination(&geometry) }
    }

    pub fn source(&self) -> QueuingSource<Region, Region> {
        let (own, peer) = (self.messages.clone(), self.acknowledgement.clone());
        QueuingSource::open(own, peer, &self.geometry).unwrap()
    }

    pub fn destination(&self) -> QueuingDestination<Region, Region> {
        let (peer, own) = (self.messages.clone(), self.acknowledgement.clone());
        QueuingDestination::open(peer, own, &self.geometry).unwrap()
    }
}

/// A region whose owner dies: stores after the first so many do not happen.
pub struct Mortal {
    pub region: Region,
    pub stores: Rc<Cell<usize>>,
}

impl Load for Mortal {
    fn words(&self) -> usize {
        self.region.words()
    }

    fn load(&self, word: usize) -> u64 {
        self.region.load(word)
    }
}

impl Store for Mortal {
    fn store(&mut self, word: usize, value: u64) {
        if let Some(left) = self.stores.get().checked_sub(1) {
            self.stores.set(left);
            self.region.store(word, value);
        }
    }
}

/// A region in which something happens before each look.
pub struct Watched<F> {
    pub region: Region,
    pub before: RefCell<F>,
}

impl<F: FnMut()> Watched<F> {
    pub fn new(region: Region, before: F) -> Self {
        Watched { region, before: RefCell::new(before) }
    }
}

impl<F: FnMut()> Load for Watched<F> {
    fn words(&self) -> usize {
        self.region.words()
    }

    fn load(&self, word: usize) -> u64 {
        (self.before.borrow_mut())();
        self.region.load(word)
    }
}

/// A message that shows if it is torn: its stamp, its length and every byte follow from `n`.
pub fn whole(n: u64, maximum: usize) -> Vec<u8> {
    let length = 1 + (n as usize * 7) % maximum;
    vec![n as u8; length]
}

/// The `n` of a message made by [`whole`]; panics if it is torn.
pub fn number_of(bytes: &[u8], stamp: takt_channel::Tsc, maximum: usize) -> u64 {
    assert_eq!(bytes, whole(stamp.0, maximum), "torn: stamp {}", stamp.0);
    stamp.0
}
