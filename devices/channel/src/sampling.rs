//! The sampling channel: the newest message, for any number of destinations.
//!
//! The source overwrites, the destinations look; no destination writes anything, so that there may
//! be many and none can disturb another. A destination copies the newest message. Only if the source
//! completes [`SPARE`](crate::SPARE) further messages and begins one more during that copy does
//! the copy fail, and then a newer message is there to be tried: a small, fixed number of times.

use core::fmt;

use crate::code::ReturnCode;
use crate::counters::{Counters, EpochWatch, count};
use crate::layout::{Geometry, offset, word};
use crate::memory::{Load, Store};
use crate::open::OpenError;
use crate::outgoing::{LengthError, Outgoing};
use crate::slots::{ATTEMPTS, Claim, Fault, LIFE_MAX, Slots};
use crate::time::{Ticks, Tsc};

/// The end that writes.
#[derive(Debug)]
pub struct SamplingSource<S> {
    outgoing: Outgoing<S>,
}

impl<S: Store> SamplingSource<S> {
    /// Opens the source on its own region and empties the channel.
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn open(region: S, geometry: &Geometry) -> Result<Self, OpenError> {
        geometry.must_be_sampling()?;
        Ok(SamplingSource { outgoing: Outgoing::open(region, geometry)? })
    }

    /// Continues where the source's last owner left off: the message that is there stays, and no
    /// destination notices. That owner must not write any more.
    ///
    /// Counters of the own region that contradict each other, which only this partition can have
    /// caused, are as good as none: the channel is then emptied as by [`open`](Self::open).
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn attach(region: S, geometry: &Geometry) -> Result<Self, OpenError> {
        geometry.must_be_sampling()?;
        Ok(SamplingSource { outgoing: Outgoing::attach(region, geometry)? })
    }

    /// Replaces the message. `stamp` is now. Wait-free.
    ///
    /// # Errors
    /// [`LengthError`]; the message before stays.
    pub fn write(&mut self, bytes: &[u8], stamp: Tsc) -> Result<(), LengthError> {
        self.outgoing.check_length(bytes)?;
        self.outgoing.publish(bytes, stamp);
        Ok(())
    }
}

/// Whether a message is young enough to act upon.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Validity {
    /// Its age is at most the refresh period.
    Valid,
    /// It is older, or there is none.
    Invalid,
}

/// A message that was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample<'b> {
    /// The message.
    pub bytes: &'b [u8],
    /// When the source says that it wrote it.
    pub stamp: Tsc,
    /// Time since then; zero for a stamp in the future.
    pub age: Ticks,
    /// Whether it is young enough.
    pub validity: Validity,
}

/// Why there is no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReadError {
    /// The buffer has no room for the longest message, whose length in bytes this is.
    Buffer(usize),
    /// Nothing was written since both ends opened.
    NeverWritten,
    /// The source overwrote every message while it was copied.
    Unstable,
    /// The source's region says what cannot be.
    Hostile(Claim),
}

impl ReadError {
    /// NO_ACTION if nothing was written, INVALID_PARAM for the buffer, else NOT_AVAILABLE.
    #[must_use]
    pub const fn code(self) -> ReturnCode {
        match self {
            Self::Buffer(_) => ReturnCode::InvalidParam,
            Self::NeverWritten => ReturnCode::NoAction,
            Self::Unstable | Self::Hostile(_) => ReturnCode::NotAvailable,
        }
    }
}

impl fmt::Display for ReadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Buffer(maximum) => write!(f, "the buffer must have room for {maximum} bytes"),
            Self::NeverWritten => f.write_str("nothing has been written yet"),
            Self::Unstable => f.write_str("the source overwrites faster than this end can copy"),
            Self::Hostile(claim) => write!(f, "the source makes an impossible claim: {claim:?}"),
        }
    }
}

impl core::error::Error for ReadError {}

/// What a destination knows without looking again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SamplingStatus {
    /// Longest message in bytes.
    pub maximum: usize,
    /// Refresh period.
    pub refresh: Ticks,
    /// Validity of the last read; invalid before the first and after one without a message.
    pub validity: Validity,
    /// The source's epoch when it was last seen.
    pub peer_epoch: u64,
    /// What went wrong so far.
    pub counters: Counters,
}

/// An end that reads.
#[derive(Debug)]
pub struct SamplingDestination<L> {
    region: L,
    slots: Slots,
    refresh: Ticks,
    /// What was written when this end opened, for as long as nothing else is.
    opened_at: Option<u64>,
    watch: EpochWatch,
    validity: Validity,
    counters: Counters,
}

impl<L: Load> SamplingDestination<L> {
    /// Opens a destination on the source's region. It is empty until the next write.
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn open(region: L, geometry: &Geometry, refresh: Ticks) -> Result<Self, OpenError> {
        let mut opened = Self::attach(region, geometry, refresh)?;
        opened.opened_at = Some(opened.region.load(word(offset::WRITTEN)));
        Ok(opened)
    }

