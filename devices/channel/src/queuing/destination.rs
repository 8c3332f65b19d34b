//! The receiving end of a queuing channel.

use core::fmt;

use crate::code::ReturnCode;
use crate::counters::{Counters, EpochWatch, count};
use crate::layout::{Geometry, Policy, offset, word};
use crate::memory::{Load, Store};
use crate::open::OpenError;
use crate::order::is_ahead;
use crate::outgoing::begin_epoch;
use crate::slots::{ATTEMPTS, Claim, Fault, LIFE_MAX, Slots};
use crate::time::Tsc;

/// A message that was received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Received<'b> {
    /// The message.
    pub bytes: &'b [u8],
    /// When the source says that it sent it.
    pub stamp: Tsc,
    /// Messages before this one were overwritten.
    pub overflowed: bool,
}

impl Received<'_> {
    /// INVALID_CONFIG after an overflow, else NO_ERROR. The message is there in both cases.
    #[must_use]
    pub const fn code(&self) -> ReturnCode {
        if self.overflowed { ReturnCode::InvalidConfig } else { ReturnCode::NoError }
    }
}

/// Why no message was received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReceiveError {
    /// The buffer has no room for the longest message, whose length in bytes this is.
    Buffer(usize),
    /// No message is waiting.
    Empty,
    /// The source overwrote every message while it was copied.
    Unstable,
    /// The source's region says what cannot be. What it said was skipped: the next call goes on
    /// behind it.
    Hostile(Claim),
}

impl ReceiveError {
    /// INVALID_PARAM for the buffer, else NOT_AVAILABLE.
    #[must_use]
    pub const fn code(self) -> ReturnCode {
        match self {
            Self::Buffer(_) => ReturnCode::InvalidParam,
            Self::Empty | Self::Unstable | Self::Hostile(_) => ReturnCode::NotAvailable,
        }
    }
}

impl fmt::Display for ReceiveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Buffer(maximum) => write!(f, "the buffer must have room for {maximum} bytes"),
            Self::Empty => f.write_str("no message is waiting"),
            Self::Unstable => f.write_str("the source overwrites faster than this end can copy"),
            Self::Hostile(claim) => write!(f, "the source makes an impossible claim: {claim:?}"),
        }
    }
}

impl core::error::Error for ReceiveError {}

/// What a destination knows of its queue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DestinationStatus {
    /// Messages that can be received.
    pub waiting: u32,
    /// Largest number of them.
    pub depth: u32,
    /// Longest message in bytes.
    pub maximum: usize,
    /// What happens at that number.
    pub policy: Policy,
    /// The source's epoch when it was last seen.
    pub peer_epoch: u64,
    /// What went wrong so far.
    pub counters: Counters,
}

/// The end that receives.
#[derive(Debug)]
pub struct QueuingDestination<L, S> {
    peer: L,
    own: S,
    slots: Slots,
    policy: Policy,
    depth: u32,
    /// Number of the message to be taken next.
    next: u64,
    overflowed: bool,
    watch: EpochWatch,
    counters: Counters,
}

impl<L: Load, S: Store> QueuingDestination<L, S> {
    /// Opens the destination on the source's region and its own, and empties the queue.
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn open(peer: L, own: S, geometry: &Geometry) -> Result<Self, OpenError> {
        let mut opened = Self::attach(peer, own, geometry)?;
        opened.take_up_to(opened.peer.load(word(offset::WRITTEN)));
        begin_epoch(&mut opened.own);
        Ok(opened)
    }

    /// Continues where the destination's last owner left off: the next message is the first that
    /// it has not taken, and the source does not notice. That owner must not receive any more. A
    /// message is taken when [`receive`](Self::receive) returns it; what an owner has not
    /// returned before it ended, the next one gets. An overflow that it noticed and did not tell
    /// is forgotten.
    ///
    /// The number of the next message is all that is believed of the own region. Where this
    /// partition has damaged it, messages can come twice or be left out, and the source may be
    /// counted as hostile for what is not its fault; the looks that follow correct it.
    ///
    /// # Errors
    /// [`OpenError`], INVALID_CONFIG.
    pub fn attach(peer: L, own: S, geometry: &Geometry) -> Result<Self, OpenError> {
        let policy = geometry.queuing_policy()?;
        geometry.check_source(&peer)?;
        geometry.check_destination(&own)?;
        Ok(QueuingDestination {
            next: own.load(word(offset::READ)),
            watch: EpochWatch::new(peer.load(word(offset::EPOCH))),
            peer,
            own,
            slots: Slots::new(geometry),
            policy,
            depth: geometry.depth,
            overflowed: false,
            counters: Counters::default(),
        })
    }

