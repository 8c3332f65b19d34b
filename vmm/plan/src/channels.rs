//! The channels between partitions: the rules for each, and among their names.
//!
//! A channel is written once, with both of its ends, and not as a port in each partition that has
//! to match a port in another one. What is written once cannot contradict itself, and who may
//! write to whom is read in one place. What the ends add up to in a partition is looked at in
//! [`super::ports`].
//!
//! Sampling and queuing are those of ARINC 653 Part 1: the newest message for everybody who looks,
//! and each message once and in order. Their keys differ, and one of the other kind is refused: a
//! `depth` of a sampling channel is more likely a wrong `kind` than a superfluous line.

use std::fmt;
use std::path::Path;

use takt_channel::{DEPTH_MAX, Geometry, GeometryError, MESSAGE_MAX, Policy};
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::Nanos;
use toml::Spanned;

use super::Kind;
use super::diagnostic::{Diagnostic, Span, quote};
use super::host_ports::{self, HostPort};
use super::names::{HOST, check_name, check_word};
use super::partition::{self, Checked};
use super::ports::Ports;
use super::raw::{self, Keys};

/// Most channels of one file.
pub const CHANNELS_MAX: usize = 128;
/// Longest refresh period, that of the longest major frame: above, it is a typing mistake.
const REFRESH_MAX: Nanos = Nanos::from_millis(60_000);

/// A way for messages from one partition to others.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Channel {
    /// Unique in the file; of the same form as a partition's name.
    pub name: String,
    /// What becomes of the messages.
    pub kind: ChannelKind,
    /// Length of the longest message in bytes, 1 to 65536.
    pub message_bytes: u32,
    /// Who sends.
    pub source: End,
    /// Who receives: at least one, and exactly one if the channel is a queuing one. No owner is in
    /// here twice, nor is that of the source.
    pub destinations: Vec<End>,
    /// The Linux that can wait for messages, one of the destinations: the source rings after each.
    pub doorbell: Option<PartitionId>,
    /// Where the end on the host leads, if there is one.
    pub host: Option<HostPort>,
}

/// What becomes of the messages of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChannelKind {
    /// A message replaces the one before it, and is read any number of times.
    Sampling {
        /// A message of at most this age is valid; more than nothing, at most 60 s.
        refresh: Nanos,
    },
    /// Messages wait until they are received, each once and in order.
    Queuing {
        /// How many can wait, 1 to 1024.
        depth: u32,
        /// What happens to one more.
        when_full: WhenFull,
    },
}

impl ChannelKind {
    /// The layout of such a channel in memory.
    ///
    /// # Errors
    /// If a number is out of the layout's bounds, which those of a checked file are not.
    pub const fn geometry(self, message_bytes: u32) -> Result<Geometry, GeometryError> {
        match self {
            ChannelKind::Sampling { .. } => Geometry::sampling(message_bytes),
            ChannelKind::Queuing { depth, when_full } => {
                Geometry::queuing(message_bytes, depth, when_full.policy())
            }
        }
    }
}

/// What happens to a message for a full queue.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenFull {
    /// The source is told so, and nothing is lost.
    #[default]
    Refuse,
    /// It replaces the oldest one, and the destination is told that one is lost.
    Overwrite,
}

impl WhenFull {
    /// What the layout calls it.
    #[must_use]
    pub const fn policy(self) -> Policy {
        match self {
            WhenFull::Refuse => Policy::Refuse,
            WhenFull::Overwrite => Policy::Overwrite,
        }
    }
}

/// Prints as it is written in the file.
impl fmt::Display for WhenFull {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            WhenFull::Refuse => "refuse",
            WhenFull::Overwrite => "overwrite",
        })
    }
}

/// One end of a channel: a port of its owner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct End {
    /// Whose it is.
    pub owner: Owner,
    /// Name of the port, unique with its owner; of the same form as a partition's name.
    pub port: String,
}

/// Who has an end of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Owner {
    /// A partition.
    Partition(PartitionId),
    /// Takt itself, for tools on the host.
    Host,
}

