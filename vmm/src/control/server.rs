//! All clients of the control socket, and what they are told.

use std::collections::VecDeque;
use std::io::Write;
use std::os::unix::net::UnixStream;

use takt_scheduler::time::Nanos;

use super::client::{Came, Client};
use super::operator::Operator;
use super::protocol::{Answer, ErrorKind, Event, EventKind, LINE_MAX, Refusal, Request};
use crate::unix_socket::Listener;

/// Most clients at a time.
pub const CLIENTS_MAX: usize = 16;
/// New connections that are looked at in one turn.
const ACCEPTED_MAX: usize = 32;
/// Requests of one client in one turn.
const REQUESTS_MAX: usize = 4;
/// Events that are kept for who asks later.
pub const KEPT: usize = 64;

/// The server's side of the control socket.
pub struct Server {
    listener: Listener,
    clients: Vec<Client>,
    kept: VecDeque<Event>,
    /// Events so far.
    events: u64,
}

impl Server {
    /// Nobody yet.
    #[must_use]
    pub fn new(listener: Listener) -> Server {
        Server { listener, clients: Vec::new(), kept: VecDeque::with_capacity(KEPT), events: 0 }
    }

    /// Does what there is to do, within bounds. It never waits.
    pub fn serve(&mut self, run: &mut impl Operator) {
        self.accept();
        let kept = &self.kept;
        self.clients.retain_mut(|client| {
            if !client.flush() {
                return false;
            }
            for _ in 0..REQUESTS_MAX {
                if !client.may_ask() {
                    break;
                }
                match client.receive() {
                    Came::Nothing => break,
                    Came::Line(line) => {
                        let answer = answer(&line, client, kept, run).unwrap_or_else(Answer::Error);
                        client.answer(&answer.line());
                    }
                    Came::TooLong => {
                        let text = format!("a line has at most {LINE_MAX} bytes");
                        let refusal = Refusal::new(ErrorKind::TooLong, text);
                        client.answer(&Answer::Error(refusal).line());
                        client.close();
                    }
                }
                if !client.flush() {
                    return false;
                }
            }
            true
        });
    }

    /// Tells of an event, which became known at this time since the epoch.
    pub fn tell(&mut self, at: Nanos, kind: EventKind, partition: Option<&str>, text: &str) {
        self.events += 1;
        let event = Event {
            sequence: self.events,
            at_ns: at.0,
            kind,
            partition: partition.map(str::to_owned),
            text: text.to_owned(),
        };
        if self.kept.len() >= KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(event.clone());
        let line = Answer::Event { event }.line();
        self.clients.retain_mut(|client| !client.follows || client.tell(&line));
    }

    /// Number of clients.
    #[cfg(test)]
    pub(super) fn clients(&self) -> usize {
        self.clients.len()
    }

    fn accept(&mut self) {
        for _ in 0..ACCEPTED_MAX {
            let Some(mut stream) = self.listener.accept().map(UnixStream::from) else { return };
            if self.clients.len() < CLIENTS_MAX {
                self.clients.push(Client::new(stream));
                continue;
            }
            let text = format!("there are {CLIENTS_MAX} clients already");
            let line = Answer::Error(Refusal::new(ErrorKind::Full, text)).line();
            // A new connection has room for a line; who has closed it already needs none.
            let _ = stream.write(&line);
        }
    }
}

fn answer(
    line: &[u8],
    client: &mut Client,
    kept: &VecDeque<Event>,
    run: &mut impl Operator,
) -> Result<Answer, Refusal> {
    let done = |text| Answer::Done { text };
    match Request::parse(line)? {
        Request::Status => Ok(Answer::Status { status: Box::new(run.status()) }),
        Request::Stop(partition) => run.stop(&partition).map(done),
        Request::Start(partition, mode) => run.start(&partition, mode).map(done),
        Request::Restart(partition, mode) => run.restart(&partition, mode).map(done),
        Request::Schedule(name) => run.switch_schedule(&name).map(done),
        Request::Events { follow } => {
            client.follows = follow;
            Ok(Answer::Events { events: kept.iter().cloned().collect() })
        }
    }
}