    /// Takes the oldest message into `buffer`, which must have room for the longest one. After an
    /// error the buffer's contents mean nothing. Wait-free.
    ///
    /// # Errors
    /// See [`ReceiveError`].
    pub fn receive<'b>(&mut self, buffer: &'b mut [u8]) -> Result<Received<'b>, ReceiveError> {
        if buffer.len() < self.slots.maximum() {
            return Err(ReceiveError::Buffer(self.slots.maximum()));
        }
        let mut overwritten = None;
        for _ in 0..ATTEMPTS {
            if self.synchronise().map_err(ReceiveError::Hostile)? == 0 {
                return Err(ReceiveError::Empty);
            }
            let n = self.next;
            match self.slots.copy(&self.peer, n, buffer) {
                Ok(copied) => {
                    self.take_up_to(n.wrapping_add(1));
                    let bytes = buffer.get(..copied.length).unwrap_or_default();
                    let overflowed = core::mem::take(&mut self.overflowed);
                    return Ok(Received { bytes, stamp: copied.stamp, overflowed });
                }
                // An honest source has by then counted past the depth, so that the next look
                // moves on. If it does not, the message is one that will never come.
                Err(Fault::Overwritten) if overwritten != Some(n) => overwritten = Some(n),
                Err(Fault::Overwritten) => return self.skip(n, Claim::Sequence),
                Err(Fault::Impossible(claim)) => return self.skip(n, claim),
            }
        }
        count(&mut self.counters.unstable);
        Err(ReceiveError::Unstable)
    }

    /// Throws away all waiting messages, and with them the notice of an overflow.
    pub fn clear(&mut self) {
        // After an impossible counter nothing is waiting.
        let waiting = self.synchronise().unwrap_or(0);
        self.overflowed = false;
        self.take_up_to(self.next.wrapping_add(waiting));
    }

    /// What is known of the port, after a look at the source.
    pub fn status(&mut self) -> DestinationStatus {
        let waiting = self.synchronise().unwrap_or(0);
        DestinationStatus {
            waiting: u32::try_from(waiting).unwrap_or(u32::MAX),
            depth: self.depth,
            maximum: self.slots.maximum(),
            policy: self.policy,
            peer_epoch: self.watch.last(),
            counters: self.counters,
        }
    }

    /// Looks at the source's counters, leaves behind what is void or lost, and returns how many
    /// messages are waiting, at most the depth.
    fn synchronise(&mut self) -> Result<u64, Claim> {
        self.watch.look(self.peer.load(word(offset::EPOCH)), &mut self.counters);
        // In this order: between the two looks the source may start again and send. Had `first`
        // been seen before and `written` after, then void messages would count as waiting, more
        // than the depth, and an honest source would look like a liar.
        let mut written = self.peer.load(word(offset::WRITTEN));
        let first = self.peer.load(word(offset::FIRST));
        if is_ahead(first, written) {
            // It has started again in between, unless the counter is still behind.
            let again = self.peer.load(word(offset::WRITTEN));
            if is_ahead(first, again) {
                return self.resynchronise(again);
            }
            written = first;
        }
        if is_ahead(first, self.next) {
            self.take_up_to(first);
        }
        let depth = u64::from(self.depth);
        let ahead = written.wrapping_sub(self.next);
        match self.policy {
            _ if ahead <= depth => Ok(ahead),
            Policy::Overwrite if ahead < LIFE_MAX => {
                self.counters.lost = self.counters.lost.saturating_add(ahead - depth);
                self.overflowed = true;
                self.take_up_to(written.wrapping_sub(depth));
                Ok(depth)
            }
            Policy::Overwrite | Policy::Refuse => self.resynchronise(written),
        }
    }

    /// Goes on from where the source says that it is, after an impossible counter.
    fn resynchronise<T>(&mut self, written: u64) -> Result<T, Claim> {
        count(&mut self.counters.hostile);
        self.take_up_to(written);
        Err(Claim::Counter)
    }

    /// Gives up message `n`, of which the source says what cannot be.
    fn skip<T>(&mut self, n: u64, claim: Claim) -> Result<T, ReceiveError> {
        count(&mut self.counters.hostile);
        self.take_up_to(n.wrapping_add(1));
        Err(ReceiveError::Hostile(claim))
    }

    /// Moves on to message `n` and tells the source.
    fn take_up_to(&mut self, n: u64) {
        self.next = n;
        self.own.store(word(offset::READ), n);
    }
}
