//! From threads that wait to guests that run: the last door, the epoch, and who is told first.

use std::sync::Arc;

use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::{Nanos, Timebase};
use vmm_sys_util::eventfd::EventFd;

use super::epoch::Epoch;
use super::{Run, nanos};
use crate::account::Account;
use crate::config::{self, Partition, Trust};
use crate::disk::DiskThread;
use crate::host_clock::HostClock;
use crate::host_watchdog::HostWatchdog;
use crate::huge_pages;
use crate::init_watch::Console;
use crate::outlet::Trace;
use crate::outlet::{LaneWriter, Outlet};
use crate::prepare::{LinuxParts, Prepared, WindowEnforcer};
use crate::report;
use crate::run_error::RunError;
use crate::sandbox;
use crate::schedule_requests::ScheduleRequests;
use crate::screen::Screen;
use crate::supervisor::{Sources, Supervisor};
use crate::vcpu::Control;
use crate::vcpu::thread::{Ready, Running};

/// From the moment that all threads wait to the epoch: time to tell this many of them, and for each to
/// fall asleep until its first window. One that is late begins with its next window; a window enforcer that is
/// late lets windows go on, so there is time to spare.
const fn start_delay(threads: usize) -> Nanos {
    Nanos::from_micros(300 + 50 * threads as u64)
}

/// The CPU that the calling thread runs on. It stays there, or at least on one of those without windows:
/// CPUs with windows have scheduling domains of their own, unless there is only one.
fn this_cpu() -> Option<Cpu> {
    // SAFETY: takes no pointers.
    usize::try_from(unsafe { libc::sched_getcpu() }).ok().map(Cpu)
}

/// A run whose threads have been told the epoch.
pub(super) struct Started {
    pub supervisor: Supervisor,
    pub running: Vec<Running<()>>,
    /// Those that may be busy with a file for as long as it likes.
    pub disks: Vec<Running<()>>,
    /// Of all that run.
    pub controls: Vec<Arc<Control>>,
    /// To be rung for those that wait for one.
    pub bells: Vec<EventFd>,
    /// By partition.
    pub linux: Vec<Option<LinuxParts>>,
    pub epoch: Epoch,
    pub starting: report::Starting,
}

