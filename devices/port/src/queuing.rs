//! Queuing ports: every message, in order.

use takt_channel::{
    DestinationStatus, OwnPages, PeerPages, QueuingDestination, QueuingSource, ReceiveError,
    Received, SendError, SourceStatus,
};

use crate::claim::Claim;
use crate::clock::Clock;
use crate::error::CallError;
use crate::wait::{Timeout, Waiter};

/// A port that sends messages.
#[derive(Debug)]
pub struct Sender<'p> {
    pub(crate) end: QueuingSource<OwnPages<'p>, PeerPages<'p>>,
    pub(crate) clock: Clock,
    pub(crate) _claim: Claim,
}

impl Sender<'_> {
    /// Sends a message, stamped with now, and waits for room if the queue is full and must refuse.
    /// Room rings no doorbell: it is looked for every [`POLL_INTERVAL`](crate::POLL_INTERVAL).
    ///
    /// # Errors
    /// [`CallError::TimedOut`] if there is no room in time; with [`Timeout::Zero`],
    /// [`SendError::Full`]. Other errors do not wait.
    pub fn send(&mut self, bytes: &[u8], timeout: Timeout) -> Result<(), CallError> {
        let deadline = timeout.deadline();
        let mut waiter = Waiter::polling();
        loop {
            match self.end.send(bytes, self.clock.now()) {
                Ok(()) => return Ok(()),
                Err(SendError::Full) => {}
                Err(error) => return Err(error.into()),
            }
            if !waiter.wait(deadline)? {
                return Err(match timeout {
                    Timeout::Zero => SendError::Full.into(),
                    _ => CallError::TimedOut,
                });
            }
        }
    }

    /// What is known of the port, after a look at the destination.
    pub fn status(&mut self) -> SourceStatus {
        self.end.status()
    }
}

/// A port that receives messages.
#[derive(Debug)]
pub struct Receiver<'p> {
    pub(crate) end: QueuingDestination<PeerPages<'p>, OwnPages<'p>>,
    pub(crate) waiter: Waiter,
    pub(crate) _claim: Claim,
}

impl Receiver<'_> {
    /// Takes the oldest message into `buffer`, which must have room for the longest one, and waits
    /// for one if there is none.
    ///
    /// # Errors
    /// [`CallError::TimedOut`] if none comes in time; with [`Timeout::Zero`],
    /// [`ReceiveError::Empty`]. Other errors do not wait.
    pub fn receive<'b>(
        &mut self,
        buffer: &'b mut [u8],
        timeout: Timeout,
    ) -> Result<Received<'b>, CallError> {
        let deadline = timeout.deadline();
        let (length, stamp, overflowed) = loop {
            match self.end.receive(buffer) {
                Ok(received) => break (received.bytes.len(), received.stamp, received.overflowed),
                Err(ReceiveError::Empty) => {}
                Err(error) => return Err(error.into()),
            }
            if !self.waiter.wait(deadline)? {
                return Err(match timeout {
                    Timeout::Zero => ReceiveError::Empty.into(),
                    _ => CallError::TimedOut,
                });
            }
        };
        let bytes = buffer.get(..length).unwrap_or_default();
        Ok(Received { bytes, stamp, overflowed })
    }

    /// Throws away all waiting messages.
    pub fn clear(&mut self) {
        self.end.clear();
    }

    /// What is known of the port, after a look at the source.
    pub fn status(&mut self) -> DestinationStatus {
        self.end.status()
    }
}
