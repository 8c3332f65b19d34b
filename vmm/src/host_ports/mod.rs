//! Ends of channels on the host: Takt itself as a source or a destination, for tools and tests.
//!
//! What a PLC publishes is wanted outside as well: by a test that compares it, by a recorder, by a
//! simulated plant that answers. Another partition could carry it out, but then every test would
//! need a second guest that it trusts. So Takt takes part in channels, and hands messages on
//! through sockets and files.
//!
//! All of it happens in the supervisor thread, on its tick and when a socket has something, but for reading
//! and writing files, which threads of their own do. The other
//! end of each channel is in shared memory and never waits; so whatever a client, a disk or this
//! thread does, no vCPU thread is the later for it. What a port may do in a tick is bounded
//! ([`budget`]), for the thread's CPU time may be Linux's.
//!
//! ```text
//! region <-> ends -- sockets <-> seqpacket <-> clients
//!               `--- files   <-> thread of the file <-> disk
//! ```

pub mod budget;
pub mod ends;
pub mod files;
pub mod packet;
pub mod pages;
pub mod seqpacket;
pub mod sockets;
#[cfg(test)]
mod tests;

use std::io;
use std::os::fd::{AsRawFd, RawFd};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::{Duration, Instant};

use takt_channel::Counters;
pub use takt_figures::report::HostPort as Account;
use takt_scheduler::time::{Timebase, TscFrequency};
use thiserror::Error;
use vmm_sys_util::epoll::{Epoll, EpollEvent};

use crate::channels::{Channels, Regions};
use crate::config::{self, HostPort, Owner};
use crate::outlet::Outlet;
use crate::sandbox::Kind;
use crate::unix_socket::{Listener, SocketError, SocketKind};
use crate::vcpu::thread::{Spawn, ThreadError};
use budget::Budget;
use ends::{Destination, EndError, Now, Source};
use files::{FileDestination, FileSource, Recording, read_ahead};
use sockets::{Clients, SocketDestination, SocketSource, Watch};

/// Events that are taken at once.
const EVENTS: usize = 16;
/// At the end, a recording is waited for as long as some of it is written in each such time, and no longer
/// than twice that.
const PATIENCE: Duration = Duration::from_secs(1);
/// How long all recordings together are waited for: what ends Takt has no endless patience either. A disk that takes
/// everything at once gets [`LEAST`] also behind others.
const ALL: Duration = Duration::from_secs(4);
const LEAST: Duration = Duration::from_millis(50);

/// An end on the host could not be made.
#[derive(Debug, Error)]
pub enum HostPortError {
    /// The channel's end.
    #[error("channel {channel}: {source}")]
    End {
        /// Name of the channel.
        channel: String,
        /// What is wrong.
        source: EndError,
    },
    /// The socket.
    #[error("channel {channel}: {source}")]
    Socket {
        /// Name of the channel.
        channel: String,
        /// What is wrong.
        source: SocketError,
    },
    /// The file.
    #[error("channel {channel}: cannot open {}: {reason}", path.display())]
    File {
        /// Name of the channel.
        channel: String,
        /// Of the file.
        path: PathBuf,
        /// What is wrong.
        reason: config::Unreadable,
    },
    /// The thread that reads or writes the file.
    #[error("channel {channel}: {source}")]
    Thread {
        /// Name of the channel.
        channel: String,
        /// What is wrong.
        source: ThreadError,
    },
    /// The host refuses to watch sockets.
    #[error("cannot watch sockets: {0}")]
    Watch(io::Error),
}

/// All ends on the host.
pub struct HostPorts {
    ports: Vec<Port>,
    epoll: Rc<Epoll>,
    /// What the user should know and has not been told yet.
    news: Vec<String>,
}

struct Port {
    channel: String,
    name: String,
    budget: Budget,
    way: Way,
}

enum Way {
    SocketDestination(SocketDestination),
    SocketSource(SocketSource),
    FileDestination(FileDestination),
    FileSource(FileSource),
}

