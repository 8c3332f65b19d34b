//! A region of a channel in Takt's own address space.
//!
//! A guest gets at a region through its memory slots; Takt has a mapping of its own for each end
//! that it has, read-only where the other end writes. The words of the region belong to the value
//! here, and not to the value's user for a borrowed time, since both move into the supervisor thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use takt_channel::{Load, Store};
use vm_memory::VolatileMemory;
use vm_memory::mmap::MmapRegion;

use crate::memory::{MemoryError, SharedRegion};

/// Pages that the other end writes. A clone is a second look at the same pages.
#[derive(Clone, Debug)]
pub struct Peer(Arc<MmapRegion>);

impl Peer {
    /// Maps a region to read it.
    ///
    /// # Errors
    /// See [`MemoryError`].
    pub fn map(region: &SharedRegion) -> Result<Self, MemoryError> {
        Ok(Self(Arc::new(region.map(false)?)))
    }
}

/// Pages that this end writes.
#[derive(Debug)]
pub struct Own(MmapRegion);

impl Own {
    /// Maps a region to write it.
    ///
    /// # Errors
    /// See [`MemoryError`].
    pub fn map(region: &SharedRegion) -> Result<Self, MemoryError> {
        Ok(Self(region.map(true)?))
    }
}

impl Load for Peer {
    fn words(&self) -> usize {
        self.0.size() / size_of::<u64>()
    }

    fn load(&self, word: usize) -> u64 {
        load(&self.0, word)
    }
}

impl Load for Own {
    fn words(&self) -> usize {
        self.0.size() / size_of::<u64>()
    }

    fn load(&self, word: usize) -> u64 {
        load(&self.0, word)
    }
}

impl Store for Own {
    fn store(&mut self, word: usize, value: u64) {
        if let Some(cell) = cell(&self.0, word) {
            cell.store(value, Ordering::Release);
        }
    }
}

/// Relaxed with a fence, because only that is guaranteed to work on pages mapped read-only
/// (documentation of `core::sync::atomic`).
fn load(region: &MmapRegion, word: usize) -> u64 {
    let value = cell(region, word).map_or(0, |cell| cell.load(Ordering::Relaxed));
    fence(Ordering::Acquire);
    value
}

fn cell(region: &MmapRegion, word: usize) -> Option<&AtomicU64> {
    region.get_atomic_ref(word.checked_mul(size_of::<u64>())?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_mapping_stores_the_other_loads_and_nothing_lies_outside() {
        let region = SharedRegion::new(4096).unwrap();
        let (mut own, peer) = (Own::map(&region).unwrap(), Peer::map(&region).unwrap());
        assert_eq!((own.words(), peer.words()), (512, 512));
        own.store(511, 7);
        own.store(512, 8);
        own.store(usize::MAX, 9);
        assert_eq!((peer.load(511), own.load(511)), (7, 7));
        assert_eq!((peer.load(512), peer.load(usize::MAX)), (0, 0));
    }
}
