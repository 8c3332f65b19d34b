//! The third stage, from threads that wait to guests that run: the last door, the epoch, and who is told first.

use std::cell::RefCell;
use std::os::fd::AsRawFd;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::switch::ScheduleState;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::{Nanos, Timebase};
use vmm_sys_util::eventfd::EventFd;

use super::epoch::{Epoch, tick_of_host};
use super::output::{Outputs, Patience};
use super::waiting::Waiting;
use super::{Options, nanos};
use crate::account::Account;
use crate::config::{self, Partition, PartitionFile, Trust};
use crate::disk::DiskThread;
use crate::host_clock::HostClock;
use crate::host_watchdog::{HostWatchdog, SharedWatchdog};
use crate::huge_pages;
use crate::linux_machine;
use crate::memory::Pages;
use crate::outlet::{LaneWriter, Outlet, Trace};
use crate::passthrough::emergency_stop::Armed;
use crate::prepare::{Finish, LinuxParts, Prepared, WindowEnforcer};
use crate::report;
use crate::run_error::RunError;
use crate::sandbox;
use crate::schedule_requests::ScheduleRequests;
use crate::screen::Screen;
use crate::supervisor::Supervisor;
use crate::terminal;
use crate::vcpu::Control;
use crate::vcpu::thread::{self, Ready};

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
pub(super) struct Running<'a> {
    pub facts: Facts<'a>,
    pub supervisor: Supervisor,
    pub threads: Vec<thread::Running<()>>,
    /// Those of guests that may wait in the kernel for a program of the host.
    pub waiting: Vec<thread::Running<()>>,
    /// Those that may be busy with a file for as long as it likes.
    pub disks: Vec<thread::Running<()>>,
    /// Of all that run.
    pub controls: Vec<Arc<Control>>,
    /// To be rung for those that wait for one.
    pub bells: Vec<EventFd>,
    /// Set when the run is over: console output is not taken any more.
    pub closing: Arc<AtomicBool>,
    pub outputs: Outputs,
    /// While guests may drive devices.
    pub guard: Armed,
}

/// What a report has of a run beside what the supervisor knows.
pub(super) struct Facts<'a> {
    pub file: &'a PartitionFile,
    pub options: &'a Options,
    pub board: Arc<ScheduleState>,
    /// Of which pages the memory of each partition is, in their order.
    pub pages: Vec<Pages>,
    pub host: report::Host,
    /// What ends windows.
    pub enforcers: Vec<(Cpu, Arc<Control>)>,
    /// By partition.
    pub linux: Vec<Option<LinuxParts>>,
    pub epoch: Epoch,
    pub starting: report::Starting,
}

