//! The channels of a system: their memory, and who sees what of it.
//!
//! Each end of a channel writes a region of its own: the source its messages, the destination of a
//! queuing channel how far it has read. A region is writable in one guest and read-only in all
//! others, by their memory slots. All of it exists before any guest runs. Takt writes the header of
//! a region whenever its owner is about to start, since an owner may have damaged it, and nothing
//! else.
//!
//! A PLC finds all of its regions in one area of its memory. A Linux finds them in the memory of a
//! PCI function, what it may write apart from what it may only read. Both are told where by a table
//! of the same form.

use std::ptr::NonNull;

use takt_abi::memory::{CHANNELS, PAGE};
use takt_abi::{PortTable, direction, port_kind};
use takt_channel::{Geometry, GeometryError, Misaligned, OpenError, OwnPages};
use takt_scheduler::table::PartitionId;
use thiserror::Error;
use vm_memory::{GuestAddress, GuestMemoryBackend, GuestMemoryRegion};

use crate::config::{Channel, ChannelKind, End, Kind, Owner};
use crate::memory::{GuestMemory, MemoryError, SharedRegion, View};

/// Channels could not be made.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum ChannelError {
    #[error("channel {channel}: {source}")]
    Memory { channel: String, source: MemoryError },
    #[error("channel {channel}: {source}")]
    Geometry { channel: String, source: GeometryError },
    #[error("a partition has no memory for its channel at {start:#x}")]
    Missing { start: u64 },
    #[error("cannot write the header of a channel's region: {0}")]
    Format(#[from] OpenError),
    #[error("cannot write the header of a channel's region: {0}")]
    Region(#[from] Misaligned),
}

/// The regions of one channel.
pub struct Regions<'a> {
    /// What the file says of it.
    pub channel: &'a Channel,
    /// Its layout.
    pub geometry: Geometry,
    /// What the source writes.
    pub source: SharedRegion,
    /// What the destination writes, of a queuing channel.
    pub destination: Option<SharedRegion>,
}

/// All channels of a system.
pub struct Channels<'a> {
    all: Vec<Regions<'a>>,
    /// The queues through which programs are asked and ordered, which are no channels of the file.
    live: Vec<Regions<'a>>,
}

/// What a partition sees of the channels.
pub struct Ports<'a> {
    /// Its memory, at the places that the table tells.
    pub views: Vec<View<'a>>,
    /// What it is told of it.
    pub table: PortTable,
    /// What of it is its own.
    pub own: Vec<OwnRegion>,
    /// The ports that ring, by their places in the table, each with the Linux that it wakes.
    pub rings: Vec<(u32, PartitionId)>,
}

/// Where the next region of a partition lies, in the terms of its port table.
enum Area {
    /// A PLC's: one guest-physical area for all.
    Shared(u64),
    /// A Linux's: offsets in two pieces of memory.
    Apart { read_write: u64, read_only: u64 },
}

impl Area {
    fn take(&mut self, bytes: u64, writable: bool) -> u64 {
        let next = match self {
            Area::Shared(next) => next,
            Area::Apart { read_write, .. } if writable => read_write,
            Area::Apart { read_only, .. } => read_only,
        };
        let start = *next;
        *next += bytes;
        start
    }
}

/// A region that a partition may write.
#[derive(Clone, Copy, Debug)]
pub struct OwnRegion {
    /// Guest-physical start, once it is [placed](Ports::place).
    start: u64,
    geometry: Geometry,
    is_source: bool,
}

impl OwnRegion {
    /// Writes its header. The guest in `memory` must not run.
    ///
    /// # Errors
    /// See [`ChannelError`].
    pub fn format(&self, memory: &GuestMemory) -> Result<(), ChannelError> {
        let region = memory.regions().find_region(GuestAddress(self.start));
        let region = region.ok_or(ChannelError::Missing { start: self.start })?;
        let start = NonNull::new(region.as_ptr()).ok_or(Misaligned)?;
        // SAFETY: the region is mapped writable, that long, for as long as `memory` lives; what
        // else in this process looks at it goes through mappings of its own.
        let mut pages = unsafe { OwnPages::new(start, region.len() as usize) }?;
        if self.is_source {
            self.geometry.format_source(&mut pages)?;
        } else {
            self.geometry.format_destination(&mut pages)?;
        }
        Ok(())
    }
}

impl<'a> Channels<'a> {
    /// Makes the memory of all channels.
    ///
    /// # Errors
    /// See [`ChannelError`].
    pub fn new(channels: &'a [Channel]) -> Result<Self, ChannelError> {
        let all = channels.iter().map(Regions::new).collect::<Result<_, _>>()?;
        Ok(Self { all, live: Vec::new() })
    }

    /// The same with the [queues](takt_plan::live_channels) through which programs are asked and ordered.
    ///
    /// # Errors
    /// See [`ChannelError`].
    pub fn with_live(self, live: &'a [Channel]) -> Result<Self, ChannelError> {
        Ok(Self { live: live.iter().map(Regions::new).collect::<Result<_, _>>()?, ..self })
    }

    /// Those queues, in the order in which they were given.
    pub fn live(&self) -> &[Regions<'a>] {
        &self.live
    }

