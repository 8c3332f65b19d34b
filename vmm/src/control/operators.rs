//! The supervisor thread's side of the control socket: everything that it has to do with operators.

use std::io;
use std::time::Duration;

use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::table::PartitionId;
use takt_scheduler::time::{Nanos, Tsc};

use super::channels::{ViewError, Views};
use super::door::Door;
use super::facts::Facts;
use super::operated::Operated;
use super::orders::Outcome;
use super::protocol::{EventKind, TracedWindow, Values, hex};
use super::server::Server;
use crate::account::Account;
use crate::channels::Channels;
use crate::config::PartitionFile;
use crate::host_ports::HostPorts;
use crate::live::{Live, Sampled};
use crate::report;
use crate::schedule_requests::ScheduleRequests;
use crate::statistics::Releases;
use crate::vcpu::record::{Detour, WindowRecord};

/// The clients, and what they can be told of.
pub struct Operators {
    server: Server,
    facts: Facts,
    channels: Views,
    live: Live,
}

impl Operators {
    /// Those who will come through `door`, if there is one.
    ///
    /// # Errors
    /// See [`ViewError`].
    pub fn new(
        door: Option<Door>,
        file: &PartitionFile,
        channels: &Channels<'_>,
    ) -> Result<Operators, ViewError> {
        let channels = Views::new(file, channels)?;
        let server = Server::new(door, file.partitions().len());
        let (facts, live) = (Facts::new(file), Live::default());
        Ok(Operators { server, facts, channels, live })
    }

    /// Lets them ask and order programs.
    pub fn attach(&mut self, live: Live) {
        self.live = live;
    }

    /// The run is over: what programs retain is written.
    ///
    /// # Errors
    /// What kept some of it from being written within this time.
    pub fn finish(&mut self, now: Nanos, at_most: Duration) -> io::Result<()> {
        self.live.finish(now, at_most)
    }

    /// What they did with the values of a partition, for the report.
    #[must_use]
    pub fn told(&self, id: PartitionId) -> Option<report::Operator> {
        self.live.told(id.0)
    }

    /// Answers them; returns what has come of orders, with the partition of each, of which they
    /// have not been told yet.
    pub fn serve(
        &mut self,
        accounts: &mut [Account],
        host_ports: Option<&mut HostPorts>,
        desk: &ScheduleRequests,
    ) -> Vec<(String, Outcome)> {
        let Operators { server, facts, channels, live } = self;
        let banks = |id: usize| accounts.get(id).and_then(|account| account.banks.as_ref());
        let releases = |id: usize| accounts.get(id).and_then(|account| account.releases.as_ref());
        let windows = |id: usize| releases(id).map_or(0, Releases::windows);
        let turn = live.on_tick(desk.now(), banks, windows);
        if turn.exchanged {
            server.places_have_changed();
        }
        turn.unwatched.iter().for_each(|(client, text)| server.unwatch(*client, text));
        let base = desk.base();
        for (id, sampled) in turn.samples {
            let Some(account) = accounts.get(id) else { continue };
            let Sampled { client, head, missed, bytes } = sampled;
            server.values(client, missed, |missed| Values {
                partition: account.name.clone(),
                cycle: head.cycle,
                release_ns: base.offset(Tsc(head.release_tsc)).0,
                time_ns: head.time_ns,
                missed,
                unsettled: head.unsettled,
                bytes: hex(&bytes),
            });
        }
        let name = |id: usize| accounts.get(id).map_or_else(String::new, |a| a.name.clone());
        let events = turn.events.into_iter();
        let outcomes = events.map(|(id, kind, text)| (name(id), Outcome { kind, text })).collect();
        live.keep(|client| server.has(client));
        let mut run = Operated { facts, accounts, channels, live, host_ports, desk, outcomes };
        server.serve(&mut run);
        run.outcomes
    }

    /// Tells them of an event, which became known at this time since the epoch.
    pub fn tell(&mut self, at: Nanos, kind: EventKind, partition: Option<&str>, text: &str) {
        self.server.tell(at, kind, partition, text);
    }

    /// Keeps what a partition has written, and tells those who are attached to its console.
    pub fn console(&mut self, id: PartitionId, partition: &str, bytes: &[u8]) {
        self.server.console(id.0, partition, bytes);
    }

    /// Tells who traces of a window that is over.
    pub fn window(&mut self, partition: &str, window: &WindowRecord, detours: &[Detour]) {
        let Operators { server, facts, .. } = self;
        let schedule = facts.schedules.get(window.schedule.0).map_or("", |s| s.name.as_str());
        server.window(|| TracedWindow::new(partition, schedule, window, detours));
    }

    /// Tells who traces that another schedule holds since `at`.
    pub fn switch(&mut self, at: Tsc, schedule: ScheduleId) {
        let name = self.facts.schedules.get(schedule.0).map_or("", |s| s.name.as_str());
        self.server.switch(at, name);
    }
}
