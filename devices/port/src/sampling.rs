//! Sampling ports: the newest message, and how old it is.

use takt_channel::{
    LengthError, OwnPages, PeerPages, ReadError, Sample, SamplingDestination, SamplingSource,
    SamplingStatus, Tsc,
};

use crate::claim::Claim;
use crate::clock::Clock;
use crate::error::CallError;
use crate::wait::{Timeout, Waiter};

/// A port that writes the newest message.
#[derive(Debug)]
pub struct Output<'p> {
    pub(crate) end: SamplingSource<OwnPages<'p>>,
    pub(crate) clock: Clock,
    pub(crate) _claim: Claim,
}

impl Output<'_> {
    /// Replaces the message, and stamps it with now. Never waits.
    ///
    /// # Errors
    /// [`LengthError`]; the message before stays.
    pub fn write(&mut self, bytes: &[u8]) -> Result<(), LengthError> {
        self.end.write(bytes, self.clock.now())
    }
}

/// A port that reads the newest message.
#[derive(Debug)]
pub struct Input<'p> {
    pub(crate) end: SamplingDestination<PeerPages<'p>>,
    pub(crate) waiter: Waiter,
    pub(crate) clock: Clock,
    pub(crate) _claim: Claim,
}

impl Input<'_> {
    /// Copies the newest message into `buffer`, which must have room for the longest one. Does not
    /// consume it, and never waits.
    ///
    /// # Errors
    /// See [`ReadError`].
    pub fn read<'b>(&mut self, buffer: &'b mut [u8]) -> Result<Sample<'b>, ReadError> {
        self.end.read_by(buffer, || self.clock.now())
    }

    /// As [`read`](Self::read), but waits for a message whose stamp is not `known`: for any at
    /// all if that is `None`.
    ///
    /// # Errors
    /// [`CallError::TimedOut`] if none comes in time; with [`Timeout::Zero`],
    /// [`CallError::NothingNewer`] or [`ReadError::NeverWritten`]. Other errors do not wait.
    pub fn read_newer<'b>(
        &mut self,
        buffer: &'b mut [u8],
        known: Option<Tsc>,
        timeout: Timeout,
    ) -> Result<Sample<'b>, CallError> {
        let deadline = timeout.deadline();
        let (length, stamp, age, validity) = loop {
            let nothing = match self.end.read_by(buffer, || self.clock.now()) {
                Ok(sample) if Some(sample.stamp) != known => {
                    break (sample.bytes.len(), sample.stamp, sample.age, sample.validity);
                }
                Ok(_) => CallError::NothingNewer,
                Err(error @ ReadError::NeverWritten) => error.into(),
                Err(error) => return Err(error.into()),
            };
            if !self.waiter.wait(deadline)? {
                return Err(if timeout == Timeout::Zero { nothing } else { CallError::TimedOut });
            }
        };
        let bytes = buffer.get(..length).unwrap_or_default();
        Ok(Sample { bytes, stamp, age, validity })
    }

    /// What is known of the port.
    #[must_use]
    pub fn status(&self) -> SamplingStatus {
        self.end.status()
    }
}
