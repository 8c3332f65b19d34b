//! The ring of slots: how a message is written so that no reader ever takes half of one.
//!
//! Message `n` goes into slot `n` modulo the number of slots. The slot's sequence number is odd
//! (`2n + 1`) while it is written and even (`2n + 2`) when it is complete. A reader who wants
//! message `n` looks for `2n + 2` before it copies and again after.
//!
//! **Why a copy between two equal looks is whole.** Every load acquires and every store releases
//! (see `memory`). Suppose the copy contains a word of a later message `m` in the same slot. The
//! writer stored `2m + 1` before that word, so the reader's second look, which comes after the
//! copy, sees `2m + 1` or something later, and not `2n + 2`. Words of an earlier message are ruled
//! out by the first look in the same way.
//!
//! **Restart.** A writer that dies half-way leaves an odd number, or an even one that was not
//! published. Its next life writes the same `n` again; no reader looks for `n` before the counter of
//! written messages has passed it.
//!
//! A reader cannot hold a writer up and a writer cannot hold a reader up: a failed look is
//! returned, and the caller decides how often to try again. A lock-free queue between threads
//! would trust its indices; that is why none of them serves here.

use core::num::NonZeroU64;

use crate::layout::{Geometry, offset, word};
use crate::memory::{Load, Store};
use crate::time::Tsc;

/// How often one operation tries to copy a message. Models have fewer, so that they end.
pub(crate) const ATTEMPTS: u32 = if cfg!(loom) { 2 } else { 4 };
/// More messages than a source can write: at one each nanosecond, 146 years of them.
pub(crate) const LIFE_MAX: u64 = 1 << 62;

/// A claim in the other end's region that cannot be true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Claim {
    /// More messages than the channel can hold, or fewer than none.
    Counter,
    /// A slot that should hold a message holds an older one, or one from the future.
    Sequence,
    /// A message that is empty or longer than the longest.
    Length,
}

/// Why a message could not be copied.
pub(crate) enum Fault {
    /// The writer has begun to overwrite it.
    Overwritten,
    /// The writer says what cannot be.
    Impossible(Claim),
}

/// A copied message: its bytes are at the start of the reader's buffer.
pub(crate) struct Copied {
    pub(crate) length: usize,
    pub(crate) stamp: Tsc,
}

/// Where the slots of a region lie.
#[derive(Debug)]
pub(crate) struct Slots {
    /// Not zero by type: a remainder by it cannot panic.
    count: NonZeroU64,
    stride: usize,
    maximum: usize,
}

impl Slots {
    pub(crate) fn new(geometry: &Geometry) -> Self {
        Slots {
            count: NonZeroU64::MIN.saturating_add(u64::from(geometry.slots() - 1)),
            stride: word(geometry.slot_bytes()),
            maximum: geometry.maximum as usize,
        }
    }

    pub(crate) fn maximum(&self) -> usize {
        self.maximum
    }

    /// First word of the slot for message `n`; inside the region for every `n`.
    fn start(&self, n: u64) -> usize {
        word(offset::SLOT) + (n % self.count) as usize * self.stride
    }

    /// Writes message `n`. What `bytes` has beyond the longest message is not written.
    pub(crate) fn put(&self, region: &mut impl Store, n: u64, stamp: Tsc, bytes: &[u8]) {
        let slot = self.start(n);
        let bytes = bytes.get(..self.maximum).unwrap_or(bytes);
        region.store(slot + word(offset::SEQUENCE), complete(n).wrapping_sub(1));
        region.store(slot + word(offset::STAMP), stamp.0);
        region.store(slot + word(offset::LENGTH), bytes.len() as u64);
        region.store_bytes(slot + word(offset::PAYLOAD), bytes);
        region.store(slot + word(offset::SEQUENCE), complete(n));
    }

    /// Copies message `n` to the start of `buffer`, which has room for the longest message. After
    /// a fault the buffer may hold parts of messages.
    pub(crate) fn copy(
        &self,
        region: &impl Load,
        n: u64,
        buffer: &mut [u8],
    ) -> Result<Copied, Fault> {
        let slot = self.start(n);
        let sequence = |region: &_| Load::load(region, slot + word(offset::SEQUENCE));
        look(sequence(region), n)?;
        let stamp = Tsc(region.load(slot + word(offset::STAMP)));
        let claimed = region.load(slot + word(offset::LENGTH));
        let length = usize::try_from(claimed).unwrap_or(usize::MAX);
        if length == 0 || length > self.maximum {
            return Err(Fault::Impossible(Claim::Length));
        }
        let Some(target) = buffer.get_mut(..length) else {
            return Err(Fault::Impossible(Claim::Length));
        };
        region.load_bytes(slot + word(offset::PAYLOAD), target);
        look(sequence(region), n)?;
        Ok(Copied { length, stamp })
    }

    /// The stamp of message `n`.
    pub(crate) fn stamp(&self, region: &impl Load, n: u64) -> Result<Tsc, Fault> {
        let slot = self.start(n);
        let sequence = || region.load(slot + word(offset::SEQUENCE));
        look(sequence(), n)?;
        let stamp = Tsc(region.load(slot + word(offset::STAMP)));
        look(sequence(), n)?;
        Ok(stamp)
    }
}

/// The sequence number of a slot that holds message `n`.
const fn complete(n: u64) -> u64 {
    n.wrapping_mul(2).wrapping_add(2)
}

/// Whether a slot with this sequence number holds message `n`.
fn look(sequence: u64, n: u64) -> Result<(), Fault> {
    match sequence.wrapping_sub(complete(n)) {
        0 => Ok(()),
        ahead if ahead <= u64::MAX / 2 => Err(Fault::Overwritten),
        _ => Err(Fault::Impossible(Claim::Sequence)),
    }
}
