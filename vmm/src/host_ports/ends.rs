//! Takt as the source or a destination of a channel.
//!
//! It is an end like any other: it opens its port with the geometry of the partition file, believes
//! nothing of the other end, and writes to its own region only. What an end on the host adds
//! is a notion of *news*: a socket is told of each message, and does not look whenever it likes as
//! the destination of a sampling channel may.

use takt_channel::{
    Counters, Load, OpenError, Policy, QueuingDestination, QueuingSource, ReadError, ReceiveError,
    SamplingDestination, SamplingSource, Ticks, Validity, offset,
};
use takt_scheduler::time::{self, Timebase, TscFrequency};
use thiserror::Error;

use super::packet::{HEADER, Header, LOST, VALID};
use super::pages::{Own, Peer};
use crate::channels::Regions;
use crate::config::ChannelKind;
use crate::memory::MemoryError;

/// How often a sample is read again because a newer one came meanwhile.
const ATTEMPTS: usize = 4;

/// Reads the clock. An end does so itself, after a look or just before it sends: the thread can be put off
/// at any moment, and other ports take their time.
pub type Now<'a> = &'a dyn Fn() -> time::Tsc;

/// An end on the host could not be opened.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum EndError {
    #[error(transparent)]
    Memory(#[from] MemoryError),
    #[error("cannot open the port: {0}")]
    Open(#[from] OpenError),
    #[error("the channel has no region for its acknowledgement")]
    Missing,
}

/// Takt's end of a channel that somebody else sends on.
pub struct Destination {
    port: Incoming,
    /// The header and the message.
    packet: Vec<u8>,
    /// Length of the message in `packet`.
    length: usize,
}

enum Incoming {
    Sampling {
        port: SamplingDestination<Peer>,
        /// The same region, to see whether anything was written.
        region: Peer,
        /// How much was written at the last look.
        seen: u64,
    },
    Queuing(QueuingDestination<Peer, Own>),
}

impl Destination {
    /// Opens it. The source's header must have been written.
    ///
    /// # Errors
    /// See [`EndError`].
    pub fn open(regions: &Regions<'_>, frequency: TscFrequency) -> Result<Self, EndError> {
        let geometry = &regions.geometry;
        let region = Peer::map(&regions.source)?;
        let port = match regions.channel.kind {
            ChannelKind::Sampling { refresh } => {
                // A period of less than a tick is still a period.
                let refresh = Ticks(frequency.ticks(refresh).0.max(1));
                Incoming::Sampling {
                    port: SamplingDestination::open(region.clone(), geometry, refresh)?,
                    seen: written(&region),
                    region,
                }
            }
            ChannelKind::Queuing { .. } => {
                let own = regions.destination.as_ref().ok_or(EndError::Missing)?;
                let mut own = Own::map(own)?;
                geometry.format_destination(&mut own)?;
                Incoming::Queuing(QueuingDestination::open(region, own, geometry)?)
            }
        };
        let maximum = regions.channel.message_bytes as usize;
        Ok(Self { port, packet: vec![0; HEADER + maximum], length: 0 })
    }

    /// True for a sampling channel, whose messages are there for everybody.
    #[must_use]
    pub fn is_sampling(&self) -> bool {
        matches!(self.port, Incoming::Sampling { .. })
    }

    /// Whether there may be a message that no [`take`](Self::take) has brought yet.
    #[must_use]
    pub fn has_news(&self) -> bool {
        match &self.port {
            Incoming::Sampling { region, seen, .. } => written(region) != *seen,
            Incoming::Queuing(_) => true,
        }
    }

    /// Messages that wait in the queue; of a sampling channel 1 if there is a newer sample.
    pub fn waiting(&mut self) -> u64 {
        match &mut self.port {
            Incoming::Sampling { region, seen, .. } => u64::from(written(region) != *seen),
            Incoming::Queuing(port) => port.status().waiting.into(),
        }
    }

    /// Makes [`packet`](Self::packet) the newest sample, again if need be, or the oldest message of
    /// the queue, which is thereby taken. False if there is none.
    pub fn take(&mut self, clock: &Timebase, now: Now<'_>) -> bool {
        let Some((header, message)) = self.packet.split_first_chunk_mut::<HEADER>() else {
            return false;
        };
        let taken = match &mut self.port {
            Incoming::Sampling { port, region, seen } => {
                sample(port, region, seen, message, now).ok()
            }
            Incoming::Queuing(port) => receive(port, message, now).ok(),
        };
        let Some(Taken { length, stamp, flags, at }) = taken else { return false };
        let age = at.since(time::Tsc(stamp.0));
        *header = Header {
            taken_ns: clock.offset(at).0,
            age_ns: clock.frequency.nanos(age).0,
            flags,
            length: length as u32,
        }
        .to_bytes();
        self.length = length;
        true
    }

    /// Bytes of the longest packet.
    #[must_use]
    pub const fn longest(&self) -> usize {
        self.packet.len()
    }

    /// What was taken last.
    #[must_use]
    pub fn packet(&self) -> &[u8] {
        self.packet.get(..HEADER + self.length).unwrap_or_default()
    }

    /// What went wrong so far.
    pub fn counters(&mut self) -> Counters {
        match &mut self.port {
            Incoming::Sampling { port, .. } => port.status().counters,
            Incoming::Queuing(port) => port.status().counters,
        }
    }
}

struct Taken {
    length: usize,
    stamp: takt_channel::Tsc,
    flags: u32,
    at: time::Tsc,
}

/// The newest sample. Looks at the count on both sides of the copy, so that the sample that was
/// copied is the one that counts as seen; a source that never rests makes it come twice instead.
fn sample(
    port: &mut SamplingDestination<Peer>,
    region: &Peer,
    seen: &mut u64,
    buffer: &mut [u8],
    now: Now<'_>,
) -> Result<Taken, ReadError> {
    let mut taken = Err(ReadError::NeverWritten);
    for _ in 0..ATTEMPTS {
        *seen = written(region);
        let mut at = time::Tsc(0);
        let clock = || {
            at = now();
            takt_channel::Tsc(at.0)
        };
        taken = port.read_by(buffer, clock).map(|sample| Taken {
            length: sample.bytes.len(),
            stamp: sample.stamp,
            flags: if sample.validity == Validity::Valid { VALID } else { 0 },
            at,
        });
        if written(region) == *seen {
            break;
        }
    }
    taken
}

fn receive(
    port: &mut QueuingDestination<Peer, Own>,
    buffer: &mut [u8],
    now: Now<'_>,
) -> Result<Taken, ReceiveError> {
    port.receive(buffer).map(|received| Taken {
        length: received.bytes.len(),
        stamp: received.stamp,
        flags: if received.overflowed { LOST } else { 0 },
        at: now(),
    })
}

/// The number of the message to be written next: the region's own count.
fn written(region: &Peer) -> u64 {
    region.load(offset::WRITTEN / size_of::<u64>())
}

/// Takt's end of a channel that it sends on.
pub struct Source {
    port: Outgoing,
    /// Stamp of the last message. Readers tell a new message by its stamp, so no two have the same.
    last: u64,
}

enum Outgoing {
    Sampling(SamplingSource<Own>),
    Queuing(QueuingSource<Own, Peer>),
}

impl Source {
    /// Opens it. The header of the destination's region must have been written.
    ///
    /// # Errors
    /// See [`EndError`].
    pub fn open(regions: &Regions<'_>) -> Result<Self, EndError> {
        let geometry = &regions.geometry;
        let mut own = Own::map(&regions.source)?;
        geometry.format_source(&mut own)?;
        let port = match &regions.destination {
            None => Outgoing::Sampling(SamplingSource::open(own, geometry)?),
            Some(peer) => Outgoing::Queuing(QueuingSource::open(own, Peer::map(peer)?, geometry)?),
        };
        Ok(Self { port, last: 0 })
    }

    /// Whether a message may be sent now: always on a sampling channel. On a queuing one the
    /// destination must have opened its port, since that empties the queue; and there must be
    /// room, unless the channel overwrites and the caller is not `patient`.
    pub fn has_room(&mut self, patient: bool) -> bool {
        match &mut self.port {
            Outgoing::Sampling(_) => true,
            Outgoing::Queuing(port) => {
                let status = port.status();
                let overwrites = status.policy == Policy::Overwrite && !patient;
                status.peer_epoch != 0 && (status.waiting < status.depth || overwrites)
            }
        }
    }

    /// True for a sampling channel.
    #[must_use]
    pub fn is_sampling(&self) -> bool {
        matches!(self.port, Outgoing::Sampling(_))
    }

    /// Sends a message, stamped with now, and later than the one before. False if the channel does not take it: too long, empty, or no room.
    pub fn send(&mut self, message: &[u8], now: Now<'_>) -> bool {
        self.last = now().0.max(self.last.saturating_add(1));
        let stamp = takt_channel::Tsc(self.last);
        match &mut self.port {
            Outgoing::Sampling(port) => port.write(message, stamp).is_ok(),
            Outgoing::Queuing(port) => port.send(message, stamp).is_ok(),
        }
    }

    /// What went wrong so far; the source of a sampling channel hears nothing of anybody.
    pub fn counters(&mut self) -> Counters {
        match &mut self.port {
            Outgoing::Sampling(_) => Counters::default(),
            Outgoing::Queuing(port) => port.status().counters,
        }
    }
}
