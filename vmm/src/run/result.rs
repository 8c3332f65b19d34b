//! From what a run has left to its report.

use std::sync::Arc;

use takt_abi::memory::PAGE;
use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::table::{Cpu, Role};
use takt_scheduler::time::{Nanos, Timebase};

use super::start::Facts;
use crate::account::Account;
use crate::config::{Kind, Partition};
use crate::health::Fault;
use crate::host_ports;
use crate::kernel_watch::KernelWatch;
use crate::memory::Pages;
use crate::prepare::LinuxParts;
use crate::report::{self, Report};
use crate::supervisor::Supervisor;
use crate::vcpu::Control;
use crate::vcpu::guest_timer::Told;
use crate::vsock::Vsock;

impl Facts<'_> {
    pub(super) fn report(
        &self,
        supervisor: &Supervisor,
        duration: Nanos,
        host_ports: Vec<host_ports::Account>,
        process: report::Process,
        output: report::Output,
    ) -> Report {
        let base = self.epoch.base;
        let partitions = supervisor.accounts.iter().zip(&self.linux).zip(self.file.partitions());
        let describe =
            |((account, linux), partition): ((&Account, &Option<LinuxParts>), &Partition)| {
                let (all, linux) = (&supervisor.accounts, linux.as_ref());
                report::Partition {
                    operator: supervisor.operators.as_ref().and_then(|o| o.told(partition.id())),
                    ..self.describe(account, partition, duration, all, linux, base)
                }
            };
        let enforcer = |(cpu, control): &(Cpu, Arc<Control>)| report::WindowEnforcer {
            cpu: cpu.0,
            wake_ups: control.wake_ups().into(),
        };
        let status = self.board.status(duration);
        let schedule = |id: ScheduleId| self.file.schedule_names()[id.0].clone();
        Report {
            schema_version: report::SCHEMA_VERSION,
            lane: self.options.lane.clone(),
            emulator: self.options.emulator.clone(),
            host: self.host.clone(),
            system: self.file.name().to_owned(),
            epoch_tsc: base.epoch.0,
            duration_ns: duration.0,
            kick: self.options.hooks.kicks(),
            tick: self.epoch.told(),
            schedule: report::Schedule {
                current: schedule(status.current),
                next: schedule(status.next),
                last_switch_ns: status.last_switch.map(|at| at.0),
            },
            partitions: partitions.map(describe).collect(),
            window_enforcers: self.enforcers.iter().map(enforcer).collect(),
            host_ports,
            process,
            output,
        }
    }

    fn describe(
        &self,
        account: &Account,
        partition: &Partition,
        duration: Nanos,
        all: &[Account],
        linux: Option<&LinuxParts>,
        base: Timebase,
    ) -> report::Partition {
        let finished = account.life.finished();
        let held_up = linux.is_some_and(LinuxParts::is_held_up);
        let schedules = self.file.schedules();
        let cpu_time = finished.map_or(Nanos::ZERO, |f| f.cpu_time);
        let donation =
            (schedules.placements()[partition.id().0].role == Role::Background).then(|| {
                // What windows have left of each of its CPUs.
                let left = |cpu| {
                    let neighbours = self.file.partitions().iter().zip(all);
                    let used = neighbours
                        .filter(|(p, _)| p.cpu() == cpu)
                        .fold(Nanos::ZERO, |sum, (_, account)| sum.plus(account.used()));
                    duration.less(used).0
                };
                report::Donation {
                    offered_ns: partition.cpus().map(left).sum(),
                    received_ns: cpu_time.0,
                    minimum_share: self.file.least_own_time(partition.id()).0 as f64
                        / schedules.frame().0 as f64,
                }
            });
        report::Partition {
            name: account.name.clone(),
            kind: match partition.kind() {
                Kind::Plc { .. } => "plc".into(),
                Kind::Linux { .. } => "linux".into(),
            },
            end: account.end().unwrap_or_else(|| no_end(held_up).to_owned()),
            memory_page_bytes: match self.pages.get(partition.id().0) {
                Some(Pages::Huge(size)) => size.bytes(),
                _ => PAGE,
            },
            failed: account.life.ended_run() || finished.is_none_or(|f| f.end.is_failure()),
            restarts: account.life.restarts(),
            cpu_share: cpu_time.0 as f64 / duration.0.max(1) as f64,
            events: account.health.report(),
            illegal_accesses: account.health.count(Fault::IllegalRequest),
            console_dropped: account.console_dropped(),
            releases: account.figures(),
            wake_ups: account.records.as_ref().map(|_| account.control.wake_ups().into()),
            donation,
            stuck: account.kernel.as_ref().map(KernelWatch::stuck),
            deadlines: Told::of(&account.deadlines).map(|told| {
                let Told { programmed, moved, put_back } = told;
                report::Deadlines { programmed, moved, put_back }
            }),
            operator: None,
            power_off: account
                .power_button
                .as_ref()
                .and_then(|button| button.report(finished.map(|f| (f.end, base.offset(f.at))))),
            nets: linux.map_or_else(Vec::new, |linux| linux.nets.clone()),
            held_up,
            vsock: linux.and_then(|l| l.vsock.as_ref()).map(Vsock::report),
            boot_to_init_ns: linux.map(|l| l.init.instant().map(|at| base.offset(at).0)),
        }
    }
}

/// What is said of a thread that has not told of its end.
const fn no_end(held_up: bool) -> &'static str {
    if held_up { "its thread waits for the kernel" } else { "its thread died" }
}
