//! The acceptance filter: which frames the controller keeps at all.
//!
//! Frames that the program does not want still fill the receive buffer, which has room for 64 bytes, and
//! cost a scan the accesses of reading them. The filter is a sieve for that and no more: the same
//! bits are laid over standard and extended frames alike (data sheet, section 6.4.15), so a filter
//! for one format lets those frames of the other pass whose bits happen to fit. A receiver looks
//! at [`Frame::id`](crate::Frame::id) in any case.
//!
//! The controller has one filter of 32 bits, or two of 16. Only the long one covers an extended
//! identifier. For all else both short ones are set to the same: the long one would do as well in a
//! real controller, but QEMU's (7.2, `can_sja_single_filter` in `hw/net/can/can_sja1000.c`) puts
//! three bits of the mask for standard identifiers into the wrong place there, and then even a
//! filter for everything rejects seven of eight.

use crate::frame::{ExtendedId, Id, StandardId};
use crate::registers::mode;

/// Which frames are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Filter {
    /// What the bits must be: of an extended identifier, or of a standard one twice; each
    /// left-aligned, followed by the remote bit and data.
    code: u32,
    /// Bits that may be anything.
    ignored: u32,
    /// Bits of the mode register that select the kind of filter.
    mode: u8,
}

impl Filter {
    /// All frames.
    pub const ALL: Self = Self { code: 0, ignored: u32::MAX, mode: 0 };

    /// Standard frames, data and remote, whose identifiers equal `id` in all bits that are set in
    /// `relevant`.
    #[must_use]
    pub const fn standard(id: StandardId, relevant: StandardId) -> Self {
        Self::new(twice(id), twice(relevant), 0)
    }

    /// Extended frames, data and remote, whose identifiers equal `id` in all bits that are set in
    /// `relevant`.
    #[must_use]
    pub const fn extended(id: ExtendedId, relevant: ExtendedId) -> Self {
        Self::new(id.get() << 3, relevant.get() << 3, mode::SINGLE_FILTER)
    }

    /// The narrowest filter that keeps frames with all of these identifiers: what they have in common is relevant.
    /// Without any, and with both standard and extended ones, it keeps all frames.
    #[must_use]
    pub fn for_all(mut ids: impl Iterator<Item = Id>) -> Self {
        match ids.next() {
            None => Self::ALL,
            Some(Id::Standard(code)) => {
                let common = ids.try_fold(StandardId::MAX.get(), |common, id| match id {
                    Id::Standard(id) => Some(common & !(code.get() ^ id.get())),
                    Id::Extended(_) => None,
                });
                common.map_or(Self::ALL, |c| Self::standard(code, StandardId::truncated(c)))
            }
            Some(Id::Extended(code)) => {
                let common = ids.try_fold(ExtendedId::MAX.get(), |common, id| match id {
                    Id::Extended(id) => Some(common & !(code.get() ^ id.get())),
                    Id::Standard(_) => None,
                });
                common.map_or(Self::ALL, |c| Self::extended(code, ExtendedId::truncated(c)))
            }
        }
    }

    const fn new(code: u32, relevant: u32, mode: u8) -> Self {
        Self { code: code & relevant, ignored: !relevant, mode }
    }

    /// The eight acceptance registers: code, then mask.
    pub(crate) fn registers(self) -> [u8; 8] {
        (u64::from(self.code) << 32 | u64::from(self.ignored)).to_be_bytes()
    }

    /// The mode register of a controller that operates with this filter.
    pub(crate) const fn mode(self) -> u8 {
        self.mode
    }
}

/// A standard identifier where each of the short filters has it.
const fn twice(id: StandardId) -> u32 {
    let bits = (id.get() as u32) << 5;
    bits << 16 | bits
}
