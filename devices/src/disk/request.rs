//! One request, out of a chain of descriptors (virtio 1.2, sections 2.7 and 5.2.6).
//!
//! ```text
//!   readable: header of 16 bytes | what is to be written
//!   writable: what is to be read | status, one byte
//! ```
//!
//! Where one descriptor ends and the next begins means nothing (section 2.7.4.1), so both halves
//! are treated as strings of bytes. A chain is an allegation: the result is either pieces of memory
//! that exist, or a reason why not.

use std::ops::Deref;

use virtio_queue::DescriptorChain;
use vm_memory::{
    Bytes, GuestAddress, GuestMemory, GuestMemoryBackend, GuestMemoryMmap, VolatileSlice,
};

use super::{SEGMENT_BYTES_MAX, SEGMENTS_MAX};

/// Bytes of the header: type, reserved, sector; and of what a request to discard names: sector, number of sectors,
/// flags.
const RECORD: usize = 16;

/// The guest has left no place for an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoAnswer;

/// What a guest asks for, with a place for the answer.
pub struct Request<'a> {
    /// Which chain it came in.
    pub head: u16,
    /// Where the status goes.
    pub status: GuestAddress,
    /// The rest, if it makes sense.
    pub body: Option<Body<'a>>,
}

/// A request that makes sense so far.
pub struct Body<'a> {
    /// What to do; a number of virtio's.
    pub kind: u32,
    /// Where on the disk.
    pub sector: u64,
    /// The guest's bytes for the disk.
    pub from: Vec<VolatileSlice<'a>>,
    /// Where the guest wants the disk's bytes.
    pub into: Vec<VolatileSlice<'a>>,
}

/// A part of one of the halves.
#[derive(Clone, Copy)]
struct Piece {
    address: GuestAddress,
    bytes: u32,
}

impl<'a> Request<'a> {
    /// Takes a chain apart. `memory` is all that a guest may name.
    ///
    /// # Errors
    /// [`NoAnswer`].
    pub fn parse<M>(
        chain: DescriptorChain<M>,
        memory: &'a GuestMemoryMmap,
    ) -> Result<Self, NoAnswer>
    where
        M: Deref,
        M::Target: GuestMemory,
    {
        let head = chain.head_index();
        let (mut readable, mut writable) = (Vec::new(), Vec::new());
        let mut open = true;
        // One more than allowed, so that a longer chain is one that goes on.
        for descriptor in chain.take(SEGMENTS_MAX + 2) {
            open = descriptor.has_next();
            let piece = Piece { address: descriptor.addr(), bytes: descriptor.len() };
            match (piece.bytes, descriptor.is_write_only()) {
                (0, _) => {}
                (_, false) => readable.push(piece),
                (_, true) => writable.push(piece),
            }
        }
        // A loop, a descriptor that does not exist, or too many: whatever comes behind is unknown,
        // the status first of all.
        if open {
            return Err(NoAnswer);
        }
        let status = take_status(&mut writable).ok_or(NoAnswer)?;
        if !memory.address_in_range(status) {
            return Err(NoAnswer);
        }
        Ok(Self { head, status, body: Body::parse(&readable, &writable, memory) })
    }
}

impl<'a> Body<'a> {
    fn parse(readable: &[Piece], writable: &[Piece], memory: &'a GuestMemoryMmap) -> Option<Self> {
        let mut from = slices(readable, memory)?;
        let into = slices(writable, memory)?;
        let header = take_record(&mut from)?;
        let (kind, sector) = (header.get(..4)?, header.get(8..)?);
        Some(Self {
            kind: u32::from_le_bytes(kind.try_into().ok()?),
            sector: u64::from_le_bytes(sector.try_into().ok()?),
            from,
            into,
        })
    }

    /// What a request to discard names: the first sector, how many, and flags.
    pub fn discarded(&self) -> Option<(u64, u32, u32)> {
        let mut from = self.from.clone();
        let record = take_record(&mut from)?;
        let (sector, count, flags) = (record.get(..8)?, record.get(8..12)?, record.get(12..)?);
        let named = (
            u64::from_le_bytes(sector.try_into().ok()?),
            u32::from_le_bytes(count.try_into().ok()?),
            u32::from_le_bytes(flags.try_into().ok()?),
        );
        from.is_empty().then_some(named)
    }
}

/// Cuts the last byte off.
fn take_status(writable: &mut Vec<Piece>) -> Option<GuestAddress> {
    let last = writable.last_mut()?;
    last.bytes -= 1;
    let status = last.address.0.checked_add(last.bytes.into())?;
    if last.bytes == 0 {
        writable.pop();
    }
    Some(GuestAddress(status))
}

/// The memory that the pieces name; `None` if there is not all of it, or a piece is longer than
/// any driver was told.
fn slices<'a>(pieces: &[Piece], memory: &'a GuestMemoryMmap) -> Option<Vec<VolatileSlice<'a>>> {
    let mut slices = Vec::with_capacity(pieces.len());
    for piece in pieces {
        if piece.bytes > SEGMENT_BYTES_MAX {
            return None;
        }
        let bytes = usize::try_from(piece.bytes).ok()?;
        for slice in GuestMemoryBackend::get_slices(memory, piece.address, bytes) {
            slices.push(slice.ok()?);
        }
    }
    Some(slices)
}

/// Cuts a record off the front.
fn take_record(from: &mut Vec<VolatileSlice<'_>>) -> Option<[u8; RECORD]> {
    let mut record = [0; RECORD];
    let mut have = 0;
    while have < RECORD {
        let first = from.first_mut()?;
        let bytes = first.len().min(RECORD - have);
        first.read_slice(record.get_mut(have..have + bytes)?, 0).ok()?;
        have += bytes;
        if bytes == first.len() {
            from.remove(0);
        } else {
            *first = first.offset(bytes).ok()?;
        }
    }
    Some(record)
}

/// Bytes of all pieces together. They are bounded far below an overflow.
#[must_use]
pub fn total(slices: &[VolatileSlice<'_>]) -> u64 {
    slices.iter().map(|slice| slice.len() as u64).sum()
}
