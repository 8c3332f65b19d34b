//! What can be seen of a port without owning it.
//!
//! Looking must not disturb an owner, nor take from the next one what it should be told. So nothing
//! here goes through an end: the counters are only loaded, from both regions.

use takt_channel::{Load, SamplingDestination, Ticks, Tsc, offset};

use crate::claim::is_claimed;
use crate::error::PortsError;
use crate::ports::Ports;
use crate::table::{Direction, Kind, Port};

/// How often the counters of ends that are at work are looked at.
const LOOKS: usize = 4;

/// The newest message of a sampling channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Newest {
    /// When the source says that it wrote it.
    pub stamp: Tsc,
    /// Time since then; zero for a stamp in the future.
    pub age: Ticks,
    /// Its length in bytes.
    pub length: usize,
}

/// What the regions of a port say. The counters of the other end are its claims.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Some process has the port.
    pub in_use: bool,
    /// Starts of the source.
    pub source_starts: u64,
    /// Starts of the destination of a queue.
    pub destination_starts: Option<u64>,
    /// Messages that the source has written since it started.
    pub written: u64,
    /// Messages that wait in a queue, at most its depth.
    pub waiting: Option<u64>,
    /// The newest message of a sampling channel, if there is one that can be read.
    pub newest: Option<Newest>,
}

impl Ports {
    /// What can be seen of a port of this partition.
    ///
    /// # Errors
    /// [`PortsError::File`] if the kernel does not tell who owns the port.
    pub fn status(&self, port: &Port) -> Result<Status, PortsError> {
        let (own, peer) = (self.look_at_own(port), self.look_at_peer(port));
        let (messages, acknowledgement) = match port.direction {
            Direction::Source => (own, peer),
            Direction::Destination => (peer, own),
        };
        let word = |region: &Option<_>, offset: usize| {
            region.as_ref().map_or(0, |region| Load::load(region, offset / 8))
        };
        let counters = || (word(&messages, offset::FIRST), word(&acknowledgement, offset::READ));
        let mut before = counters();
        let mut end = word(&messages, offset::WRITTEN);
        // They are of one instant if the others are the same before and after.
        for _ in 1..LOOKS {
            let after = counters();
            if after == before {
                break;
            }
            (before, end) = (after, word(&messages, offset::WRITTEN));
        }
        let (first, read) = before;
        let written = end.wrapping_sub(first);
        let source_starts = word(&messages, offset::EPOCH);
        let (mut waiting, mut destination_starts, mut newest) = (None, None, None);
        match port.kind {
            Kind::Queuing { depth, .. } => {
                destination_starts = Some(word(&acknowledgement, offset::EPOCH));
                // A destination that claims to have taken more than was sent leaves nothing waiting.
                let untaken = end.wrapping_sub(read).cast_signed().max(0).cast_unsigned();
                waiting = Some(untaken.min(written).min(u64::from(depth)));
            }
            Kind::Sampling { .. } => {
                newest = messages.and_then(|messages| self.newest(port, messages));
            }
        }
        let in_use = is_claimed(&self.writable_file(), port.index)?;
        Ok(Status { in_use, source_starts, destination_starts, written, waiting, newest })
    }

    fn newest(&self, port: &Port, messages: impl Load) -> Option<Newest> {
        let any_age = Ticks(u64::MAX);
        let mut end = SamplingDestination::attach(messages, &port.geometry, any_age).ok()?;
        let mut buffer = vec![0; port.maximum as usize];
        let sample = end.read_by(&mut buffer, || self.clock().now()).ok()?;
        Some(Newest { stamp: sample.stamp, age: sample.age, length: sample.bytes.len() })
    }
}
