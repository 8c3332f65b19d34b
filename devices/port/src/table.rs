//! The table of ports: from words in shared memory to ports that can be used.
//!
//! Every number in it becomes an address, a length or a choice, so each is checked here, once, and
//! what comes out needs no check any more.

use std::mem::offset_of;
use std::time::Duration;

use takt_abi::{PORTS_MAX, Port as Entry, PortTable, direction, memory, port_kind};
use takt_channel::{Geometry, GeometryError, Load, Policy};
use thiserror::Error;

use crate::clock::Clock;

/// A part of the function's memory, in bytes from the start of that memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// Where it begins.
    pub offset: u64,
    /// How long it is.
    pub bytes: u64,
}

/// The direction of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// This partition sends.
    Source,
    /// This partition receives.
    Destination,
}

impl Direction {
    /// `source` or `destination`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Source => "source",
            Self::Destination => "destination",
        }
    }
}

/// The kind of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The newest message.
    Sampling {
        /// Age up to which a message is valid; it matters to destinations.
        refresh: Duration,
    },
    /// All messages in order.
    Queuing {
        /// Messages that can wait.
        depth: u32,
        /// What happens to one more.
        policy: Policy,
    },
}

impl Kind {
    /// `sampling` or `queuing`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sampling { .. } => "sampling",
            Self::Queuing { .. } => "queuing",
        }
    }
}

/// A port of this partition.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Its place in the table.
    pub index: u32,
    /// Its name in the partition file.
    pub name: String,
    /// Its direction.
    pub direction: Direction,
    /// Its kind.
    pub kind: Kind,
    /// Longest message in bytes.
    pub maximum: u32,
    /// Whether the source rings after each message. No source in a Linux does.
    pub doorbell: bool,
    /// Shape of the channel.
    pub(crate) geometry: Geometry,
    /// The region that this partition writes, in the function's writable memory.
    pub(crate) own: Option<Region>,
    /// The region that the other end writes, in the function's readable memory.
    pub(crate) peer: Option<Region>,
}

/// Why the table cannot be used. It is Takt's own, so each of these is a defect of Takt, or
/// another version of it.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TableError {
    /// The memory that it should be in is shorter than a page.
    #[error("its memory has {0} bytes, less than a page")]
    TooSmall(u64),
    /// It does not begin as a table does.
    #[error("it begins with {0:#x} and not with {magic:#x}", magic = takt_abi::MAGIC)]
    Magic(u32),
    /// It is of another version.
    #[error("it has version {0}, this program knows version {known}", known = takt_abi::VERSION)]
    Version(u32),
    /// It says that it has more ports than fit in it.
    #[error("it has {0} ports, at most {PORTS_MAX} fit")]
    Count(u32),
    /// The clock has no frequency.
    #[error("the frequency of the time-stamp counter is 0")]
    Frequency,
    /// A port is impossible.
    #[error("port {index}: {defect}")]
    Port {
        /// Its place in the table.
        index: u32,
        /// What is wrong with it.
        defect: Defect,
    },
}

/// What is wrong with a port of the table.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum Defect {
    /// The name is empty, not printable, or does not end.
    #[error("its name is not a printable word of at most 32 characters")]
    Name,
    /// Another one before it has the same name.
    #[error("its name {0} is taken")]
    Duplicate(String),
    /// Neither sampling nor queuing.
    #[error("kind {0} is neither sampling nor queuing")]
    Kind(u32),
    /// Neither source nor destination.
    #[error("direction {0} is neither source nor destination")]
    Direction(u32),
    /// Not a policy of this kind of channel.
    #[error("policy {0} does not exist for its kind")]
    Policy(u32),
    /// Messages or queue of an impossible length.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// A sampling destination without a refresh period.
    #[error("its refresh period is 0")]
    Refresh,
    /// Neither 0 nor 1.
    #[error("its doorbell is {0}, neither 0 nor 1")]
    Doorbell(u32),
    /// A region that this kind of port does not have.
    #[error("it has a {which} region, which such a port does not have")]
    Superfluous {
        /// `read-only` or `read-write`.
        which: &'static str,
    },
    /// A region that cannot hold the channel.
    #[error("its {which} region has {found} bytes, the channel needs {needed}")]
    TooSmall {
        /// `read-only` or `read-write`.
        which: &'static str,
        /// Its length.
        found: u64,
        /// What it needs.
        needed: u64,
    },
    /// A region that is not on whole pages of the memory that there is.
    #[error(
        "its {which} region at {offset:#x} with {bytes} bytes is not on pages from {first:#x} to {end:#x}"
    )]
    Place {
        /// `read-only` or `read-write`.
        which: &'static str,
        /// Where it begins.
        offset: u64,
        /// How long it is.
        bytes: u64,
        /// Where the first region can be.
        first: u64,
        /// Where the memory ends.
        end: u64,
    },
}

/// A table that has been checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Table {
    pub(crate) clock: Clock,
    pub(crate) ports: Vec<Port>,
}