impl HostPorts {
    /// Opens all of them; `None` if there are none. No guest may run yet, and the headers of all
    /// partitions' regions must have been written. `results` is the folder of the appliance that is
    /// carried out of it: recordings then go there, each under its channel's name, and sockets, to
    /// which no program could connect, are left out. `spawn` starts the threads of files.
    ///
    /// # Errors
    /// See [`HostPortError`].
    pub fn open(
        channels: &Channels<'_>,
        frequency: TscFrequency,
        results: Option<&Path>,
        spawn: Spawn<'_>,
    ) -> Result<Option<Self>, HostPortError> {
        let epoll = Rc::new(Epoll::new().map_err(HostPortError::Watch)?);
        let mut all = Self { ports: Vec::new(), epoll, news: Vec::new() };
        for regions in channels.of_host() {
            all.add(regions, frequency, results, spawn)?;
        }
        Ok((!all.ports.is_empty() || !all.news.is_empty()).then_some(all))
    }

    fn add(
        &mut self,
        regions: &Regions<'_>,
        frequency: TscFrequency,
        results: Option<&Path>,
        spawn: Spawn<'_>,
    ) -> Result<(), HostPortError> {
        let channel = regions.channel;
        let name = || channel.name.clone();
        let file_error = |path: &Path| {
            let path = path.to_owned();
            move |reason| HostPortError::File { channel: name(), path, reason }
        };
        let thread_error = |source| HostPortError::Thread { channel: name(), source };
        let end_error = |source| HostPortError::End { channel: name(), source };
        let mut ends = std::iter::once(&channel.source).chain(&channel.destinations);
        let end = ends.find(|end| end.owner == Owner::Host);
        let (Some(port), Some(end)) = (&channel.host, end) else { return Ok(()) };
        let maximum = channel.message_bytes as usize;
        let is_source = channel.source.owner == Owner::Host;
        let way = match port {
            HostPort::Socket(_) if results.is_some() => {
                self.news.push(format!(
                    "channel {}: no socket in the appliance, where no program could connect to it",
                    channel.name
                ));
                return Ok(());
            }
            HostPort::Socket(path) => {
                let listener = Listener::bind(path, SocketKind::Packets)
                    .map_err(|source| HostPortError::Socket { channel: name(), source })?;
                let watch = Watch::new(self.epoll.clone(), self.ports.len() as u64);
                if is_source {
                    let end = Source::open(regions).map_err(end_error)?;
                    SocketSource::new(end, listener, watch, maximum).map(Way::SocketSource)
                } else {
                    let end = Destination::open(regions, frequency).map_err(end_error)?;
                    SocketDestination::new(end, listener, watch).map(Way::SocketDestination)
                }
                .map_err(HostPortError::Watch)?
            }
            HostPort::File(path) if is_source => {
                let file = config::open_file(path).map_err(file_error(path))?;
                let end = Source::open(regions).map_err(end_error)?;
                let (messages, work) = read_ahead(file, maximum);
                spawn("replay", Kind::Reader, Box::new(work)).map_err(thread_error)?;
                Way::FileSource(FileSource::new(end, messages))
            }
            HostPort::File(path) => {
                let path = match results {
                    Some(folder) => folder.join(format!("{}.records", channel.name)),
                    None => path.clone(),
                };
                let end = Destination::open(regions, frequency).map_err(end_error)?;
                let file = Recording::open_records(&path, maximum);
                let (file, cut) = file.map_err(|error| file_error(&path)(error.into()))?;
                let (channel, path) = (&channel.name, path.display());
                match cut {
                    Some(0) => {}
                    Some(cut) => self.news.push(format!(
                        "channel {channel}: a run that was cut off has left a part of a record in {path}: {cut} bytes, which are gone"
                    )),
                    None => self.news.push(format!(
                        "channel {channel}: {path} is long, and is not looked through for a part of a record that a run may have left which was cut off"
                    )),
                }
                let (outlet, work) = Outlet::new(&[Recording::quota(maximum)], file);
                spawn("record", Kind::Writer, Box::new(work)).map_err(thread_error)?;
                Way::FileDestination(FileDestination::new(end, outlet))
            }
        };
        let port = Port { channel: name(), name: end.port.clone(), budget: Budget::TICK, way };
        self.ports.push(port);
        Ok(())
    }

