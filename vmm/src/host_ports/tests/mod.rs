//! Ports on the host with real sockets and files. The partition at the other end is played by the
//! test, through mappings of its own as a guest has.

mod clients;
mod files;
mod hostile;
mod socket_files;

use std::fs;
use std::io::ErrorKind;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use takt_channel::{
    Load, QueuingDestination, QueuingSource, ReceiveError, SamplingDestination, SamplingSource,
    Store, Ticks, offset,
};
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::{Nanos, Tsc};
use vmm_sys_util::tempdir::TempDir;

use super::packet::{HEADER, Header, LOST, VALID};
use super::pages::{Own, Peer};
use super::seqpacket::{Came, Connection, Sent};
use super::*;
use crate::config::{Channel, ChannelKind, End, WhenFull};
use crate::unix_socket;

/// One tick of the counter is a microsecond.
const KHZ: u32 = 1_000;
const EPOCH: Tsc = Tsc(1_000_000);
const SAMPLING: ChannelKind = ChannelKind::Sampling { refresh: Nanos::from_millis(5) };
const MAXIMUM: u32 = 64;

/// Longer than any test may need; reached only if one fails.
const LONG: Duration = Duration::from_secs(60);

/// A thread that is not shut in.
fn spawn(_: &str, _: Kind, work: Box<dyn FnOnce() + Send>) -> Result<(), ThreadError> {
    std::thread::spawn(work);
    Ok(())
}

/// Whether all that is in a file was sent.
fn is_over(ports: &HostPorts) -> bool {
    let over = |port: &Port| matches!(&port.way, Way::FileSource(file) if file.is_over());
    ports.ports.iter().any(over)
}

pub(super) fn queuing(depth: u32, when_full: WhenFull) -> ChannelKind {
    ChannelKind::Queuing { depth, when_full }
}

/// Connects as a client does.
fn connect(path: &Path) -> std::io::Result<Connection> {
    unix_socket::connect(path, SocketKind::Packets).map(Connection)
}

/// A channel between partition 0 and the host, and the folder in which its path lies.
pub(super) struct Bench {
    folder: TempDir,
    channels: &'static Channels<'static>,
    pub(super) clock: Timebase,
    /// In microseconds since the epoch.
    now: u64,
}

impl Bench {
    pub(super) fn new(
        kind: ChannelKind,
        maximum: u32,
        host: fn(PathBuf) -> HostPort,
        sends: bool,
    ) -> Self {
        let folder = TempDir::new().unwrap();
        let host = Some(host(folder.as_path().join("port")));
        let end = |owner| End { owner, port: "port".into() };
        let (guest, own) = (end(Owner::Partition(PartitionId(0))), end(Owner::Host));
        let (source, destination) = if sends { (own, guest) } else { (guest, own) };
        let (name, destinations) = ("levels".into(), vec![destination]);
        let (message_bytes, doorbell) = (maximum, None);
        let channel = Channel { name, kind, message_bytes, source, destinations, doorbell, host };
        // Channels borrow what the file says; here that lives as long as the test's process.
        let channels = Channels::new(Box::leak(Box::new([channel]))).unwrap();
        let frequency = TscFrequency::from_khz(KHZ).unwrap();
        let clock = Timebase { epoch: EPOCH, frequency };
        let bench = Self { folder, channels: Box::leak(Box::new(channels)), clock, now: 0 };
        let regions = bench.regions();
        if !sends {
            regions.geometry.format_source(&mut Own::map(&regions.source).unwrap()).unwrap();
        } else if let Some(region) = &regions.destination {
            regions.geometry.format_destination(&mut Own::map(region).unwrap()).unwrap();
        }
        bench
    }

    pub(super) fn regions(&self) -> &'static Regions<'static> {
        self.channels.of_host().next().unwrap()
    }

    pub(super) fn path(&self) -> PathBuf {
        self.folder.as_path().join("port")
    }

    pub(super) fn open(&self) -> HostPorts {
        HostPorts::open(self.channels, self.clock.frequency, None, &spawn).unwrap().unwrap()
    }

    fn own(&self) -> Own {
        let Regions { channel, source, destination, .. } = self.regions();
        let is_source = channel.source.owner != Owner::Host;
        Own::map(if is_source { source } else { destination.as_ref().unwrap() }).unwrap()
    }

    fn sampling_source(&self) -> SamplingSource<Own> {
        SamplingSource::open(self.own(), &self.regions().geometry).unwrap()
    }

    pub(super) fn queuing_source(&self) -> QueuingSource<Own, Peer> {
        let peer = Peer::map(self.regions().destination.as_ref().unwrap()).unwrap();
        QueuingSource::open(self.own(), peer, &self.regions().geometry).unwrap()
    }

    fn queuing_destination(&self) -> QueuingDestination<Peer, Own> {
        let peer = Peer::map(&self.regions().source).unwrap();
        QueuingDestination::open(peer, self.own(), &self.regions().geometry).unwrap()
    }

    pub(super) fn stamp(&self) -> takt_channel::Tsc {
        takt_channel::Tsc(EPOCH.0 + self.now)
    }

    pub(super) fn tick(&mut self, ports: &mut HostPorts) {
        self.now += 1;
        ports.on_tick(&self.clock, &|| Tsc(EPOCH.0 + self.now));
        for port in &mut ports.ports {
            if let Way::FileDestination(file) = &mut port.way {
                file.settle(LONG, LONG).unwrap();
            }
        }
    }

    fn ready(&self, ports: &mut HostPorts) {
        ports.on_ready(&self.clock, &|| Tsc(EPOCH.0 + self.now));
    }
}

fn account(ports: &mut HostPorts) -> Account {
    ports.accounts().remove(0)
}

/// The next packet of a client, if there is one.
fn packet(client: &Connection) -> Option<(Header, Vec<u8>)> {
    let mut buffer = vec![0; HEADER + takt_channel::MESSAGE_MAX as usize];
    match client.receive(&mut buffer) {
        Came::Packet(length) => Some(parse(&buffer[..length])),
        Came::Nothing | Came::End => None,
        Came::Wrong => panic!("a packet of the wrong length"),
    }
}

fn parse(packet: &[u8]) -> (Header, Vec<u8>) {
    let (header, message) = packet.split_first_chunk().unwrap();
    (Header::from_bytes(header), message.to_vec())
}

fn message(client: &Connection) -> Option<Vec<u8>> {
    packet(client).map(|(_, message)| message)
}

fn number(n: u32) -> [u8; 4] {
    n.to_le_bytes()
}

/// Numbers that the guest receives.
fn received(guest: &mut QueuingDestination<Peer, Own>) -> Vec<u32> {
    let mut all = Vec::new();
    let mut buffer = [0; MAXIMUM as usize];
    loop {
        match guest.receive(&mut buffer) {
            Ok(received) => all.push(u32::from_le_bytes(received.bytes.try_into().unwrap())),
            Err(ReceiveError::Empty) => return all,
            Err(error) => panic!("{error}"),
        }
    }
}

/// A client that sends numbers until its buffer is full; returns how many.
fn flood(client: &Connection, from: u32) -> u32 {
    (from..).take_while(|&n| client.send(&number(n)) == Sent::Yes).count() as u32
}