impl Table {
    /// Reads and checks the table at the start of the readable memory. The lengths are those of both
    /// memories in bytes.
    pub(crate) fn read(
        page: &impl Load,
        readable: u64,
        writable: u64,
    ) -> Result<Table, TableError> {
        if readable < memory::PAGE {
            return Err(TableError::TooSmall(readable));
        }
        let words = Words(page);
        match words.u32(offset_of!(PortTable, magic)) {
            takt_abi::MAGIC => {}
            other => return Err(TableError::Magic(other)),
        }
        match words.u32(offset_of!(PortTable, version)) {
            takt_abi::VERSION => {}
            other => return Err(TableError::Version(other)),
        }
        let count = words.u32(offset_of!(PortTable, count));
        if count as usize > PORTS_MAX {
            return Err(TableError::Count(count));
        }
        let khz = words.u64(offset_of!(PortTable, tsc_khz));
        if khz == 0 {
            return Err(TableError::Frequency);
        }
        let mut ports: Vec<Port> = Vec::new();
        for index in 0..count {
            let at = offset_of!(PortTable, ports) + index as usize * size_of::<Entry>();
            let port = port(&words, at, index, readable, writable).and_then(|port| {
                match ports.iter().any(|other| other.name == port.name) {
                    true => Err(Defect::Duplicate(port.name)),
                    false => Ok(port),
                }
            });
            ports.push(port.map_err(|defect| TableError::Port { index, defect })?);
        }
        Ok(Table { clock: Clock::new(khz), ports })
    }
}

/// Fields by their offset in bytes.
struct Words<'a, L>(&'a L);

impl<L: Load> Words<'_, L> {
    fn u64(&self, offset: usize) -> u64 {
        self.0.load(offset / 8)
    }

    fn u32(&self, offset: usize) -> u32 {
        (self.u64(offset) >> (offset % 8 * 8)) as u32
    }
}

fn port(
    words: &Words<'_, impl Load>,
    at: usize,
    index: u32,
    readable: u64,
    writable: u64,
) -> Result<Port, Defect> {
    let name = name(words, at + offset_of!(Entry, name))?;
    let maximum = words.u32(at + offset_of!(Entry, maximum));
    let refresh = words.u64(at + offset_of!(Entry, refresh_ns));
    let depth = words.u32(at + offset_of!(Entry, depth));
    let policy = words.u32(at + offset_of!(Entry, policy));
    let direction = match words.u32(at + offset_of!(Entry, direction)) {
        direction::SOURCE => Direction::Source,
        direction::DESTINATION => Direction::Destination,
        other => return Err(Defect::Direction(other)),
    };
    let (kind, geometry) = match words.u32(at + offset_of!(Entry, kind)) {
        port_kind::SAMPLING => {
            if policy != 0 {
                return Err(Defect::Policy(policy));
            }
            if refresh == 0 && direction == Direction::Destination {
                return Err(Defect::Refresh);
            }
            let refresh = Duration::from_nanos(refresh);
            (Kind::Sampling { refresh }, Geometry::sampling(maximum)?)
        }
        port_kind::QUEUING => {
            let policy = [Policy::Refuse, Policy::Overwrite]
                .into_iter()
                .find(|known| *known as u32 == policy)
                .ok_or(Defect::Policy(policy))?;
            (Kind::Queuing { depth, policy }, Geometry::queuing(maximum, depth, policy)?)
        }
        other => return Err(Defect::Kind(other)),
    };
    let doorbell = match words.u32(at + offset_of!(Entry, doorbell)) {
        flag @ 0..=1 => flag == 1,
        other => return Err(Defect::Doorbell(other)),
    };
    let (messages, acknowledgement) =
        (geometry.source_bytes() as u64, geometry.destination_bytes() as u64);
    let (own_needs, peer_needs) = match direction {
        Direction::Source => (messages, acknowledgement),
        Direction::Destination => (acknowledgement, messages),
    };
    let given = |start, pages| Region {
        offset: words.u64(at + start),
        bytes: u64::from(words.u32(at + pages)) * memory::PAGE,
    };
    let own = given(offset_of!(Entry, own), offset_of!(Entry, own_pages));
    let peer = given(offset_of!(Entry, peer), offset_of!(Entry, peer_pages));
    Ok(Port {
        index,
        name,
        direction,
        kind,
        maximum,
        doorbell,
        geometry,
        own: check("read-write", own, own_needs, 0, writable)?,
        // The table itself is in the first page.
        peer: check("read-only", peer, peer_needs, memory::PAGE, readable)?,
    })
}

/// A region that needs so many bytes, between two offsets; `None` if it needs none.
fn check(
    which: &'static str,
    region: Region,
    needed: u64,
    first: u64,
    end: u64,
) -> Result<Option<Region>, Defect> {
    let Region { offset, bytes } = region;
    if needed == 0 {
        return if bytes == 0 { Ok(None) } else { Err(Defect::Superfluous { which }) };
    }
    if bytes < needed {
        return Err(Defect::TooSmall { which, found: bytes, needed });
    }
    let inside = offset >= first && offset.checked_add(bytes).is_some_and(|last| last <= end);
    if !inside || !offset.is_multiple_of(memory::PAGE) {
        return Err(Defect::Place { which, offset, bytes, first, end });
    }
    Ok(Some(region))
}

fn name(words: &Words<'_, impl Load>, at: usize) -> Result<String, Defect> {
    let field = [0, 8, 16, 24].map(|more| words.u64(at + more).to_le_bytes());
    let field = field.as_flattened();
    let end = field.iter().position(|byte| *byte == 0).unwrap_or(field.len());
    let (name, rest) = field.split_at(end);
    let word = !name.is_empty() && name.iter().all(u8::is_ascii_graphic);
    if !word || rest.iter().any(|byte| *byte != 0) {
        return Err(Defect::Name);
    }
    String::from_utf8(name.to_vec()).map_err(|_| Defect::Name)
}

#[cfg(test)]
#[path = "table_tests.rs"]
mod tests;
