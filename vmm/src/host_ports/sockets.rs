//! Ends that are reached by a socket.
//!
//! Clients are programs of all kinds, among them ones that hang, flood and lie. Each of them costs
//! only a bounded share of each tick (see [`Budget`]) and its own messages. There are few
//! clients at a time, Takt never waits for one, and closes the connection of one that sends what is no message.

use std::collections::VecDeque;
use std::io;
use std::os::fd::{AsRawFd, RawFd};
use std::rc::Rc;

use takt_scheduler::time::Timebase;
use vmm_sys_util::epoll::{ControlOperation, Epoll, EpollEvent, EventSet};

use super::budget::Budget;
use super::ends::{Destination, Now, Source};
use super::seqpacket::{Came, Connection, Sent};
use crate::unix_socket::Listener;

/// Most clients of one port at a time.
pub const CLIENTS_MAX: usize = 8;

/// How a port gets to know that something has come.
#[derive(Clone)]
pub struct Watch {
    epoll: Rc<Epoll>,
    port: u64,
}

impl Watch {
    /// Events of descriptors that are added carry the number `port`.
    #[must_use]
    pub fn new(epoll: Rc<Epoll>, port: u64) -> Self {
        Self { epoll, port }
    }

    /// By edges: what has been told of is not told of again, so that a client that is not served
    /// for now does not wake the thread. A descriptor is forgotten when it is closed.
    fn add(&self, fd: RawFd) -> io::Result<()> {
        let events = EventSet::IN | EventSet::READ_HANG_UP | EventSet::EDGE_TRIGGERED;
        self.epoll.ctl(ControlOperation::Add, fd, EpollEvent::new(events, self.port))
    }
}

/// A socket and its clients.
pub struct Clients {
    listener: Listener,
    watch: Watch,
    most: usize,
    all: VecDeque<Client>,
    /// Connections that were closed at once, because there were too many.
    pub refused: u64,
    /// Connections that were closed because of what the client sent.
    pub dropped: u64,
}

struct Client {
    connection: Connection,
    /// There is a sample that it has not got.
    behind: bool,
}

impl Clients {
    /// Without clients yet; `most` at a time.
    ///
    /// # Errors
    /// If the socket cannot be watched.
    pub fn new(listener: Listener, watch: Watch, most: usize) -> io::Result<Self> {
        watch.add(listener.as_raw_fd())?;
        Ok(Self { listener, watch, most, all: VecDeque::new(), refused: 0, dropped: 0 })
    }

    fn accept(&mut self, budget: &mut Budget) {
        while budget.is_left() {
            let Some(connection) = self.listener.accept().map(Connection) else { return };
            budget.spend(0);
            if self.all.len() < self.most && self.watch.add(connection.as_raw_fd()).is_ok() {
                self.all.push_back(Client { connection, behind: true });
            } else {
                self.refused += 1;
            }
        }
    }
}

/// A destination whose messages go to clients.
pub struct SocketDestination {
    end: Destination,
    /// The clients.
    pub clients: Clients,
    /// A message was taken from the queue and no client has it.
    pending: bool,
    /// Packets that were sent.
    pub messages: u64,
}

impl SocketDestination {
    /// Of `end`; a queuing one has one client at a time.
    ///
    /// # Errors
    /// If the socket cannot be watched.
    pub fn new(end: Destination, listener: Listener, watch: Watch) -> io::Result<Self> {
        let most = if end.is_sampling() { CLIENTS_MAX } else { 1 };
        let clients = Clients::new(listener, watch, most)?;
        Ok(Self { end, clients, pending: false, messages: 0 })
    }

    /// The channel's end.
    pub fn end(&mut self) -> &mut Destination {
        &mut self.end
    }

    /// Does what there is to do, within the budget.
    pub fn serve(&mut self, budget: &mut Budget, clock: &Timebase, now: Now<'_>) {
        self.clients.all.retain(|client| !client.connection.is_closed());
        self.clients.accept(budget);
        if self.end.is_sampling() {
            self.show(budget, clock, now);
        } else {
            self.hand_over(budget, clock, now);
        }
    }

