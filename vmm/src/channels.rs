//! The channels of a system: their memory, and who sees what of it.
//!
//! Each end of a channel writes a region of its own: the source its messages, the destination of a
//! queuing channel how far it has read. A region is writable in one guest and read-only in all
//! others, by their memory slots. All of it exists, and has its headers, before any guest runs;
//! Takt then neither reads nor writes it again.

use std::ptr::NonNull;

use takt_abi::memory::{CHANNELS, PAGE};
use takt_abi::{PORTS_MAX, Port, PortTable, direction, port_kind};
use takt_channel::{GeometryError, Misaligned, OpenError, OwnPages};
use takt_scheduler::table::PartitionId;
use thiserror::Error;
use vm_memory::GuestMemoryRegion;

use crate::config::{Channel, ChannelKind, End};
use crate::memory::{MemoryError, SharedRegion, View};

/// Channels could not be made.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum ChannelError {
    #[error("channel {channel}: {source}")]
    Memory { channel: String, source: MemoryError },
    #[error("channel {channel}: {source}")]
    Geometry { channel: String, source: GeometryError },
    #[error("channel {channel}: {source}")]
    Format { channel: String, source: OpenError },
    #[error("channel {channel}: {source}")]
    Region { channel: String, source: Misaligned },
}

/// The regions of one channel.
struct Regions<'a> {
    channel: &'a Channel,
    source: SharedRegion,
    /// Of a queuing channel.
    destination: Option<SharedRegion>,
}

/// All channels of a system.
pub struct Channels<'a> {
    all: Vec<Regions<'a>>,
}

/// What a partition sees of the channels.
pub struct Ports<'a> {
    /// Its memory.
    pub views: Vec<View<'a>>,
    /// What it is told of it.
    pub table: PortTable,
}

impl<'a> Channels<'a> {
    /// Makes the memory of all channels.
    ///
    /// # Errors
    /// See [`ChannelError`].
    pub fn new(channels: &'a [Channel]) -> Result<Self, ChannelError> {
        Ok(Self { all: channels.iter().map(Regions::new).collect::<Result<_, _>>()? })
    }

    /// What a partition has of them, laid out in its channel area in the order of the file.
    #[must_use]
    pub fn of(&self, partition: PartitionId) -> Ports<'_> {
        let none = Port {
            name: [0; 32],
            kind: 0,
            direction: 0,
            maximum: 0,
            depth: 0,
            policy: 0,
            own_pages: 0,
            refresh_ns: 0,
            own: 0,
            peer: 0,
            peer_pages: 0,
            reserved: [0; 3],
        };
        let mut ports = Ports {
            views: Vec::new(),
            table: PortTable { count: 0, reserved: 0, ports: [none; PORTS_MAX] },
        };
        let mut next = CHANNELS;
        for regions in &self.all {
            let channel = regions.channel;
            if channel.source.partition == partition {
                ports.add(regions, &channel.source, direction::SOURCE, &mut next);
            }
            let destinations = channel.destinations.iter();
            for end in destinations.filter(|end| end.partition == partition) {
                ports.add(regions, end, direction::DESTINATION, &mut next);
            }
        }
        ports
    }
}

impl<'a> Regions<'a> {
    fn new(channel: &'a Channel) -> Result<Self, ChannelError> {
        let name = || channel.name.clone();
        let geometry = channel
            .kind
            .geometry(channel.message_bytes)
            .map_err(|source| ChannelError::Geometry { channel: name(), source })?;
        let region = |bytes: usize| {
            SharedRegion::new((bytes as u64).next_multiple_of(PAGE))
                .map_err(|source| ChannelError::Memory { channel: name(), source })
        };
        let source = region(geometry.source_bytes())?;
        format(&source, name, |pages| geometry.format_source(pages))?;
        let destination = match geometry.destination_bytes() {
            0 => None,
            bytes => {
                let destination = region(bytes)?;
                format(&destination, name, |pages| geometry.format_destination(pages))?;
                Some(destination)
            }
        };
        Ok(Self { channel, source, destination })
    }
}

/// Writes a region's header, through a mapping that is gone afterwards.
fn format(
    region: &SharedRegion,
    channel: impl Fn() -> String,
    write: impl FnOnce(&mut OwnPages<'_>) -> Result<(), OpenError>,
) -> Result<(), ChannelError> {
    let mapping =
        region.map().map_err(|source| ChannelError::Memory { channel: channel(), source })?;
    // The end of a mapping is page-aligned and its start is not null.
    let start = NonNull::new(mapping.as_ptr()).unwrap_or(NonNull::dangling());
    // SAFETY: the mapping is writable, that long, and lives until the end of this function; nobody
    // else in this process has one of the region.
    let pages = unsafe { OwnPages::new(start, mapping.len() as usize) };
    let mut pages = pages.map_err(|source| ChannelError::Region { channel: channel(), source })?;
    write(&mut pages).map_err(|source| ChannelError::Format { channel: channel(), source })
}

impl<'a> Ports<'a> {
    fn add(&mut self, regions: &'a Regions<'_>, end: &End, direction: u32, next: &mut u64) {
        let Some(port) = self.table.ports.get_mut(self.table.count as usize) else { return };
        self.table.count += 1;
        for (slot, byte) in port.name.iter_mut().zip(end.port.bytes()) {
            *slot = byte;
        }
        let channel = regions.channel;
        (port.kind, port.depth, port.policy, port.refresh_ns) = match channel.kind {
            ChannelKind::Sampling { refresh } => (port_kind::SAMPLING, 1, 0, refresh.0),
            ChannelKind::Queuing { depth, when_full } => {
                (port_kind::QUEUING, depth, when_full.policy() as u32, 0)
            }
        };
        port.direction = direction;
        port.maximum = channel.message_bytes;
        let (source, destination) = (Some(&regions.source), regions.destination.as_ref());
        let (own, peer) = if direction == direction::SOURCE {
            (source, destination)
        } else {
            (destination, source)
        };
        (port.own, port.own_pages) = place(&mut self.views, own, true, next);
        (port.peer, port.peer_pages) = place(&mut self.views, peer, false, next);
    }
}

/// Gives a region the next place in the channel area; returns where, and its length in pages.
fn place<'a>(
    views: &mut Vec<View<'a>>,
    region: Option<&'a SharedRegion>,
    writable: bool,
    next: &mut u64,
) -> (u64, u32) {
    let Some(region) = region else { return (0, 0) };
    let start = *next;
    *next += region.bytes();
    views.push(View { start, region, writable });
    (start, (region.bytes() / PAGE) as u32)
}