    /// Opens a destination that also sees what was written before, in this life of the source. A
    /// destination leaves nothing behind, so there is nothing else to continue.
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn attach(region: L, geometry: &Geometry, refresh: Ticks) -> Result<Self, OpenError> {
        geometry.must_be_sampling()?;
        geometry.check_source(&region)?;
        if refresh.0 == 0 {
            return Err(OpenError::Refresh);
        }
        Ok(SamplingDestination {
            slots: Slots::new(geometry),
            refresh,
            watch: EpochWatch::new(region.load(word(offset::EPOCH))),
            opened_at: None,
            validity: Validity::Invalid,
            counters: Counters::default(),
            region,
        })
    }

    /// Copies the newest message into `buffer`, which must have room for the longest one. Does not
    /// consume it. After an error the buffer's contents mean nothing. Wait-free.
    ///
    /// A stamp is a claim, and a source could mark data as fresh for ever by stamping it with a
    /// far future. So a stamp that is later than `now` by more than the refresh period is
    /// impossible: it is counted, and the message is invalid. Up to that it has age zero, since an
    /// honest source may write between the caller's `now` and the copy.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub fn read<'b>(&mut self, buffer: &'b mut [u8], now: Tsc) -> Result<Sample<'b>, ReadError> {
        self.read_by(buffer, || now)
    }

    /// As [`read`](Self::read), but reads the clock after the copy. A reader that can be put off at any
    /// moment needs this: with a `now` of before, a message that came meanwhile would seem to be from
    /// the future.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub fn read_by<'b>(
        &mut self,
        buffer: &'b mut [u8],
        clock: impl FnOnce() -> Tsc,
    ) -> Result<Sample<'b>, ReadError> {
        if buffer.len() < self.slots.maximum() {
            return Err(ReadError::Buffer(self.slots.maximum()));
        }
        self.validity = Validity::Invalid;
        self.watch.look(self.region.load(word(offset::EPOCH)), &mut self.counters);
        for _ in 0..ATTEMPTS {
            let newest = match self.newest() {
                Err(ReadError::Hostile(claim)) => return self.hostile(claim),
                newest => newest?,
            };
            match self.slots.copy(&self.region, newest, buffer) {
                Ok(copied) => {
                    let age = self.judge(copied.stamp, clock());
                    let bytes = buffer.get(..copied.length).unwrap_or_default();
                    let validity = self.validity;
                    return Ok(Sample { bytes, stamp: copied.stamp, age, validity });
                }
                Err(Fault::Overwritten) => {}
                Err(Fault::Impossible(claim)) => return self.hostile(claim),
            }
        }
        count(&mut self.counters.unstable);
        Err(ReadError::Unstable)
    }

    /// The stamp of the newest message, without its bytes: for who looks often whether there is another one. Counts
    /// nothing, and leaves the port's validity as it is. Wait-free.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub fn newest_stamp(&mut self) -> Result<Tsc, ReadError> {
        for _ in 0..ATTEMPTS {
            let newest = self.newest()?;
            match self.slots.stamp(&self.region, newest) {
                Ok(stamp) => return Ok(stamp),
                Err(Fault::Overwritten) => {}
                Err(Fault::Impossible(claim)) => return Err(ReadError::Hostile(claim)),
            }
        }
        Err(ReadError::Unstable)
    }

    /// The number of the newest message.
    fn newest(&mut self) -> Result<u64, ReadError> {
        // In this order: an honest `written`, loaded later, is never behind `first`.
        let first = self.region.load(word(offset::FIRST));
        let written = self.region.load(word(offset::WRITTEN));
        self.opened_at = self.opened_at.filter(|&then| then == written);
        match written.wrapping_sub(first) {
            0 => Err(ReadError::NeverWritten),
            _ if self.opened_at.is_some() => Err(ReadError::NeverWritten),
            1..LIFE_MAX => Ok(written.wrapping_sub(1)),
            _ => Err(ReadError::Hostile(Claim::Counter)),
        }
    }

    /// What is known of the port.
    #[must_use]
    pub fn status(&self) -> SamplingStatus {
        SamplingStatus {
            maximum: self.slots.maximum(),
            refresh: self.refresh,
            validity: self.validity,
            peer_epoch: self.watch.last(),
            counters: self.counters,
        }
    }

    /// The age of a message; its validity becomes that of the port.
    fn judge(&mut self, stamp: Tsc, now: Tsc) -> Ticks {
        let age = now.since(stamp);
        if stamp.since(now) > self.refresh {
            count(&mut self.counters.hostile);
        } else if age <= self.refresh {
            self.validity = Validity::Valid;
        }
        age
    }

    fn hostile<T>(&mut self, claim: Claim) -> Result<T, ReadError> {
        count(&mut self.counters.hostile);
        Err(ReadError::Hostile(claim))
    }
}
