//! The writing half of both kinds of channel: a source's own region.
//!
//! An end begins a new life by declaring void whatever an earlier life wrote (`first` becomes
//! `written`), and then counting up its epoch. Message numbers go on: were they to begin again
//! at 0, a reader could not tell an old message 5 from a new one. The counter is the only thing
//! an end believes of its own region at its start, and any value of it will do.
//!
//! An end that *attaches* continues a life instead: short-lived processes that follow each other are
//! then one source. It believes two numbers of its own region, and stores nothing. Only its own
//! partition can have damaged them; if the two contradict each other, there is no life to continue,
//! and a new one begins.

use core::fmt;

use crate::code::ReturnCode;
use crate::layout::{Geometry, offset, word};
use crate::memory::Store;
use crate::open::OpenError;
use crate::slots::{LIFE_MAX, Slots};
use crate::time::Tsc;

/// Why a message has the wrong length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LengthError {
    /// There is no message of no bytes.
    Empty,
    /// It is longer than the channel's longest; both in bytes.
    TooLong {
        /// Of this message.
        length: usize,
        /// Of the channel.
        maximum: usize,
    },
}

impl LengthError {
    /// INVALID_PARAM for an empty message, INVALID_CONFIG for one that is too long.
    #[must_use]
    pub const fn code(self) -> ReturnCode {
        match self {
            Self::Empty => ReturnCode::InvalidParam,
            Self::TooLong { .. } => ReturnCode::InvalidConfig,
        }
    }
}

impl fmt::Display for LengthError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("a message has at least one byte"),
            Self::TooLong { length, maximum } => {
                write!(f, "a message of {length} bytes, the channel takes {maximum}")
            }
        }
    }
}

impl core::error::Error for LengthError {}

/// A region of messages, seen by its writer.
#[derive(Debug)]
pub(crate) struct Outgoing<S> {
    region: S,
    slots: Slots,
    first: u64,
    next: u64,
}

impl<S: Store> Outgoing<S> {
    /// Begins a new life on the region.
    pub(crate) fn open(mut region: S, geometry: &Geometry) -> Result<Self, OpenError> {
        geometry.check_source(&region)?;
        let next = region.load(word(offset::WRITTEN));
        region.store(word(offset::FIRST), next);
        begin_epoch(&mut region);
        Ok(Outgoing { region, slots: Slots::new(geometry), first: next, next })
    }

    /// Continues the life that the region is in, or begins a new one if it cannot be in any.
    pub(crate) fn attach(region: S, geometry: &Geometry) -> Result<Self, OpenError> {
        geometry.check_source(&region)?;
        let first = region.load(word(offset::FIRST));
        let next = region.load(word(offset::WRITTEN));
        if next.wrapping_sub(first) >= LIFE_MAX {
            return Self::open(region, geometry);
        }
        Ok(Outgoing { region, slots: Slots::new(geometry), first, next })
    }

    /// The number of the first message of this life.
    pub(crate) fn first(&self) -> u64 {
        self.first
    }

    /// The number of the next message.
    pub(crate) fn next(&self) -> u64 {
        self.next
    }

    /// Longest message in bytes.
    pub(crate) fn maximum(&self) -> usize {
        self.slots.maximum()
    }

    /// Whether a message of this length can be sent.
    pub(crate) fn check_length(&self, bytes: &[u8]) -> Result<(), LengthError> {
        let (length, maximum) = (bytes.len(), self.slots.maximum());
        match length {
            0 => Err(LengthError::Empty),
            _ if length > maximum => Err(LengthError::TooLong { length, maximum }),
            _ => Ok(()),
        }
    }

    /// Writes a message whose length has been checked, and tells of it.
    pub(crate) fn publish(&mut self, bytes: &[u8], stamp: Tsc) {
        self.slots.put(&mut self.region, self.next, stamp, bytes);
        self.next = self.next.wrapping_add(1);
        self.tell();
    }

    /// Tells how many messages there are. Again when the queue is full: should a stray write of
    /// this partition have spoilt the counter, the destination would be waiting for a message and
    /// the source for room, for ever.
    pub(crate) fn tell(&mut self) {
        self.region.store(word(offset::WRITTEN), self.next);
    }
}

/// Counts up the epoch of a region, after everything else about the new life is in place.
pub(crate) fn begin_epoch(region: &mut impl Store) {
    let epoch = region.load(word(offset::EPOCH)).wrapping_add(1);
    region.store(word(offset::EPOCH), epoch);
}