/// Checks all channels, in the order of the file.
pub fn check(
    tables: &[Spanned<Keys<raw::Channel>>],
    partitions: &[Checked],
    folder: &Path,
) -> Result<Vec<Channel>, Diagnostic> {
    if let Some(excess) = tables.get(CHANNELS_MAX) {
        let found = format!("this is channel {} of {}", CHANNELS_MAX + 1, tables.len());
        let allowed = format!("at most {CHANNELS_MAX} tables [[channel]]");
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    let mut ports = Ports::of(partitions);
    let mut channels: Vec<Channel> = Vec::with_capacity(tables.len());
    for table in tables {
        let Keys(raw) = table.get_ref();
        let next = check_one(raw, table.span(), partitions, folder)?;
        if let Some(other) = channels.iter().position(|c| c.name == next.name) {
            let found = format!("a second channel is named {}", quote(&next.name));
            return Err(Diagnostic::new(
                raw.name.span(),
                found,
                "a name of its own for each channel",
            )
            .and(tables[other].get_ref().0.name.span(), "the other one"));
        }
        ports.add(&next, raw)?;
        channels.push(next);
    }
    Ok(channels)
}

fn check_one(
    raw: &raw::Channel,
    header: Span,
    partitions: &[Checked],
    folder: &Path,
) -> Result<Channel, Diagnostic> {
    let name = check_name(&raw.name)?.to_owned();
    let kind = match raw.kind.get_ref().as_str() {
        "sampling" => check_sampling(raw, &name, header)?,
        "queuing" => check_queuing(raw, &name, header)?,
        other => {
            let found = format!("there is no kind {} of channels", quote(other));
            return Err(Diagnostic::new(raw.kind.span(), found, "\"sampling\" or \"queuing\""));
        }
    };
    let message_bytes = check_number(
        &raw.message_bytes,
        MESSAGE_MAX,
        "is not an allowed length of a message, in bytes",
    )?;
    let source = check_end(&raw.source, partitions)?;
    let ends = raw.destinations.get_ref().iter().map(|end| check_end(end, partitions));
    let destinations: Vec<End> = ends.collect::<Result<_, _>>()?;
    let mut channel =
        Channel { name, kind, message_bytes, source, destinations, doorbell: None, host: None };
    check_ends(&channel, raw, partitions)?;
    channel.doorbell = check_doorbell(&channel, raw, partitions)?;
    channel.host = host_ports::check(&channel, raw, folder)?;
    Ok(channel)
}

fn check_sampling(raw: &raw::Channel, name: &str, header: Span) -> Result<ChannelKind, Diagnostic> {
    let of_queuing = [
        ("depth", raw.depth.as_ref().map(Spanned::span)),
        ("when_full", raw.when_full.as_ref().map(Spanned::span)),
    ];
    for (key, span) in of_queuing {
        if let Some(span) = span {
            return Err(misplaced(raw, key, span, "queuing", "refresh_period"));
        }
    }
    let Some(refresh) = &raw.refresh_period else {
        let found =
            format!("channel {} of kind \"sampling\" has no key `refresh_period`", quote(name));
        let allowed = "`refresh_period = \"10ms\"`, the age up to which a message is valid";
        return Err(Diagnostic::new(header, found, allowed));
    };
    let length = refresh.get_ref().0;
    if length == Nanos::ZERO || length > REFRESH_MAX {
        let found = if length == Nanos::ZERO {
            format!("the refresh period of {length}: no message would ever be valid")
        } else {
            format!("the refresh period of {length} is too long")
        };
        let allowed = format!("more than nothing, and at most {REFRESH_MAX}");
        return Err(Diagnostic::new(refresh.span(), found, allowed));
    }
    Ok(ChannelKind::Sampling { refresh: length })
}

fn check_queuing(raw: &raw::Channel, name: &str, header: Span) -> Result<ChannelKind, Diagnostic> {
    if let Some(refresh) = &raw.refresh_period {
        let own = "depth and when_full";
        return Err(misplaced(raw, "refresh_period", refresh.span(), "sampling", own));
    }
    let Some(depth) = &raw.depth else {
        let found = format!("channel {} of kind \"queuing\" has no key `depth`", quote(name));
        let allowed = "`depth = 8`, the number of messages that can wait";
        return Err(Diagnostic::new(header, found, allowed));
    };
    let depth = check_number(depth, DEPTH_MAX, "is not an allowed depth of a queue, in messages")?;
    let when_full = match &raw.when_full {
        None => WhenFull::default(),
        Some(policy) => match policy.get_ref().as_str() {
            "refuse" => WhenFull::Refuse,
            "overwrite" => WhenFull::Overwrite,
            other => {
                let found = format!("there is no way {} to treat a full queue", quote(other));
                let allowed = "\"refuse\" or \"overwrite\"";
                return Err(Diagnostic::new(policy.span(), found, allowed));
            }
        },
    };
    Ok(ChannelKind::Queuing { depth, when_full })
}

/// A key of the kind `owner`. `own` are those that the channel's kind has to itself.
fn misplaced(raw: &raw::Channel, key: &str, span: Span, owner: &str, own: &str) -> Diagnostic {
    let [name, kind] = [&raw.name, &raw.kind].map(|text| quote(text.get_ref()));
    let found = format!("`{key}` belongs to kind \"{owner}\"; channel {name} is of kind {kind}");
    let allowed = format!(
        "for a {kind} channel: name, kind, message_bytes, source, destinations, doorbell, {own}, \
         and host_socket or host_file"
    );
    Diagnostic::new(span, found, allowed).and(raw.kind.span(), "its kind")
}

/// A number from 1 to `max`; `is_not` says of another one what it fails to be.
fn check_number(number: &Spanned<i64>, max: u32, is_not: &str) -> Result<u32, Diagnostic> {
    let value = *number.get_ref();
    u32::try_from(value).ok().filter(|n| (1..=max).contains(n)).ok_or_else(|| {
        Diagnostic::new(number.span(), format!("{value} {is_not}"), format!("1 to {max}"))
    })
}

fn check_end(end: &Spanned<String>, partitions: &[Checked]) -> Result<End, Diagnostic> {
    let Some((owner, port)) = end.get_ref().split_once(':') else {
        let found = format!("{} is not the end of a channel", quote(end.get_ref()));
        let allowed = "PARTITION:PORT, two names with a colon between them";
        return Err(Diagnostic::new(end.span(), found, allowed));
    };
    if owner == HOST {
        let port = check_word(port, end.span())?.to_owned();
        return Ok(End { owner: Owner::Host, port });
    }
    let owner = partition::find(partitions, owner, end.span())?;
    let port = check_word(port, end.span())?.to_owned();
    Ok(End { owner: Owner::Partition(owner.partition.id), port })
}

/// The rules for the ends of one channel among each other.
fn check_ends(
    channel: &Channel,
    raw: &raw::Channel,
    partitions: &[Checked],
) -> Result<(), Diagnostic> {
    let destinations = raw.destinations.get_ref();
    let queuing = matches!(channel.kind, ChannelKind::Queuing { .. });
    let allowed =
        if queuing { "exactly one in a queuing channel" } else { "at least one destination" };
    if destinations.is_empty() {
        let found = "the channel has no destination";
        return Err(Diagnostic::new(raw.destinations.span(), found, allowed));
    }
    if let Some(second) = destinations.get(1).filter(|_| queuing) {
        let found = "a second destination of a queuing channel";
        return Err(Diagnostic::new(second.span(), found, allowed).and(raw.kind.span(), "its kind"));
    }
    let ends: Vec<(&End, &Spanned<String>)> = channel.ends(raw).collect();
    for (i, (end, text)) in ends.iter().enumerate() {
        let same = |(other, _): &&(&End, &Spanned<String>)| other.owner == end.owner;
        if let Some((_, other)) = ends[..i].iter().find(same) {
            let (found, allowed) = match end.owner {
                Owner::Partition(id) => {
                    let name = quote(&partitions[id.0].partition.name);
                    let found = format!("the channel has two ends in partition {name}");
                    (found, "one end of a channel in a partition")
                }
                Owner::Host => (
                    "the channel has two ends on the host".to_owned(),
                    "one end of a channel there",
                ),
            };
            return Err(
                Diagnostic::new(text.span(), found, allowed).and(other.span(), "the other one")
            );
        }
    }
    Ok(())
}

/// A doorbell is for somebody who waits, and a PLC never does: it looks in each scan.
fn check_doorbell(
    channel: &Channel,
    raw: &raw::Channel,
    partitions: &[Checked],
) -> Result<Option<PartitionId>, Diagnostic> {
    let Some(doorbell) = raw.doorbell.as_ref().filter(|doorbell| *doorbell.get_ref()) else {
        return Ok(None);
    };
    if channel.source.owner == Owner::Host {
        let found = "the host is the source of a channel with a doorbell, and does not ring";
        let allowed = "`doorbell = true` with a source in a partition";
        return Err(
            Diagnostic::new(doorbell.span(), found, allowed).and(raw.source.span(), "the source")
        );
    }
    let linux = |end: &End| match end.owner {
        Owner::Partition(id) => {
            let kind = &partitions[id.0].partition.kind;
            matches!(kind, Kind::Linux { .. }).then_some(id)
        }
        Owner::Host => None,
    };
    let place = doorbell.span();
    let listeners: Vec<PartitionId> = channel.destinations.iter().filter_map(linux).collect();
    if linux(&channel.source).is_some() && !listeners.is_empty() {
        let found = "a Linux is the source of a channel with a doorbell, and does not ring";
        let allowed = "`doorbell = true` with a source in a partition of kind \"plc\"";
        return Err(Diagnostic::new(place, found, allowed).and(raw.source.span(), "the source"));
    }
    match listeners[..] {
        [] => {}
        [listener] => return Ok(Some(listener)),
        // KVM brings a ring to one machine.
        _ => {
            let found = "a doorbell for two Linuxes";
            let allowed = "one destination in a partition of kind \"linux\"; the source can have a \
                           channel with a doorbell for each";
            let ends = raw.destinations.span();
            return Err(Diagnostic::new(place, found, allowed).and(ends, "the destinations"));
        }
    }
    let name = quote(&channel.name);
    let found = format!("channel {name} has a doorbell, and no destination that waits for it");
    let allowed = "`doorbell = true` with a destination in a partition of kind \"linux\"; a PLC \
                   looks at its ports in each scan and never waits";
    Err(Diagnostic::new(doorbell.span(), found, allowed)
        .and(raw.destinations.span(), "the destinations"))
}

impl Channel {
    /// The source and then the destinations, each with its place in the file.
    pub(super) fn ends<'a>(
        &'a self,
        raw: &'a raw::Channel,
    ) -> impl Iterator<Item = (&'a End, &'a Spanned<String>)> {
        let ends = std::iter::once(&self.source).chain(&self.destinations);
        ends.zip(std::iter::once(&raw.source).chain(raw.destinations.get_ref()))
    }
}