    /// Sends the newest sample to the clients that do not have it. A client that cannot take it now gets the
    /// sample that is the newest later.
    fn show(&mut self, budget: &mut Budget, clock: &Timebase, now: Now<'_>) {
        let clients = &mut self.clients.all;
        if self.end.has_news() {
            clients.iter_mut().for_each(|client| client.behind = true);
        }
        let all_have_it = !clients.iter().any(|client| client.behind);
        if all_have_it || !budget.is_left() || !self.end.take(clock, now) {
            return;
        }
        budget.spend(self.end.packet().len());
        clients.retain_mut(|client| {
            if !client.behind {
                return true;
            }
            let sent = client.connection.send(self.end.packet());
            client.behind = sent != Sent::Yes;
            self.messages += u64::from(sent == Sent::Yes);
            sent != Sent::Gone
        });
    }

    /// Sends what is in the queue to the client, if there is one. Without a client the messages stay in
    /// the queue.
    fn hand_over(&mut self, budget: &mut Budget, clock: &Timebase, now: Now<'_>) {
        while budget.is_left() {
            let Some(client) = self.clients.all.front() else { return };
            if !self.pending {
                self.pending = self.end.take(clock, now);
            }
            if !self.pending {
                return;
            }
            match client.connection.send(self.end.packet()) {
                Sent::Yes => {
                    budget.spend(self.end.packet().len());
                    self.pending = false;
                    self.messages += 1;
                }
                Sent::NotNow => return,
                Sent::Gone => self.clients.all.clear(),
            }
        }
    }
}

/// A source whose messages come from clients.
pub struct SocketSource {
    end: Source,
    /// The clients.
    pub clients: Clients,
    /// As long as the longest message.
    buffer: Vec<u8>,
    /// As long as well: what has come last and is yet to be sent.
    newest: Vec<u8>,
    /// Messages that were sent.
    pub messages: u64,
}

impl SocketSource {
    /// For messages of at most `maximum` bytes.
    ///
    /// # Errors
    /// If the socket cannot be watched.
    pub fn new(end: Source, listener: Listener, watch: Watch, maximum: usize) -> io::Result<Self> {
        let clients = Clients::new(listener, watch, CLIENTS_MAX)?;
        Ok(Self { end, clients, buffer: vec![0; maximum], newest: vec![0; maximum], messages: 0 })
    }

    /// The channel's end.
    pub fn end(&mut self) -> &mut Source {
        &mut self.end
    }

    /// Does what there is to do, within the budget. The clients take turns. Without room in the
    /// channel nothing is read, and the client's own buffer fills up.
    ///
    /// Of the packets for a sampling channel only the last is sent: the others are void by then, and
    /// each would have the stamp of a fresh one for a moment.
    pub fn serve(&mut self, budget: &mut Budget, now: Now<'_>) {
        let clients = &mut self.clients;
        clients.all.retain(|Client { connection: c, .. }| !(c.is_closed() && c.is_drained()));
        clients.accept(budget);
        let (mut silent, mut found) = (0, None);
        while silent < clients.all.len() && budget.is_left() && self.end.has_room(false) {
            let Some(client) = clients.all.pop_front() else { break };
            match client.connection.receive(&mut self.buffer) {
                Came::Packet(length) => {
                    budget.spend(length);
                    std::mem::swap(&mut self.buffer, &mut self.newest);
                    found = Some(length);
                    if !self.end.is_sampling() {
                        self.messages += send(&mut self.end, &self.newest, found.take(), now);
                    }
                    silent = 0;
                    clients.all.push_back(client);
                }
                Came::Nothing => {
                    silent += 1;
                    clients.all.push_back(client);
                }
                Came::Wrong => {
                    budget.spend(0);
                    clients.dropped += 1;
                }
                Came::End => {}
            }
        }
        self.messages += send(&mut self.end, &self.newest, found, now);
    }
}

/// Sends the first bytes of the buffer, if there is a length; returns how many messages that was.
fn send(end: &mut Source, buffer: &[u8], length: Option<usize>, now: Now<'_>) -> u64 {
    let message = length.and_then(|length| buffer.get(..length));
    u64::from(message.is_some_and(|message| end.send(message, now)))
}
