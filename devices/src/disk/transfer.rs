//! Moving the bytes of one request between the guest's memory and the medium.
//!
//! A call to the medium may take a minute, and the guest may take its memory back meanwhile. So the
//! medium never sees that memory: bytes are copied through a buffer, a piece at a time, and each copy is
//! made only if the memory is still lent. That costs a copy, and needs no pointer into the guest's
//! memory in a system call.

use std::io;

use vm_memory::VolatileSlice;

use super::handover::{Handover, Lease, Recalled};
use super::request::total;
use super::{Medium, PIECE_BYTES};

/// The guest's memory, as long as it is lent.
#[derive(Clone, Copy)]
pub(super) struct Guest<'a> {
    pub shared: &'a Handover,
    pub lease: &'a Lease,
}

impl Guest<'_> {
    pub fn touch<T>(&self, touch: impl FnOnce() -> T) -> Result<T, Recalled> {
        self.shared.touch(self.lease, touch)
    }
}

/// A request's bytes: where they are in the guest, and where on the medium.
pub(super) struct Transfer<'a> {
    pub buffer: &'a mut [u8],
    pub guest: Guest<'a>,
    /// On the medium, in bytes.
    pub at: u64,
    pub slices: &'a [VolatileSlice<'a>],
}

/// What of some slices has not been moved yet.
struct Rest<'a> {
    slices: &'a [VolatileSlice<'a>],
    /// Bytes of the first slice that have been moved.
    moved: usize,
}

impl Rest<'_> {
    /// Moves as many bytes as `bytes` has, by `copy`, which is given a slice of the guest's and a part
    /// of `bytes` that is as long.
    fn move_all(&mut self, bytes: usize, mut copy: impl FnMut(&VolatileSlice<'_>, usize)) {
        let mut done = 0;
        while let Some(first) = self.slices.first()
            && done < bytes
        {
            let length = (first.len() - self.moved).min(bytes - done);
            // Cannot fail: it lies within the slice.
            if let Ok(part) = first.subslice(self.moved, length) {
                copy(&part, done);
            }
            done += length;
            self.moved += length;
            if self.moved == first.len() {
                self.slices = self.slices.get(1..).unwrap_or_default();
                self.moved = 0;
            }
        }
    }
}

impl Transfer<'_> {
    /// Fills the guest's memory. The inner result is the medium's.
    pub fn read(self, medium: &mut impl Medium) -> Result<io::Result<()>, Recalled> {
        let Self { buffer, guest, mut at, slices } = self;
        let (mut left, mut rest) = (total(slices), Rest { slices, moved: 0 });
        while left > 0 {
            let piece = piece(buffer, left);
            if let Err(error) = medium.read(at, piece) {
                return Ok(Err(error));
            }
            let length = piece.len();
            guest.touch(|| {
                rest.move_all(length, |slice, from| {
                    slice.copy_from(piece.get(from..).unwrap_or_default());
                });
            })?;
            (at, left) = (at + length as u64, left - length as u64);
        }
        Ok(Ok(()))
    }

    /// Takes bytes out of the guest's memory.
    pub fn write(self, medium: &mut impl Medium) -> Result<io::Result<()>, Recalled> {
        let Self { buffer, guest, mut at, slices } = self;
        let (mut left, mut rest) = (total(slices), Rest { slices, moved: 0 });
        while left > 0 {
            let piece = piece(buffer, left);
            let length = piece.len();
            guest.touch(|| {
                rest.move_all(length, |slice, to| {
                    slice.copy_to(piece.get_mut(to..).unwrap_or_default());
                });
            })?;
            if let Err(error) = medium.write(at, piece) {
                return Ok(Err(error));
            }
            (at, left) = (at + length as u64, left - length as u64);
        }
        Ok(Ok(()))
    }
}

/// The part of the buffer that is used next.
fn piece(buffer: &mut [u8], left: u64) -> &mut [u8] {
    let length = usize::try_from(left).unwrap_or(usize::MAX).min(PIECE_BYTES).min(buffer.len());
    buffer.get_mut(..length).unwrap_or_default()
}
