//! All clients of the control socket, and what they are told.

use std::collections::VecDeque;
use std::io::Write;

use takt_scheduler::time::{Nanos, Tsc};

use super::client::{Came, Client};
use super::consoles::Consoles;
use super::door::{Door, Rights};
use super::operator::Operator;
use super::protocol::{
    Answer, ErrorKind, Event, EventKind, LINE_MAX, Refusal, Request, TracedWindow, Values,
};
use super::tracing::Tracing;
use crate::live::ValueOrder;

/// Most clients at a time.
pub const CLIENTS_MAX: usize = 16;
/// Clients at which no further one is let in that may only see: there is always a place for those who may order.
const VIEWERS_MAX: usize = CLIENTS_MAX - 4;
/// New connections that are looked at in one turn.
const ACCEPTED_MAX: usize = 32;
/// Requests of one client in one turn.
const REQUESTS_MAX: usize = 4;
/// Events that are kept for who asks later.
pub const KEPT: usize = 64;

/// The server's side of the control socket.
pub struct Server {
    door: Option<Door>,
    clients: Vec<Client>,
    kept: VecDeque<Event>,
    consoles: Consoles,
    /// Events so far.
    events: u64,
    /// Clients so far.
    connected: u64,
}

impl Server {
    /// Without a client, for so many partitions. Without a door there will be no client.
    #[must_use]
    pub fn new(door: Option<Door>, partitions: usize) -> Server {
        let (kept, consoles) = (VecDeque::with_capacity(KEPT), Consoles::new(partitions));
        Server { door, clients: Vec::new(), kept, consoles, events: 0, connected: 0 }
    }

