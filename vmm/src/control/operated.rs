//! The run as it really is, for the control socket.

use takt_scheduler::time::{Nanos, Tsc};

use super::channels::Views;
use super::facts::Facts;
use super::operator::Operator;
use super::orders::Outcome;
use super::programs;
use super::protocol::{
    ChannelStatus, ErrorKind, Load, Mode, PartitionStatus, Range, Refusal, ReleaseStatus,
    ScheduleStatus, Status, TraceStart, TracedPartition, VersionStatus,
};
use crate::account::Account;
use crate::health::Fault;
use crate::host_ports::HostPorts;
use crate::life::Order;
use crate::live::{Live, ValueOrder};
use crate::schedule_requests::ScheduleRequests;

fn no_programs() -> Refusal {
    Refusal::new(ErrorKind::Unsupported, "this partition has no programs")
}

/// What of the supervisor thread an operator sees and changes.
pub struct Operated<'a> {
    /// What never changes.
    pub facts: &'a Facts,
    /// The partitions, in the order of the file.
    pub accounts: &'a mut [Account],
    /// What is between them.
    pub channels: &'a Views,
    /// The programs of PLCs.
    pub live: &'a mut Live,
    /// The ends of channels that are Takt's own.
    pub host_ports: Option<&'a mut HostPorts>,
    /// The schedules.
    pub desk: &'a ScheduleRequests,
    /// What has come of orders: the partition and the outcome.
    pub outcomes: Vec<(String, Outcome)>,
}

impl Operated<'_> {
    /// Where a partition is in the file.
    fn place(&self, name: &str) -> Result<usize, Refusal> {
        // Not repeated in the text: it is whatever a client has sent.
        let text = "there is no partition of this name";
        let missing = || Refusal::new(ErrorKind::NoSuchPartition, text);
        self.accounts.iter().position(|account| account.name == name).ok_or_else(missing)
    }

    fn find(&mut self, name: &str) -> Result<&mut Account, Refusal> {
        let place = self.place(name)?;
        Ok(&mut self.accounts[place])
    }

    /// Gives an order; the answer is its outcome, or `begun` if that is not known yet.
    fn order(&mut self, partition: &str, order: Order, begun: &str) -> Result<String, Refusal> {
        let Some(outcome) = self.find(partition)?.operate(order)? else {
            return Ok(format!("{partition} {begun}"));
        };
        let text = format!("{partition}: {}", outcome.text);
        self.outcomes.push((partition.to_owned(), outcome));
        Ok(text)
    }

    fn channels(&mut self) -> Vec<ChannelStatus> {
        let own = self.host_ports.as_mut().map_or_else(Vec::new, |ports| ports.accounts());
        let lost = |name: &str| own.iter().find(|end| end.channel == name).map(|end| end.lost);
        self.channels.look(Tsc::now, self.desk.base().frequency, lost)
    }

    fn schedule(&self, now: Nanos) -> ScheduleStatus {
        let schedules = &self.facts.schedules;
        let status = self.desk.status(now);
        let current = &schedules[status.current.0];
        ScheduleStatus {
            names: schedules.iter().map(|schedule| schedule.name.clone()).collect(),
            current: current.name.clone(),
            next: schedules[status.next.0].name.clone(),
            last_switch_ns: status.last_switch.map(|at| at.0),
            windows: current.listed.clone(),
            windows_left_out: current.left_out,
        }
    }
}

