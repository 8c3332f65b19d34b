//! What is between the partitions, for the control socket.
//!
//! How full a queue is and how old a sample is lies in pages that guests write. It is looked at
//! when a client asks for the status, through mappings of Takt's own that are read-only, and in a
//! way that no guest notices ([`Bystander`]). Nothing of it is believed: a claim that cannot be true
//! becomes the text of a problem.

use takt_channel::{Bystander, OpenError, Sight};
use takt_scheduler::time::{Tsc, TscFrequency};
use thiserror::Error;

use super::protocol::{ChannelStatus, Contents};
use crate::channels::{Channels, Regions};
use crate::config::{ChannelKind, End, Owner, PartitionFile};
use crate::host_ports::pages::Peer;
use crate::memory::MemoryError;

/// A channel that cannot be looked at.
#[derive(Debug, Error)]
#[error("cannot look at channel {channel}: {source}")]
pub struct ViewError {
    channel: String,
    source: NoView,
}

/// Why it cannot.
#[derive(Debug, Error)]
enum NoView {
    #[error(transparent)]
    Memory(#[from] MemoryError),
    #[error(transparent)]
    Layout(#[from] OpenError),
}

/// All channels of a run, seen from beside.
pub struct Views(Vec<View>);

struct View {
    kind: ChannelKind,
    /// True if Takt itself is the destination.
    ends_here: bool,
    bystander: Bystander<Peer>,
    /// Of a channel of which nothing is known.
    blank: ChannelStatus,
}

impl Views {
    /// Maps their memory.
    ///
    /// # Errors
    /// See [`ViewError`].
    pub fn new(file: &PartitionFile, channels: &Channels<'_>) -> Result<Views, ViewError> {
        let failed = |regions: &Regions<'_>, source| ViewError {
            channel: regions.channel.name.clone(),
            source,
        };
        let view = |regions| View::new(file, regions).map_err(|source| failed(regions, source));
        Ok(Views(channels.all().map(view).collect::<Result<_, _>>()?))
    }

    /// How they stand. The clock is read after each look: this thread can be put off at any moment,
    /// and a message that came meanwhile must not seem to be from the future. `lost` tells of a
    /// channel that ends at Takt, by name, how much was lost of it.
    pub fn look(
        &self,
        clock: impl Fn() -> Tsc,
        frequency: TscFrequency,
        lost: impl Fn(&str) -> Option<u64>,
    ) -> Vec<ChannelStatus> {
        let status = |view: &View| ChannelStatus {
            lost: if view.ends_here { lost(&view.blank.name) } else { None },
            ..view.look(&clock, frequency)
        };
        self.0.iter().map(status).collect()
    }
}

impl View {
    fn new(file: &PartitionFile, regions: &Regions<'_>) -> Result<View, NoView> {
        let (channel, geometry) = (regions.channel, &regions.geometry);
        let source = Peer::map(&regions.source)?;
        let bystander = match &regions.destination {
            None => Bystander::sampling(source, geometry)?,
            Some(destination) => Bystander::queuing(source, Peer::map(destination)?, geometry)?,
        };
        let end = |end: &End| match end.owner {
            Owner::Host => format!("host:{}", end.port),
            Owner::Partition(id) => format!("{}:{}", file.partitions()[id.0].name(), end.port),
        };
        let (kind, depth, refresh_ns) = match channel.kind {
            ChannelKind::Sampling { refresh } => ("sampling", None, Some(refresh.0)),
            ChannelKind::Queuing { depth, .. } => ("queuing", Some(depth.into()), None),
        };
        let blank = ChannelStatus {
            name: channel.name.clone(),
            kind: kind.to_owned(),
            source: end(&channel.source),
            destinations: channel.destinations.iter().map(end).collect(),
            depth,
            refresh_ns,
            contents: None,
            lost: None,
            problem: None,
        };
        let ends_here = channel.destinations.iter().any(|end| end.owner == Owner::Host);
        Ok(View { kind: channel.kind, ends_here, bystander, blank })
    }

    fn look(&self, clock: impl Fn() -> Tsc, frequency: TscFrequency) -> ChannelStatus {
        let seen = self.bystander.look().map_err(|error| error.to_string());
        let seen = seen.and_then(|sight| self.contents(sight, clock(), frequency));
        let (contents, problem) = match seen {
            Ok(contents) => (Some(contents), None),
            Err(problem) => (None, Some(problem)),
        };
        ChannelStatus { contents, problem, ..self.blank.clone() }
    }

    /// An age is judged as destinations judge it: a stamp that lies in the future by more than the
    /// refresh period was never a clock's.
    fn contents(&self, seen: Sight, now: Tsc, frequency: TscFrequency) -> Result<Contents, String> {
        let newest = seen.newest.map(|stamp| Tsc(stamp.0));
        let age = newest.map(|stamp| frequency.nanos(now.since(stamp)));
        let ahead = newest.map(|stamp| frequency.nanos(stamp.since(now)));
        Ok(match self.kind {
            ChannelKind::Sampling { refresh } if ahead > Some(refresh) => {
                return Err("an end makes an impossible claim: a stamp in the future".to_owned());
            }
            ChannelKind::Sampling { refresh } => Contents {
                written: seen.written,
                waiting: None,
                overwritten: None,
                age_ns: age.map(|age| age.0),
                valid: Some(age.is_some_and(|age| age <= refresh)),
            },
            ChannelKind::Queuing { .. } => Contents {
                written: seen.written,
                waiting: Some(seen.waiting.into()),
                overwritten: Some(seen.overwritten),
                age_ns: age.map(|age| age.0),
                valid: None,
            },
        })
    }
}