impl Run<'_> {
    /// Shuts the last door, chooses the epoch and tells all threads.
    pub(super) fn start(
        &mut self,
        prepared: Vec<Prepared>,
        kickers: Vec<WindowEnforcer>,
        console: Option<Console>,
        mut screen: Screen,
        sources: Sources,
    ) -> Result<Started, RunError> {
        let (mut accounts, mut linux, mut disks) = (Vec::new(), Vec::new(), Vec::new());
        let (mut windowed, mut others) = (Vec::new(), Vec::new());
        for Prepared { account, thread, further, linux: parts, disks: own } in prepared {
            let kin = if account.records.is_some() { &mut windowed } else { &mut others };
            kin.push(thread);
            others.extend(further);
            accounts.push(account);
            linux.push(parts);
            disks.extend(own);
        }
        let watchdog = self.watchdog(&accounts, &kickers)?;
        self.options.hooks.arm(&accounts, &kickers)?;
        let clock = HostClock::open(self.frequency);
        self.steps.pass()?;
        // Nothing of the host is opened any more, and no guest has run yet.
        let doors = (sandbox::Kind::Main, self.options.seccomp);
        if !sandbox::enter(doors.0, doors.1, "main", &self.given_back)? {
            screen.line("takt", "this kernel has no Landlock: files stay within reach");
        }
        self.steps.pass()?;

        self.enforcers = kickers.iter().map(|k| (k.cpu, k.control.clone())).collect();
        let (kickers, mut controls): (Vec<_>, Vec<_>) = kickers
            .into_iter()
            .map(|WindowEnforcer { control, thread, .. }| (thread, control))
            .unzip();
        let all = accounts.iter().flat_map(|a| [&a.control].into_iter().chain(&a.further));
        controls.extend(all.cloned());
        let (mut bells, mut disk_threads) = (Vec::new(), Vec::new());
        for DiskThread { control, bell, thread } in disks {
            controls.push(control);
            bells.push(bell);
            disk_threads.push(thread);
        }
        let schedules = self.file.schedules();
        let quiet: Vec<QuietTimes> =
            schedules.cpus().iter().filter_map(|cpu| schedules.quiet_on(*cpu, None)).collect();
        let epoch = Epoch::choose(start_delay(controls.len()), self.frequency, &quiet);
        let began = self.options.began;
        let starting = report::Starting {
            first_release_ns: began.map(|began| nanos(began.elapsed()) + epoch.delay.0),
            clearing_ns: nanos(self.clearing),
            aligning_ns: epoch.aligning.0,
        };
        let base = epoch.base;
        // A window may begin only once the enforcer of its end has started, and a thread without windows
        // may take the processor from this one as soon as it is started.
        let threads = kickers.into_iter().chain(windowed).chain(others);
        let running: Vec<_> = threads.map(|thread| Ready::start(thread, base)).collect();
        let disks = disk_threads.into_iter().map(|thread| Ready::start(thread, base)).collect();

        for account in &mut accounts {
            account.start(base, self.options.samples.is_some());
        }
        let trace = self.trace_outlet.clone().map(|outlet| self.begin_trace(outlet, base));
        let desk = ScheduleRequests::new(self.board.clone(), self.file.schedule_names(), base);
        let mut supervisor = Supervisor::new(accounts, desk, trace, screen, console, sources);
        supervisor.host_ports = self.host_ports.take();
        supervisor.operators = self.operators.take();
        supervisor.interrupts = self.interrupts.take();
        supervisor.watchdog = watchdog;
        supervisor.clock = Some(clock);
        supervisor.quiet = this_cpu().and_then(|cpu| schedules.quiet_on(cpu, None));
        self.tell(&mut supervisor.screen, starting);
        Ok(Started { supervisor, running, disks, controls, bells, linux, epoch, starting })
    }

    /// Tells people what begins.
    fn tell(&self, screen: &mut Screen, starting: report::Starting) {
        let names: Vec<&str> = self.file.partitions().iter().map(Partition::name).collect();
        let (file, names) = (self.file.name(), names.join(", "));
        screen.line("takt", &format!("{file}: starting {names}; Ctrl-] q ends the run"));
        screen.line("takt", &starting.to_string());
        for (partition, pages) in self.file.partitions().iter().zip(&self.pages) {
            if let Some(text) = huge_pages::told(partition, *pages) {
                screen.line("takt", &text);
            }
            if partition.console() == Some(config::Console::Control) {
                let (name, file) = (partition.name(), self.file.path().display());
                screen.line("takt", &format!("{name}: its console: takt console {file} {name}"));
            }
            let unsigned = partition.programs().iter().filter(|p| p.trust == Trust::Unsigned);
            let unsigned: Vec<&str> = unsigned.map(|program| program.name.as_str()).collect();
            if !unsigned.is_empty() {
                let names = unsigned.join(", ");
                screen.line(
                    "takt",
                    &format!("{}: programs without a signature: {names}", partition.name()),
                );
            }
        }
        for text in self.options.hooks.told() {
            screen.line("takt", &text);
        }
    }

    /// The host's watchdog, if the file wants it served.
    fn watchdog(
        &self,
        accounts: &[Account],
        kickers: &[WindowEnforcer],
    ) -> Result<Option<HostWatchdog>, RunError> {
        let Some(time) = self.file.watchdog() else { return Ok(None) };
        let windowed = accounts.iter().filter(|account| account.records.is_some());
        let threads = windowed.map(|account| account.control.clone());
        let threads = threads.chain(kickers.iter().map(|kicker| kicker.control.clone()));
        let frame = self.file.schedules().frame();
        HostWatchdog::start(time, frame, threads.collect(), self.options.role)
            .map(Some)
            .map_err(RunError::Watchdog)
    }

    fn begin_trace(&self, outlet: Arc<Outlet>, base: Timebase) -> Trace {
        let partitions: Vec<(&str, Cpu)> =
            self.file.partitions().iter().map(|p| (p.name(), p.cpu())).collect();
        let schedules: Vec<&str> = self.file.schedule_names().iter().map(String::as_str).collect();
        Trace::new(LaneWriter { outlet, lane: 0 }, base, &partitions, &schedules)
    }
}
