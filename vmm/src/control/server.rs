//! All clients of the control socket, and what they are told.

use std::collections::VecDeque;
use std::io::Write;
use std::os::unix::net::UnixStream;

use takt_scheduler::time::{Nanos, Tsc};

use super::client::{Came, Client};
use super::operator::Operator;
use super::protocol::{
    Answer, ErrorKind, Event, EventKind, LINE_MAX, Refusal, Request, TracedWindow,
};
use super::tracing::Tracing;
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
        let (kept, now) = (&self.kept, run.now());
        let mut traced = self.clients.iter().any(|client| client.trace.is_some());
        self.clients.retain_mut(|client| {
            client.end_trace(now);
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
                        let answer = answer(&line, client, kept, traced, run);
                        let answer = answer.unwrap_or_else(Answer::Error);
                        traced |= client.trace.is_some();
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

    /// Tells who traces of a window that is over. It is not made if nobody does.
    pub fn window(&mut self, window: impl FnOnce() -> TracedWindow) {
        if let Some(client) = self.clients.iter_mut().find(|client| client.trace.is_some()) {
            client.trace_window(window);
        }
    }

    /// Tells who traces that another schedule holds.
    pub fn switch(&mut self, at: Tsc, schedule: &str) {
        let line = Answer::Switch { at_tsc: at.0, schedule: schedule.to_owned() }.line();
        self.clients.retain_mut(|client| client.trace.is_none() || client.tell(&line));
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
    traced: bool,
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
        // Each trace costs the event thread its share, so there is no second one.
        Request::Trace(_) if traced => {
            Err(Refusal::new(ErrorKind::Refused, "there is a trace under way"))
        }
        Request::Trace(duration) => {
            client.trace = Some(Tracing::new(run.now().plus(duration)));
            Ok(Answer::Trace { trace: run.trace() })
        }
    }
}
