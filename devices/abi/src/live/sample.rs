//! Samples: the bytes of all watched ranges, one behind the other, as they were at the end of a window's work.
//!
//! A sample that is longer than a message comes in parts, in their order. The kernel takes all parts of a sample
//! between the same two jobs, or gives the sample up; a reader that misses a part does the same.

use super::bytes::{Reader, Writer};
use super::{Buffer, MESSAGE_BYTES};

const HEAD: usize = 48;
/// Most bytes of a part.
pub const PAYLOAD_BYTES: usize = MESSAGE_BYTES - HEAD;
/// Time that the kernel may take for a part, in ticks of the time stamp counter: 20 us at 1 GHz, 4 us at 5 GHz.
pub const STEP_TICKS: u64 = 20_000;
/// Ranges of which a part has something: a bound on the kernel's step.
pub const RANGES_EACH_PART: usize = 120;
/// Kind of its messages, among the [answers](super::Answer).
pub(super) const SAMPLE: u16 = 4;

/// What precedes the bytes of a part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SampleHead {
    /// Of the list of ranges, as in the order that has begun it.
    pub serial: u32,
    /// Number of the release of the window.
    pub cycle: u64,
    /// Its instant, of the time stamp counter.
    pub release_tsc: u64,
    /// The same as the programs see it: since the beginning of their tasks, in nanoseconds.
    pub time_ns: u64,
    /// Samples of this list that were given up before this one, for lack of time or room.
    pub missed: u32,
    /// Number of this part, from 0.
    pub part: u16,
    /// True for the last one.
    pub last: bool,
    /// Programs that were in the middle of something, a bit for each: a task waited in a call or had stopped its
    /// program, a job of a cyclic task was ended before it was complete, or the program's state was being set up.
    pub unsettled: u16,
    /// Length of the part.
    pub bytes: u16,
}

impl SampleHead {
    /// Writes a message of a part: `fill` puts the bytes into the payload.
    pub fn encode<'b>(&self, fill: impl FnOnce(&mut [u8]), to: &'b mut Buffer) -> Option<&'b [u8]> {
        let (head, payload) = to.split_at_mut_checked(HEAD)?;
        let mut to_head = Writer::new(head);
        to_head.u16(SAMPLE);
        to_head.u16(0);
        to_head.u32(self.serial);
        to_head.u64(self.cycle);
        to_head.u64(self.release_tsc);
        to_head.u64(self.time_ns);
        to_head.u32(self.missed);
        to_head.u16(self.part);
        to_head.u16(self.last.into());
        to_head.u16(self.unsettled);
        to_head.u16(self.bytes);
        to_head.u32(0);
        fill(payload.get_mut(..usize::from(self.bytes))?);
        to.get(..HEAD + usize::from(self.bytes))
    }

    /// Reads a message of a part; `None` if it is none.
    #[must_use]
    pub fn decode(message: &[u8]) -> Option<(Self, &[u8])> {
        let (head, payload) = message.split_at_checked(HEAD)?;
        let mut from = Reader(head);
        if (from.u16()?, from.u16()?) != (SAMPLE, 0) {
            return None;
        }
        let head = Self {
            serial: from.u32()?,
            cycle: from.u64()?,
            release_tsc: from.u64()?,
            time_ns: from.u64()?,
            missed: from.u32()?,
            part: from.u16()?,
            last: match from.u16()? {
                0 => false,
                1 => true,
                _ => return None,
            },
            unsettled: from.u16()?,
            bytes: from.u16()?,
        };
        let whole = from.u32()? == 0 && payload.len() == usize::from(head.bytes);
        (whole && payload.len() <= PAYLOAD_BYTES).then_some((head, payload))
    }
}

#[cfg(test)]
#[path = "sample_tests.rs"]
mod tests;