impl Operator for Operated<'_> {
    fn now(&self) -> Nanos {
        self.desk.now()
    }

    fn status(&mut self) -> Status {
        let now = self.desk.now();
        let channels = self.channels();
        let facts = self.facts;
        let partitions = self.accounts.iter().zip(&facts.partitions).enumerate();
        let partitions = partitions.map(|(id, (account, facts))| {
            let cpu_time = account.cpu_time();
            PartitionStatus {
                name: account.name.clone(),
                kind: facts.kind.to_owned(),
                cpu: facts.cpu,
                background: facts.background,
                state: account.life.state(),
                start_mode: account.life.start_mode().into(),
                end: account.end(),
                restarts: account.life.restarts(),
                cpu_time_ns: cpu_time.0,
                cpu_share: cpu_time.0 as f64 / now.0.max(1) as f64,
                illegal_accesses: account.health.count(Fault::IllegalRequest),
                console_dropped: account.console_dropped(),
                releases: account.figures().zip(account.releases.as_ref()).map(
                    |(all, releases)| ReleaseStatus {
                        happened: all.releases,
                        start_up_windows: all.start_up_windows,
                        lost: all.lost,
                        unrecorded: all.unrecorded,
                        late: all.late_releases,
                        overruns: all.overruns,
                        unfinished_windows: all.unfinished_windows,
                        latency_sum_ns: releases.latency_sum(),
                        release_latency_ns: all.release_latency_ns,
                        execution_ns: all.execution_ns,
                        wake_up_latency_ns: all.wake_up_latency_ns,
                    },
                ),
                programs: programs::status(
                    &facts.programs,
                    self.live.figures(id),
                    account.life.is_up(),
                ),
                forced: self.live.forced(id),
            }
        });
        Status {
            takt: env!("CARGO_PKG_VERSION").to_owned(),
            pid: facts.pid,
            system: facts.system.clone(),
            file: facts.file.clone(),
            uptime_ns: now.0,
            major_frame_ns: facts.frame.0,
            schedule: self.schedule(now),
            partitions: partitions.collect(),
            channels,
        }
    }

    fn stop(&mut self, partition: &str) -> Result<String, Refusal> {
        self.order(partition, Order::Stop, "stops")
    }

    fn start(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal> {
        self.order(partition, Order::Start(mode.into()), "starts")
    }

    fn restart(&mut self, partition: &str, mode: Mode) -> Result<String, Refusal> {
        self.order(partition, Order::Restart(mode.into()), "stops, and starts again")
    }

    fn switch_schedule(&mut self, name: &str) -> Result<String, Refusal> {
        let Some(position) = self.facts.schedules.iter().position(|s| s.name == name) else {
            let text = "there is no schedule of this name";
            return Err(Refusal::new(ErrorKind::NoSuchSchedule, text));
        };
        match self.desk.ask_for(position) {
            Ok(()) => Ok(format!("schedule \"{name}\" will hold from the end of a frame on")),
            Err(error) => {
                Err(Refusal::new(ErrorKind::Refused, format!("schedule \"{name}\": {error}")))
            }
        }
    }

    fn watch(
        &mut self,
        client: u64,
        partition: &str,
        ranges: Vec<Range>,
        interval: Nanos,
    ) -> Result<u64, Refusal> {
        let place = self.place(partition)?;
        self.live.watch(client, place, ranges, interval)
    }

    fn order_values(&mut self, partition: &str, order: ValueOrder) -> Result<u64, Refusal> {
        let (place, now) = (self.place(partition)?, self.desk.now());
        self.live.order_values(place, order, now)
    }

    fn result(&mut self, ticket: u64) -> Option<Result<String, Refusal>> {
        self.live.result(ticket)
    }

    fn load(&mut self, load: Load) -> Result<String, Refusal> {
        let place = self.place(&load.partition)?;
        let banks = self.accounts.get(place).and_then(|account| account.banks.as_ref());
        self.live.load(place, &load, banks.ok_or_else(no_programs)?)
    }

    fn commit(&mut self, partition: &str, program: &str) -> Result<String, Refusal> {
        let place = self.place(partition)?;
        self.live.commit(place, program)
    }

    fn roll_back(&mut self, partition: &str, program: &str) -> Result<String, Refusal> {
        let place = self.place(partition)?;
        self.live.roll_back(place, program)
    }

    fn versions(&mut self, partition: &str) -> Result<Vec<VersionStatus>, Refusal> {
        let place = self.place(partition)?;
        self.live.versions(place)
    }

    fn console(&mut self, partition: &str) -> Result<(usize, bool), Refusal> {
        let place = self.place(partition)?;
        Ok((place, self.accounts.get(place).is_some_and(|account| account.is_terminal)))
    }

    fn type_bytes(&mut self, partition: &str, bytes: &[u8]) -> Result<usize, Refusal> {
        let keyboard = &self.find(partition)?.keyboard;
        let text = "the console of a PLC has no keyboard";
        let none = || Refusal::new(ErrorKind::Unsupported, text);
        Ok(keyboard.as_ref().ok_or_else(none)?.type_bytes(bytes))
    }

    fn trace(&self) -> TraceStart {
        let (base, since) = (self.desk.base(), Tsc::now());
        let current = self.desk.status(base.offset(since)).current;
        let names = self.facts.schedules.iter().map(|schedule| schedule.name.clone());
        let partitions = self.accounts.iter().zip(&self.facts.partitions);
        TraceStart {
            tsc_khz: base.frequency.khz(),
            epoch_tsc: base.epoch.0,
            since_tsc: since.0,
            schedule: self.facts.schedules[current.0].name.clone(),
            schedules: names.collect(),
            partitions: partitions
                .map(|(account, facts)| TracedPartition {
                    name: account.name.clone(),
                    cpu: facts.cpu,
                })
                .collect(),
        }
    }
}