    /// Serves every port, with a new budget.
    pub fn on_tick(&mut self, clock: &Timebase, now: Now<'_>) {
        for port in &mut self.ports {
            port.budget = Budget::TICK;
            port.serve(clock, now, &mut self.news);
        }
    }

    /// Serves the ports whose sockets have something, with what is left of their budgets.
    pub fn on_ready(&mut self, clock: &Timebase, now: Now<'_>) {
        let mut events = [EpollEvent::default(); EVENTS];
        // What does not come now comes with the next event or at the next tick.
        let count = self.epoll.wait(0, &mut events).unwrap_or(0);
        for event in &events[..count] {
            let port = usize::try_from(event.data()).ok().and_then(|i| self.ports.get_mut(i));
            if let Some(port) = port {
                port.serve(clock, now, &mut self.news);
            }
        }
    }

    /// Takes the last messages, after all guests have stopped, and waits for their files.
    pub fn finish(&mut self, clock: &Timebase, now: Now<'_>) {
        let until = Instant::now() + ALL;
        for port in &mut self.ports {
            let Way::FileDestination(file) = &mut port.way else { continue };
            // The sources have ended, so each turn leaves fewer messages: the loop ends. A turn that took none
            // may have skipped what cannot be believed.
            let failed = loop {
                let before = (file.taken, file.end().waiting());
                port.budget = Budget::TICK;
                // The disk goes first, so that there is room.
                let left = until.saturating_duration_since(Instant::now()).max(LEAST);
                let settled = file.settle(PATIENCE.min(left), (2 * PATIENCE).min(left));
                let served = settled.and_then(|()| file.serve(&mut port.budget, clock, now));
                match served {
                    Ok(()) if before != (file.taken, file.end().waiting()) => {}
                    ended => break ended.err(),
                }
            };
            let left = file.end().waiting();
            let left =
                (left > 0).then(|| format!("messages that wait and are not in the file: {left}"));
            let news = failed.map(|why| why.to_string()).into_iter().chain(left);
            self.news.extend(news.map(|news| format!("channel {}: {news}", port.channel)));
        }
    }

    /// What the user should be told, once.
    pub fn take_news(&mut self) -> Vec<String> {
        std::mem::take(&mut self.news)
    }

    /// What became of the messages of each.
    pub fn accounts(&mut self) -> Vec<Account> {
        self.ports.iter_mut().map(Port::account).collect()
    }
}

/// Ready when [`HostPorts::on_ready`] has something to do.
impl AsRawFd for HostPorts {
    fn as_raw_fd(&self) -> RawFd {
        self.epoll.as_raw_fd()
    }
}

impl Port {
    fn serve(&mut self, clock: &Timebase, now: Now<'_>, news: &mut Vec<String>) {
        let budget = &mut self.budget;
        let broken = match &mut self.way {
            Way::SocketDestination(port) => return port.serve(budget, clock, now),
            Way::SocketSource(port) => return port.serve(budget, now),
            Way::FileDestination(port) => port.serve(budget, clock, now).err(),
            Way::FileSource(port) => port.serve(budget, now).err(),
        };
        news.extend(broken.map(|broken| format!("channel {}: {broken}", self.channel)));
    }

    fn account(&mut self) -> Account {
        let none = (0, 0);
        let of = |clients: &Clients| (clients.refused, clients.dropped);
        let (messages, (refused, dropped), counters): (_, _, Counters) = match &mut self.way {
            Way::SocketDestination(port) => {
                (port.messages, of(&port.clients), port.end().counters())
            }
            Way::SocketSource(port) => (port.messages, of(&port.clients), port.end().counters()),
            Way::FileDestination(port) => (port.messages(), none, port.end().counters()),
            Way::FileSource(port) => (port.messages, none, port.end().counters()),
        };
        Account {
            channel: self.channel.clone(),
            port: self.name.clone(),
            messages,
            lost: counters.lost,
            hostile: counters.hostile,
            refused,
            dropped,
        }
    }
}