    /// All of the file, in its order.
    pub fn all(&self) -> impl Iterator<Item = &Regions<'a>> {
        self.all.iter()
    }

    /// Those of which Takt itself has an end.
    pub fn of_host(&self) -> impl Iterator<Item = &Regions<'a>> {
        self.all.iter().filter(|regions| regions.channel.host.is_some())
    }

    /// What a partition of this kind has of them, laid out in the order of the file; the queues for
    /// programs come last.
    #[must_use]
    pub fn of(&self, partition: PartitionId, kind: &Kind) -> Ports<'_> {
        let mut ports = Ports {
            views: Vec::new(),
            table: PortTable::EMPTY,
            own: Vec::new(),
            rings: Vec::new(),
        };
        let owner = Owner::Partition(partition);
        let mut area = match kind {
            Kind::Plc { .. } => Area::Shared(CHANNELS),
            Kind::Linux { .. } => Area::Apart { read_write: 0, read_only: PAGE },
        };
        for regions in self.all.iter().chain(&self.live) {
            let channel = regions.channel;
            if channel.source.owner == owner {
                ports.add(regions, &channel.source, direction::SOURCE, &mut area);
            }
            let destinations = channel.destinations.iter();
            for end in destinations.filter(|end| end.owner == owner) {
                ports.add(regions, end, direction::DESTINATION, &mut area);
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
        let destination = match geometry.destination_bytes() {
            0 => None,
            bytes => Some(region(bytes)?),
        };
        Ok(Self { channel, geometry, source, destination })
    }
}

impl<'a> Ports<'a> {
    /// Puts memory that the table tells of by offsets where the two pieces really begin. The table
    /// stays as it is.
    pub fn place(&mut self, read_write: u64, read_only: u64) {
        for view in &mut self.views {
            view.start += if view.writable { read_write } else { read_only };
        }
        for region in &mut self.own {
            region.start += read_write;
        }
    }

    /// Bytes of all regions that the partition may write, or of all that it may only read.
    #[must_use]
    pub fn bytes(&self, writable: bool) -> u64 {
        let views = self.views.iter().filter(|view| view.writable == writable);
        views.map(|view| view.region.bytes()).sum()
    }

    fn add(&mut self, regions: &'a Regions<'_>, end: &End, direction: u32, area: &mut Area) {
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
        port.doorbell = channel.doorbell.is_some().into();
        let (source, destination) = (Some(&regions.source), regions.destination.as_ref());
        let is_source = direction == direction::SOURCE;
        let listener = channel.doorbell.filter(|_| is_source);
        self.rings.extend(listener.map(|listener| (self.table.count - 1, listener)));
        let (own, peer) = if is_source { (source, destination) } else { (destination, source) };
        (port.own, port.own_pages) = place(&mut self.views, own, true, area);
        if own.is_some() {
            self.own.push(OwnRegion { start: port.own, geometry: regions.geometry, is_source });
        }
        (port.peer, port.peer_pages) = place(&mut self.views, peer, false, area);
    }
}

