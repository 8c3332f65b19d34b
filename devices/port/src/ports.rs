//! The ports of this partition, and how a process takes one.

use std::path::{Path, PathBuf};

use takt_channel::{
    OpenError, OwnPages, PeerPages, QueuingDestination, QueuingSource, SamplingDestination,
    SamplingSource,
};

use crate::claim::{Claim, claim};
use crate::clock::Clock;
use crate::error::{PortError, PortsError};
use crate::function;
use crate::map::Map;
use crate::queuing::{Receiver, Sender};
use crate::sampling::{Input, Output};
use crate::table::{Direction, Kind, Port, Region, Table, TableError};
use crate::wait::Waiter;

/// What a new owner of an end does with what the one before has left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Goes on with it: processes that follow each other lose nothing and are one end.
    Attach,
    /// Begins anew: the channel is empty, and the other end notices a start.
    Open,
}

/// All ports of this partition.
#[derive(Debug)]
pub struct Ports {
    folder: PathBuf,
    uio: Option<PathBuf>,
    table: Table,
    readable: Map,
    writable: Map,
}

impl Ports {
    /// Finds them on the PCI bus. Needs root.
    ///
    /// # Errors
    /// See [`PortsError`].
    pub fn discover() -> Result<Ports, PortsError> {
        Self::open(&function::find(Path::new("/sys/bus/pci/devices"))?)
    }

    /// The ports of a function by its folder in sysfs, or by any folder with files `resource1` and
    /// `resource2` like those.
    ///
    /// # Errors
    /// See [`PortsError`].
    pub fn open(folder: &Path) -> Result<Ports, PortsError> {
        let readable = Map::readable(folder, 1)?;
        let writable = Map::writable(folder, 2)?;
        let table = match readable.whole() {
            Some(page) => Table::read(&page, readable.bytes(), writable.bytes())?,
            None => return Err(TableError::TooSmall(readable.bytes()).into()),
        };
        let uio = function::uio(folder);
        Ok(Ports { folder: folder.to_owned(), uio, table, readable, writable })
    }

    /// The ports, in the order of the partition file.
    #[must_use]
    pub fn list(&self) -> &[Port] {
        &self.table.ports
    }

    /// The clock of the stamps.
    #[must_use]
    pub fn clock(&self) -> Clock {
        self.table.clock
    }

    /// The folder of the function.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The device at which doorbells are waited for, if there is one.
    #[must_use]
    pub fn uio(&self) -> Option<&Path> {
        self.uio.as_deref()
    }

    /// A port by its name.
    ///
    /// # Errors
    /// [`PortError::Unknown`].
    pub fn port(&self, name: &str) -> Result<&Port, PortError> {
        self.list().iter().find(|port| port.name == name).ok_or_else(|| PortError::Unknown {
            name: name.to_owned(),
            has: self.list().iter().map(|port| port.name.clone()).collect(),
        })
    }

    /// Takes the source of a sampling channel.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn output(&self, name: &str, start: Start) -> Result<Output<'_>, PortError> {
        let (port, claim) = self.take(name, Direction::Source, "sampling")?;
        let own = self.own(port)?;
        let end = match start {
            Start::Attach => SamplingSource::attach(own, &port.geometry),
            Start::Open => SamplingSource::open(own, &port.geometry),
        }
        .map_err(|error| failed(port, error))?;
        Ok(Output { end, clock: self.clock(), _claim: claim })
    }

    /// Takes a destination of a sampling channel.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn input(&self, name: &str, start: Start) -> Result<Input<'_>, PortError> {
        let (port, claim) = self.take(name, Direction::Destination, "sampling")?;
        let waiter = self.waiter(port)?;
        let refresh = match port.kind {
            Kind::Sampling { refresh } => self.clock().ticks(refresh),
            Kind::Queuing { .. } => return Err(failed(port, OpenError::NotSampling)),
        };
        let peer = self.peer(port)?;
        let end = match start {
            Start::Attach => SamplingDestination::attach(peer, &port.geometry, refresh),
            Start::Open => SamplingDestination::open(peer, &port.geometry, refresh),
        }
        .map_err(|error| failed(port, error))?;
        Ok(Input { end, waiter, clock: self.clock(), _claim: claim })
    }

    /// Takes the source of a queuing channel.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn sender(&self, name: &str, start: Start) -> Result<Sender<'_>, PortError> {
        let (port, claim) = self.take(name, Direction::Source, "queuing")?;
        let (own, peer) = (self.own(port)?, self.peer(port)?);
        let end = match start {
            Start::Attach => QueuingSource::attach(own, peer, &port.geometry),
            Start::Open => QueuingSource::open(own, peer, &port.geometry),
        }
        .map_err(|error| failed(port, error))?;
        Ok(Sender { end, clock: self.clock(), _claim: claim })
    }

    /// Takes the destination of a queuing channel.
    ///
    /// # Errors
    /// See [`PortError`].
    pub fn receiver(&self, name: &str, start: Start) -> Result<Receiver<'_>, PortError> {
        let (port, claim) = self.take(name, Direction::Destination, "queuing")?;
        let waiter = self.waiter(port)?;
        let (peer, own) = (self.peer(port)?, self.own(port)?);
        let end = match start {
            Start::Attach => QueuingDestination::attach(peer, own, &port.geometry),
            Start::Open => QueuingDestination::open(peer, own, &port.geometry),
        }
        .map_err(|error| failed(port, error))?;
        Ok(Receiver { end, waiter, _claim: claim })
    }

    /// The file of the function that the partition writes, and that claims lock.
    pub(crate) fn writable_file(&self) -> PathBuf {
        self.folder.join("resource2")
    }

    /// The port's own region to look at, if it has one.
    pub(crate) fn look_at_own(&self, port: &Port) -> Option<PeerPages<'_>> {
        self.writable.peer(port.own?)
    }

    /// The region of the other end to look at, if there is one.
    pub(crate) fn look_at_peer(&self, port: &Port) -> Option<PeerPages<'_>> {
        self.readable.peer(port.peer?)
    }

    fn take(
        &self,
        name: &str,
        direction: Direction,
        kind: &str,
    ) -> Result<(&Port, Claim), PortError> {
        let port = self.port(name)?;
        if port.kind.name() != kind {
            return Err(PortError::Kind { name: name.to_owned(), is: port.kind.name() });
        }
        if port.direction != direction {
            return Err(PortError::Direction { name: name.to_owned(), is: port.direction });
        }
        let claim = claim(&self.writable_file(), port.index)?;
        Ok((port, claim.ok_or_else(|| PortError::Busy(name.to_owned()))?))
    }

    fn own(&self, port: &Port) -> Result<OwnPages<'_>, PortError> {
        port.own.and_then(|region| self.writable.own(region)).ok_or_else(|| absent(port, port.own))
    }

    fn peer(&self, port: &Port) -> Result<PeerPages<'_>, PortError> {
        self.look_at_peer(port).ok_or_else(|| absent(port, port.peer))
    }

    fn waiter(&self, port: &Port) -> Result<Waiter, PortsError> {
        match &self.uio {
            Some(uio) if port.doorbell => Waiter::listening(uio, &self.folder),
            _ => Ok(Waiter::polling()),
        }
    }
}

fn failed(port: &Port, error: OpenError) -> PortError {
    PortError::Open { name: port.name.clone(), error }
}

/// A region that is not within the memory, which the check of the table leaves no room for.
fn absent(port: &Port, region: Option<Region>) -> PortError {
    let needed = region.map_or(0, |region| usize::try_from(region.bytes).unwrap_or(usize::MAX));
    failed(port, OpenError::TooSmall { needed, given: 0 })
}