    /// Does what there is to do, within bounds. It never waits.
    pub fn serve(&mut self, run: &mut impl Operator) {
        self.accept();
        let (known, now) = (Known { events: &self.kept, consoles: &self.consoles }, run.now());
        let mut traced = self.clients.iter().any(|client| client.trace.is_some());
        self.clients.retain_mut(|client| {
            client.end_trace(now);
            if let Some(result) = client.waits_for.and_then(|ticket| run.result(ticket)) {
                client.waits_for = None;
                let answer = result.map_or_else(Answer::Error, |text| Answer::Done { text });
                client.answer(&answer.line());
            }
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
                        let answer = answer(&line, client, known, traced, run);
                        let answer = answer.unwrap_or_else(|error| Some(Answer::Error(error)));
                        traced |= client.trace.is_some();
                        answer.into_iter().for_each(|answer| client.answer(&answer.line()));
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

    /// Tells the client that traces of a window that is over. Without such a client it is not made.
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

    /// Keeps what a partition has written, and tells those who are attached to its console, as far as there is room.
    pub fn console(&mut self, place: usize, partition: &str, bytes: &[u8]) {
        self.consoles.wrote(place, bytes);
        for client in self.clients.iter_mut().filter(|client| client.attached == Some(place)) {
            client.tell_console(partition, bytes);
        }
    }

    /// Tells a client values, if there is room for them; `missed` came before them.
    pub fn values(&mut self, client: u64, missed: u64, values: impl FnOnce(u64) -> Values) {
        if let Some(client) = self.clients.iter_mut().find(|c| c.id == client) {
            client.tell_values(missed, values);
        }
    }

    /// A program runs another version: clients must ask which one before they name places in programs again.
    pub fn places_have_changed(&mut self) {
        self.clients.iter_mut().for_each(|client| client.places_have_changed = true);
    }

    /// Tells a client that it gets no values any longer, and why: also one that is behind, which cannot watch anew before
    /// it has read this.
    pub fn unwatch(&mut self, client: u64, text: &str) {
        let line = Answer::Error(Refusal::new(ErrorKind::Refused, text)).line();
        self.clients.iter_mut().filter(|c| c.id == client).for_each(|c| c.answer(&line));
    }

    /// True if this client is still there.
    #[must_use]
    pub fn has(&self, client: u64) -> bool {
        self.clients.iter().any(|c| c.id == client)
    }

    /// Number of clients.
    #[cfg(test)]
    pub(super) fn clients(&self) -> usize {
        self.clients.len()
    }

    fn accept(&mut self) {
        for _ in 0..ACCEPTED_MAX {
            let Some((mut stream, rights)) = self.door.as_ref().and_then(Door::accept) else {
                return;
            };
            let most = match rights {
                Rights::Order => CLIENTS_MAX,
                Rights::See => VIEWERS_MAX,
            };
            if self.clients.len() < most {
                self.connected += 1;
                self.clients.push(Client::new(stream, self.connected, rights));
                continue;
            }
            let text = format!("there are {most} clients already");
            let line = Answer::Error(Refusal::new(ErrorKind::Full, text)).line();
            // A new connection has room for a line; who has closed it already needs none.
            let _ = stream.write(&line);
        }
    }
}

/// What of the past there is to ask for.
#[derive(Clone, Copy)]
struct Known<'a> {
    events: &'a VecDeque<Event>,
    consoles: &'a Consoles,
}

fn answer(
    line: &[u8],
    client: &mut Client,
    known: Known<'_>,
    traced: bool,
    run: &mut impl Operator,
) -> Result<Option<Answer>, Refusal> {
    let request = Request::parse(line)?;
    if client.rights == Rights::See && request.orders() {
        let text =
            "you may see how the run stands, and order nothing: the user who started Takt may";
        return Err(Refusal::new(ErrorKind::Refused, text));
    }
    let (partition, order) = match request {
        Request::Write(value) => (value.partition.clone(), ValueOrder::Write(value)),
        Request::Force(value) => (value.partition.clone(), ValueOrder::Force(value)),
        Request::Release(partition, point) => (partition, ValueOrder::Release(point)),
        request => return at_once(request, client, known, traced, run).map(Some),
    };
    if !matches!(order, ValueOrder::Release(_)) {
        client.knows_places()?;
    }
    // Answered when the PLC's kernel has carried it out.
    client.waits_for = Some(run.order_values(&partition, order)?);
    Ok(None)
}

fn at_once(
    request: Request,
    client: &mut Client,
    known: Known<'_>,
    traced: bool,
    run: &mut impl Operator,
) -> Result<Answer, Refusal> {
    let done = |text| Answer::Done { text };
    match request {
        Request::Ping => Ok(done("Takt answers".to_owned())),
        Request::Status => {
            client.places_have_changed = false;
            Ok(Answer::Status { status: Box::new(run.status()) })
        }
        Request::Stop(partition) => run.stop(&partition).map(done),
        Request::Start(partition, mode) => run.start(&partition, mode).map(done),
        Request::Restart(partition, mode) => run.restart(&partition, mode).map(done),
        Request::Schedule(name) => run.switch_schedule(&name).map(done),
        Request::Load(load) => run.load(load).map(done),
        Request::Commit(partition, program) => run.commit(&partition, &program).map(done),
        Request::RollBack(partition, program) => run.roll_back(&partition, &program).map(done),
        Request::Versions(partition) => {
            run.versions(&partition).map(|versions| Answer::Versions { versions })
        }
        Request::Events { follow } => {
            client.follows = follow;
            Ok(Answer::Events { events: known.events.iter().cloned().collect() })
        }
        // Each trace costs the supervisor thread its share, so there is no second one.
        Request::Trace(_) if traced => {
            Err(Refusal::new(ErrorKind::Refused, "there is a trace under way"))
        }
        Request::Trace(duration) => {
            client.trace = Some(Tracing::new(run.now().plus(duration)));
            Ok(Answer::Trace { trace: run.trace() })
        }
        Request::Attach(partition) => {
            let (place, terminal) = run.console(&partition)?;
            client.attach(place);
            Ok(Answer::Attached { console: known.consoles.start(place, &partition, terminal) })
        }
        Request::Type(partition, bytes) => {
            run.type_bytes(&partition, &bytes).map(|taken| Answer::Typed { taken: taken as u64 })
        }
        Request::Watch { partition, ranges, interval } => {
            if !ranges.is_empty() {
                client.knows_places()?;
            }
            let bytes = run.watch(client.id, &partition, ranges, interval)?;
            Ok(Answer::Watching { partition, bytes })
        }
        Request::Write(_) | Request::Force(_) | Request::Release(..) => {
            Err(Refusal::new(ErrorKind::Refused, "values are changed by the PLC's kernel"))
        }
    }
}
