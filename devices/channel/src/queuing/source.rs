//! The sending end of a queuing channel.

use core::fmt;

use crate::code::ReturnCode;
use crate::counters::{Counters, EpochWatch, count};
use crate::layout::{Geometry, Policy, offset, word};
use crate::memory::{Load, Store};
use crate::open::OpenError;
use crate::outgoing::{LengthError, Outgoing};
use crate::time::Tsc;

/// Why a message was not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendError {
    /// Its length is wrong.
    Length(LengthError),
    /// The queue is full and its policy is to refuse. Nothing is lost.
    Full,
}

impl SendError {
    /// That of the length, or NOT_AVAILABLE for a full queue.
    #[must_use]
    pub const fn code(self) -> ReturnCode {
        match self {
            Self::Length(error) => error.code(),
            Self::Full => ReturnCode::NotAvailable,
        }
    }
}

impl fmt::Display for SendError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(error) => error.fmt(f),
            Self::Full => f.write_str("the queue is full"),
        }
    }
}

impl core::error::Error for SendError {}

impl From<LengthError> for SendError {
    fn from(error: LengthError) -> Self {
        SendError::Length(error)
    }
}

/// What a source knows of its queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SourceStatus {
    /// Messages not taken yet, by what the destination says.
    pub waiting: u32,
    /// Largest number of them.
    pub depth: u32,
    /// Longest message in bytes.
    pub maximum: usize,
    /// What happens at that number.
    pub policy: Policy,
    /// The destination's epoch when it was last seen.
    pub peer_epoch: u64,
    /// What went wrong so far.
    pub counters: Counters,
}

/// The end that sends.
#[derive(Debug)]
pub struct QueuingSource<S, L> {
    outgoing: Outgoing<S>,
    peer: L,
    policy: Policy,
    depth: u32,
    /// Messages before this one are taken or void: the last thing the destination said that can
    /// be true.
    taken: u64,
    watch: EpochWatch,
    counters: Counters,
}

impl<S: Store, L: Load> QueuingSource<S, L> {
    /// Opens the source on its own region and the destination's, and empties the queue.
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn open(own: S, peer: L, geometry: &Geometry) -> Result<Self, OpenError> {
        Self::begin(own, peer, geometry, Outgoing::open)
    }

    /// Continues where the source's last owner left off: what is waiting stays, and the destination
    /// does not notice. That owner must not send any more. A message that it was writing when it
    /// ended was never sent.
    ///
    /// Counters of the own region that contradict each other, which only this partition can have
    /// caused, are as good as none: the queue is then emptied as by [`open`](Self::open).
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn attach(own: S, peer: L, geometry: &Geometry) -> Result<Self, OpenError> {
        Self::begin(own, peer, geometry, Outgoing::attach)
    }

    fn begin(
        own: S,
        peer: L,
        geometry: &Geometry,
        outgoing: fn(S, &Geometry) -> Result<Outgoing<S>, OpenError>,
    ) -> Result<Self, OpenError> {
        let policy = geometry.queuing_policy()?;
        geometry.check_destination(&peer)?;
        let outgoing = outgoing(own, geometry)?;
        Ok(QueuingSource {
            // What was taken since then, the next look tells.
            taken: outgoing.first(),
            outgoing,
            watch: EpochWatch::new(peer.load(word(offset::EPOCH))),
            peer,
            policy,
            depth: geometry.depth,
            counters: Counters::default(),
        })
    }

    /// Sends a message. `stamp` is now. Wait-free.
    ///
    /// # Errors
    /// See [`SendError`].
    pub fn send(&mut self, bytes: &[u8], stamp: Tsc) -> Result<(), SendError> {
        self.outgoing.check_length(bytes)?;
        self.listen();
        if self.policy == Policy::Refuse && self.ahead() >= u64::from(self.depth) {
            self.outgoing.tell();
            return Err(SendError::Full);
        }
        self.outgoing.publish(bytes, stamp);
        Ok(())
    }

    /// What is known of the port, after a look at the destination.
    pub fn status(&mut self) -> SourceStatus {
        self.listen();
        SourceStatus {
            waiting: u32::try_from(self.ahead()).unwrap_or(u32::MAX).min(self.depth),
            depth: self.depth,
            maximum: self.outgoing.maximum(),
            policy: self.policy,
            peer_epoch: self.watch.last(),
            counters: self.counters,
        }
    }

    /// Messages written and not known to be taken.
    fn ahead(&self) -> u64 {
        self.outgoing.next().wrapping_sub(self.taken)
    }

    /// Takes note of the destination's counter, if it can be true.
    fn listen(&mut self) {
        self.watch.look(self.peer.load(word(offset::EPOCH)), &mut self.counters);
        let read = self.peer.load(word(offset::READ));
        let behind = self.outgoing.first().wrapping_sub(read);
        if read.wrapping_sub(self.taken) <= self.ahead() {
            self.taken = read;
        } else if self.taken == self.outgoing.first() && behind <= u64::MAX / 2 {
            // The destination has not looked since this end opened: it still counts in the life
            // before, of which nothing is waiting any more.
        } else {
            count(&mut self.counters.hostile);
        }
    }
}
