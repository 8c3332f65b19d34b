//! A look at a channel from outside: how full it is, and how old its newest message.
//!
//! An operator wants to see what is between two partitions without taking part in it. A third end
//! would have to open a port, and the only one that may be opened twice is the destination of a
//! sampling channel. So this is no end: it reads both regions, writes nothing, and neither side
//! can tell that it was there. What it reads is what two guests claim, and neither is believed.
//!
//! **Why the numbers fit each other.** `first` and `read` are looked at before `written` and after.
//! Honest ends only count up, so if both are the same twice, they were so at the moment at which
//! `written` was loaded, and the three are of one instant. A number that is impossible then is a
//! lie, and not the trace of a restart or of a message that was taken in between.

use core::fmt;

use crate::layout::{Geometry, Policy, offset, word};
use crate::memory::Load;
use crate::open::OpenError;
use crate::order::is_ahead;
use crate::slots::{ATTEMPTS, Claim, Fault, LIFE_MAX, Slots};
use crate::time::Tsc;

/// Somebody who can read all regions of a channel.
#[derive(Debug)]
pub struct Bystander<L> {
    source: L,
    /// That of a queuing channel.
    destination: Option<(L, Policy)>,
    depth: u64,
    slots: Slots,
}

/// What a channel looked like at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sight {
    /// Messages that the source has written since it was opened last.
    pub written: u64,
    /// Messages that wait in a queue, at most its depth; 0 in a sampling channel.
    pub waiting: u32,
    /// Messages of a queue that were overwritten, and whose loss the destination has yet to notice.
    pub overwritten: u64,
    /// When the source says that it wrote the newest message, if there is one.
    pub newest: Option<Tsc>,
}

/// Why there was nothing to be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LookError {
    /// The ends worked faster than they could be looked at.
    Unstable,
    /// One of the ends says what cannot be. Which one cannot be told.
    Hostile(Claim),
}

impl fmt::Display for LookError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unstable => f.write_str("the ends are too fast to be looked at"),
            Self::Hostile(claim) => write!(f, "an end makes an impossible claim: {claim:?}"),
        }
    }
}

impl core::error::Error for LookError {}

impl<L: Load> Bystander<L> {
    /// Stands by a sampling channel. Headers are not looked at: they are damaged by their owners
    /// and repaired at restarts, and all that is needed is in `geometry`.
    ///
    /// # Errors
    /// [`OpenError::TooSmall`], [`OpenError::NotSampling`].
    pub fn sampling(source: L, geometry: &Geometry) -> Result<Self, OpenError> {
        geometry.must_be_sampling()?;
        Self::new(source, None, geometry)
    }

    /// Stands by a queuing channel.
    ///
    /// # Errors
    /// [`OpenError::TooSmall`], [`OpenError::NotQueuing`].
    pub fn queuing(source: L, destination: L, geometry: &Geometry) -> Result<Self, OpenError> {
        let policy = geometry.queuing_policy()?;
        geometry.check_destination_length(&destination)?;
        Self::new(source, Some((destination, policy)), geometry)
    }

    fn new(
        source: L,
        destination: Option<(L, Policy)>,
        geometry: &Geometry,
    ) -> Result<Self, OpenError> {
        geometry.check_source_length(&source)?;
        let (depth, slots) = (u64::from(geometry.depth), Slots::new(geometry));
        Ok(Bystander { source, destination, depth, slots })
    }

    /// Looks. Wait-free, and without effect on the channel.
    ///
    /// # Errors
    /// See [`LookError`].
    pub fn look(&self) -> Result<Sight, LookError> {
        let mut error = LookError::Unstable;
        for _ in 0..ATTEMPTS {
            match self.glance() {
                Ok(sight) => return Ok(sight),
                Err(Fault::Overwritten) => error = LookError::Unstable,
                Err(Fault::Impossible(claim)) => error = LookError::Hostile(claim),
            }
        }
        Err(error)
    }

    fn glance(&self) -> Result<Sight, Fault> {
        let counters = || {
            let read = self.destination.as_ref().map(|(region, _)| region.load(word(offset::READ)));
            (self.source.load(word(offset::FIRST)), read)
        };
        let before = counters();
        let written = self.source.load(word(offset::WRITTEN));
        if counters() != before {
            return Err(Fault::Overwritten);
        }
        let (first, read) = before;
        let count = written.wrapping_sub(first);
        if count >= LIFE_MAX {
            return Err(Fault::Impossible(Claim::Counter));
        }
        let ahead = match read {
            None => 0,
            // The destination has not looked since the source began anew.
            Some(read) if is_ahead(first, read) => count,
            Some(read) => written.wrapping_sub(read),
        };
        let possible = match self.destination {
            Some((_, Policy::Overwrite)) => ahead < LIFE_MAX,
            Some((_, Policy::Refuse)) | None => ahead <= self.depth,
        };
        if !possible {
            return Err(Fault::Impossible(Claim::Counter));
        }
        let newest = match count {
            0 => None,
            _ => Some(self.slots.stamp(&self.source, written.wrapping_sub(1))?),
        };
        let waiting = ahead.min(self.depth);
        Ok(Sight { written: count, waiting: waiting as u32, overwritten: ahead - waiting, newest })
    }
}