/// Gives a region the next place in the area; returns where, and its length in pages.
fn place<'a>(
    views: &mut Vec<View<'a>>,
    region: Option<&'a SharedRegion>,
    writable: bool,
    area: &mut Area,
) -> (u64, u32) {
    let Some(region) = region else { return (0, 0) };
    let start = area.take(region.bytes(), writable);
    views.push(View { start, region, writable });
    (start, (region.bytes() / PAGE) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::WhenFull;
    use crate::memory::Pages;
    use std::path::PathBuf;
    use takt_channel::{Load, PeerPages, QueuingDestination, QueuingSource};
    use takt_scheduler::time::Nanos;
    use vm_memory::Bytes;

    const RAM: u64 = 2 << 20;
    const PLC: Kind = Kind::Plc { image: None };

    fn channel(name: &str, kind: ChannelKind, from: usize, to: &[usize]) -> Channel {
        let owner = |p: usize| Owner::Partition(PartitionId(p));
        let end = |p: usize| End { owner: owner(p), port: format!("{name}-{p}") };
        Channel {
            name: name.to_owned(),
            kind,
            message_bytes: 16,
            source: end(from),
            destinations: to.iter().copied().map(end).collect(),
            doorbell: (name == "orders").then_some(PartitionId(to[0])),
            host: None,
        }
    }

    fn channels() -> [Channel; 2] {
        let sampling = ChannelKind::Sampling { refresh: Nanos::from_millis(3) };
        let queuing = ChannelKind::Queuing { depth: 2, when_full: WhenFull::Refuse };
        [channel("state", sampling, 0, &[1, 2]), channel("orders", queuing, 1, &[0])]
    }

    fn rights(ports: &Ports<'_>) -> Vec<(u64, bool)> {
        ports.views.iter().map(|view| (view.start, view.writable)).collect()
    }

    #[test]
    fn each_region_is_writable_for_one_partition_only() {
        let channels = channels();
        let all = Channels::new(&channels).unwrap();
        let [source, both, reader, without] = [0, 1, 2, 3].map(|p| all.of(PartitionId(p), &PLC));
        let page = |n| CHANNELS + n * PAGE;
        // Its state; what it has read of the orders, and the orders.
        assert_eq!(rights(&source), [(page(0), true), (page(1), true), (page(2), false)]);
        assert_eq!(rights(&both), [(page(0), false), (page(1), true), (page(2), false)]);
        assert_eq!(rights(&reader), [(page(0), false)]);
        assert_eq!((without.views.len(), without.table.count), (0, 0));
        assert_eq!((source.own.len(), both.own.len(), reader.own.len()), (2, 1, 0));
    }

    #[test]
    fn the_port_table_says_what_the_file_says() {
        let channels = channels();
        let all = Channels::new(&channels).unwrap();
        let table = all.of(PartitionId(0), &PLC).table;
        assert_eq!(table.count, 2);
        let [state, orders, ..] = table.ports;
        assert!(state.name.starts_with(b"state-0\0") && orders.name.starts_with(b"orders-0\0"));
        assert_eq!((state.kind, state.direction), (port_kind::SAMPLING, direction::SOURCE));
        assert_eq!((orders.kind, orders.direction), (port_kind::QUEUING, direction::DESTINATION));
        assert_eq!((state.maximum, state.refresh_ns, state.peer), (16, 3_000_000, 0));
        assert_eq!((orders.depth, orders.policy, orders.own_pages), (2, 1, 1));
        assert_eq!((state.doorbell, orders.doorbell), (0, 1));
        let rings = |p| all.of(PartitionId(p), &PLC).rings;
        assert_eq!((rings(0), rings(1)), (vec![], vec![(1, PartitionId(0))]));
        assert_eq!(table.ports[2].kind, 0);
    }

    #[test]
    fn a_linux_sees_the_same_regions_as_offsets_in_two_pieces_of_memory() {
        let linux = Kind::Linux { kernel: PathBuf::new(), initrd: None, cmdline: String::new() };
        let channels = channels();
        let all = Channels::new(&channels).unwrap();
        let mut ports = all.of(PartitionId(0), &linux);
        let [state, orders, ..] = ports.table.ports;
        assert_eq!((state.own, state.own_pages, state.peer_pages), (0, 1, 0));
        // The acknowledgement behind the state, and the orders behind the table's page.
        assert_eq!((orders.own, orders.peer, orders.peer_pages), (PAGE, PAGE, 1));
        assert_eq!((ports.bytes(true), ports.bytes(false)), (2 * PAGE, PAGE));
        ports.place(0x10_0000, 0x20_0000);
        let expected = [(0x10_0000, true), (0x10_1000, true), (0x20_1000, false)];
        assert_eq!(rights(&ports), expected);
        assert_eq!(
            ports.own.iter().map(|own| own.start).collect::<Vec<_>>(),
            [0x10_0000, 0x10_1000]
        );
        assert_eq!(ports.table.ports[1].own, PAGE, "the table's offsets stay");
        let memory = GuestMemory::for_linux(1 << 20, Pages::Small, &ports.views, 0).unwrap();
        ports.own.iter().for_each(|region| region.format(&memory).unwrap());
        let magic: u32 = memory.regions().read_obj(GuestAddress(0x10_0000)).unwrap();
        assert_eq!(magic.to_le_bytes(), *b"TKCH");
    }

    #[test]
    fn a_header_that_its_owner_has_damaged_is_whole_after_a_restart() {
        let channels = channels();
        let all = Channels::new(&channels).unwrap();
        let memory = [0, 1].map(|p| {
            let ports = all.of(PartitionId(p), &PLC);
            let memory = GuestMemory::for_plc(RAM, Pages::Small, &ports.views).unwrap();
            ports.own.iter().for_each(|region| region.format(&memory).unwrap());
            memory
        });
        let place = |guest: usize, page: u64| {
            let region = memory[guest].regions().find_region(GuestAddress(CHANNELS + page * PAGE));
            (NonNull::new(region.unwrap().as_ptr()).unwrap(), PAGE as usize)
        };
        // SAFETY: mapped for as long as `memory` lives; read and written by this test only.
        let (own, peer) = unsafe {
            let ((own, length), (peer, _)) = (place(1, 1), place(1, 2));
            (OwnPages::new(own, length).unwrap(), PeerPages::new(peer, length).unwrap())
        };
        let geometry = channels[1].kind.geometry(16).unwrap();
        assert!(own.words() > 0);
        QueuingSource::open(own, peer, &geometry).unwrap();

        let start = GuestAddress(CHANNELS + PAGE);
        memory[1].regions().write_obj(0u64, start).unwrap();
        // SAFETY: as above.
        let open = || unsafe {
            let ((own, length), (peer, _)) = (place(0, 1), place(0, 2));
            let (peer, own) = (PeerPages::new(peer, length), OwnPages::new(own, length));
            QueuingDestination::open(peer.unwrap(), own.unwrap(), &geometry).map(|_| ())
        };
        assert!(open().is_err(), "the damage is not seen");
        all.of(PartitionId(1), &PLC).own[0].format(&memory[1]).unwrap();
        assert_eq!(open(), Ok(()));
    }
}