impl<'a> Waiting<'a> {
    /// Shuts the last door, chooses the epoch and tells all threads.
    ///
    /// # Errors
    /// See [`RunError`]. What Takt has said by then is read, or has had its time.
    pub(super) fn start(self) -> Result<Running<'a>, RunError> {
        let console = self.outputs.console.clone();
        self.tell_all().inspect_err(|_| {
            terminal::restore();
            Patience::LONG.settle(&console);
        })
    }

    fn tell_all(self) -> Result<Running<'a>, RunError> {
        let Waiting { file, options, held, partitions, enforcers, frequency, outputs, .. } = self;
        let Waiting { mut screen, board, pages, steps, host, .. } = self;
        let Finish { closing, console, interrupts, clearing } = self.finish;
        let controls: Vec<_> = partitions.iter().map(|p| p.account.control.clone()).collect();
        let guard = held.devices.guard(&controls);
        options.hooks.start_panicking(options.seccomp)?;
        drop(self.expedited);
        let (mut accounts, mut linux, mut disks) = (Vec::new(), Vec::new(), Vec::new());
        let (mut windowed, mut others, mut waiting) = (Vec::new(), Vec::new(), Vec::new());
        for Prepared { account, thread, further, linux: parts, disks: own } in partitions {
            let waits = parts.as_ref().is_some_and(|parts| parts.closer.is_some());
            let others = if waits { &mut waiting } else { &mut others };
            others.extend(further);
            if account.records.is_some() { &mut windowed } else { others }.push(thread);
            accounts.push(account);
            linux.push(parts);
            disks.extend(own);
        }
        let watchdog = watchdog(file, options, &accounts, &enforcers)?;
        options.hooks.arm(&accounts, &enforcers)?;
        let (clock, domains) = (HostClock::open(frequency), held.domains.watch());
        let cpu = this_cpu();
        let tick = tick_of_host();
        steps.pass()?;
        // Nothing of the host is opened any more, and no guest has run yet.
        let given_back = held.given_back(file, options);
        if !sandbox::enter(sandbox::Kind::Main, options.seccomp, "main", &given_back)? {
            screen.line("takt", "this kernel has no Landlock: files stay within reach");
        }
        steps.pass()?;

        let of_cpus = enforcers.iter().map(|e| (e.cpu, e.control.clone())).collect();
        let (enforcers, mut controls): (Vec<_>, Vec<_>) = enforcers
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
        let schedules = file.schedules();
        let quiet: Vec<QuietTimes> =
            schedules.cpus().iter().filter_map(|cpu| schedules.quiet_on(*cpu, None)).collect();
        let epoch = Epoch::choose(start_delay(controls.len()), tick, frequency, &quiet);
        let starting = report::Starting {
            first_release_ns: options.began.map(|began| nanos(began.elapsed()) + epoch.delay.0),
            clearing_ns: nanos(clearing),
            aligning_ns: epoch.aligning.0,
        };
        let base = epoch.base;
        // Each was started with its machine, as at a restart. The time of the first start counts from here, however long others
        // were prepared meanwhile.
        accounts
            .iter()
            .filter_map(|a| a.watchdog.as_ref())
            .for_each(|w| w.start(linux_machine::clock()));
        // A window may begin only once the enforcer of its end has started, and a thread without windows
        // may take the processor from this one as soon as it is started.
        let threads = enforcers.into_iter().chain(windowed).chain(others);
        let threads: Vec<_> = threads.map(|thread| Ready::start(thread, base)).collect();
        let waiting = waiting.into_iter().map(|thread| Ready::start(thread, base)).collect();
        let disks = disk_threads.into_iter().map(|thread| Ready::start(thread, base)).collect();

        for account in &mut accounts {
            account.start(base, options.samples.is_some());
        }
        let trace = outputs.trace.as_ref().map(|to| trace(file, to.outlet.clone(), base));
        let desk = ScheduleRequests::new(board.clone(), file.schedule_names(), base);
        let mut supervisor = Supervisor::new(accounts, desk, trace, screen, console, self.sources);
        supervisor.host_ports = self.host_ports;
        supervisor.operators = self.operators;
        supervisor.interrupts = interrupts;
        supervisor.watchdog = watchdog;
        supervisor.guardian = held.guardian.as_ref().map(AsRawFd::as_raw_fd);
        supervisor.clock = Some(clock);
        supervisor.domains = domains;
        supervisor.quiet = cpu.and_then(|cpu| schedules.quiet_on(cpu, None));
        let enforcers = of_cpus;
        let facts = Facts { file, options, board, pages, host, enforcers, linux, epoch, starting };
        facts.tell(&mut supervisor.screen);
        Ok(Running {
            facts,
            supervisor,
            threads,
            waiting,
            disks,
            controls,
            bells,
            closing,
            outputs,
            guard,
        })
    }
}

impl Facts<'_> {
    /// Tells people what begins.
    fn tell(&self, screen: &mut Screen) {
        let names: Vec<&str> = self.file.partitions().iter().map(Partition::name).collect();
        let (file, names) = (self.file.name(), names.join(", "));
        screen.line("takt", &format!("{file}: starting {names}; Ctrl-] q ends the run"));
        screen.line("takt", &self.starting.to_string());
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
}

/// The host's watchdog, if the file wants it served.
fn watchdog(
    file: &PartitionFile,
    options: &Options,
    accounts: &[Account],
    enforcers: &[WindowEnforcer],
) -> Result<Option<SharedWatchdog>, RunError> {
    let Some(time) = file.watchdog() else { return Ok(None) };
    let windowed = accounts.iter().filter(|account| account.records.is_some());
    let threads = windowed.map(|account| account.control.clone());
    let threads = threads.chain(enforcers.iter().map(|enforcer| enforcer.control.clone()));
    let frame = file.schedules().frame();
    let watchdog = HostWatchdog::start(time, frame, threads.collect(), options.role)?;
    Ok(Some(Rc::new(RefCell::new(watchdog))))
}

fn trace(file: &PartitionFile, outlet: Arc<Outlet>, base: Timebase) -> Trace {
    let partitions: Vec<(&str, Cpu)> =
        file.partitions().iter().map(|p| (p.name(), p.cpu())).collect();
    let schedules: Vec<&str> = file.schedule_names().iter().map(String::as_str).collect();
    Trace::new(LaneWriter { outlet, lane: 0 }, base, &partitions, &schedules)
}
