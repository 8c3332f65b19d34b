//! `takt run`: from a partition file to a report.
//!
//! Everything that can fail is done before the first guest instruction: memory, machines, images,
//! threads with their reservations. Then all partitions start from one epoch, and from there on
//! nothing is allocated or mapped for a guest.

mod disturbances;
mod options;
mod output;
mod result;

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::time::Duration;

use takt_scheduler::switch::SwitchBoard;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::{Nanos, Timebase, Tsc, TscFrequency};

use disturbances::{Steps, panic_after, provoke};
pub use options::Options;
use output::Output;

use crate::account::Account;
use crate::appliance::{self, hurry::Hurry};
use crate::channels::Channels;
use crate::config::{HostPort, Partition, PartitionFile};
use crate::control::Operators;
use crate::cpuset::Domains;
use crate::disk::DiskThread;
use crate::footprint::Footprint;
use crate::host_ports::HostPorts;
use crate::host_watchdog::HostWatchdog;
use crate::init_watch::Console;
use crate::interrupts::Interrupts;
use crate::machine::{self, MachineError};
use crate::passthrough::{Devices, last_work};
use crate::prepare::{Finish, Kicker, Preparation, Prepared, clone, eventfd};
use crate::report::{self, Host, Report};
use crate::run_error::RunError;
use crate::samples::{self, Samples};
use crate::sandbox::{self, Allowed};
use crate::schedule_desk::ScheduleDesk;
use crate::supervisor::{Endings, Supervisor, take_signals};
use crate::terminal::{self, Screen};
use crate::trace::Trace;
use crate::unix_socket::{Listener, SocketKind};
use crate::vcpu::thread::Running;
use crate::vcpu::{Control, kick};

/// From the moment that all threads are ready to the epoch: time to open the accounts of this many
/// partitions, to shut the last door, and for all threads to fall asleep. One that is late begins with
/// its next window; a kicker that is late lets windows go on, so there is time to spare.
const fn start_delay(partitions: usize) -> Nanos {
    Nanos::from_millis(20 + partitions as u64)
}

/// Runs all partitions of `file` until the run is over.
///
/// # Errors
/// See [`RunError`]. A partition that fails is not an error of the run: the report tells of it.
pub fn run(file: &PartitionFile, options: &Options) -> Result<Report, RunError> {
    let steps = Steps::new(options.fail_at);
    sandbox::prepare(|| {
        let written = last_work::do_it();
        terminal::restore_at_once();
        written
    })?;
    let signals = take_signals()?;
    lock_memory()?;
    steps.pass()?;
    kick::install()
        .map_err(|e| io::Error::from_raw_os_error(e.errno()))
        .map_err(|source| RunError::Host { what: "install the kick's signal handler", source })?;
    let control = options
        .control
        .as_deref()
        .or(file.control())
        .map(|path| Listener::bind(path, SocketKind::Stream))
        .transpose()?;
    steps.pass()?;
    // Given back after all threads have been let go.
    let devices = Devices::take(file)?;
    steps.pass()?;
    // While there is no guest and no thread that it would be a copy of. Dropped after all threads
    // have written their values.
    let _guardian = devices.guardian(options.seccomp)?;
    steps.pass()?;
    let channels = Channels::new(file.channels())?;
    let operators =
        control.map(|listener| Operators::new(listener, file, &channels)).transpose()?;
    steps.pass()?;
    let hurry = Hurry::begin();
    // Dropped after all threads have been let go.
    let domains = Domains::set_up(file.schedules())?;
    steps.pass()?;
    let (sender, ends) = channel();
    let bell = eventfd()?;
    let schedules = file.schedules();
    let mut preparation = Preparation {
        file,
        kvm: machine::open_kvm()?,
        channels: &channels,
        devices: &devices,
        domains: &domains,
        sender,
        bell: clone(&bell)?,
        closing: Arc::default(),
        board: Arc::new(SwitchBoard::new(schedules.frame(), schedules.tables().len())),
        frequency: None,
        clearing: Duration::ZERO,
        console: None,
        doorbell: eventfd()?,
        interrupts: Interrupts::new()?,
        late_wake_up: options.late_wake_up,
        mode: options.seccomp,
    };
    let mut prepared = Vec::new();
    for partition in file.partitions() {
        prepared.push(preparation.partition(partition)?);
        steps.pass()?;
    }
    let kickers = if options.without_kick { Vec::new() } else { preparation.kickers(&prepared)? };
    steps.pass()?;
    let Some(frequency) = preparation.frequency else {
        return Err(MachineError::Missing("a machine to run").into());
    };

    let host_ports = HostPorts::open(&channels, frequency, appliance::results())?;
    steps.pass()?;
    let output = |what, path: &Option<PathBuf>| {
        path.as_deref().map(|path| Output::create(what, path)).transpose()
    };
    let report_file = output("report", &options.report)?;
    let samples_file = output("samples", &options.samples)?;
    steps.pass()?;
    let raw = terminal::make_raw()
        .map_err(|source| RunError::Host { what: "put the terminal into raw mode", source })?;
    let Finish { closing, board, console, interrupts, clearing } = preparation.finish();
    let given_back = given_back(file, options, &devices, &domains);
    let host = Host::current(frequency.khz());
    let mut run = Run {
        file,
        options,
        frequency,
        clearing,
        closing,
        board,
        host_ports,
        operators,
        interrupts,
        samples_file,
        given_back,
        host,
        steps,
    };
    let screen = Screen::new(io::stdout(), raw);
    let controls: Vec<Arc<Control>> = prepared.iter().map(|p| p.account.control.clone()).collect();
    let guard = devices.guard(&controls);
    if let Some(after) = options.panic_after {
        panic_after(after, options.seccomp)?;
    }
    drop(hurry);
    let result = run.start(prepared, kickers, console, screen, signals, Endings { bell, ends });
    drop(guard);
    terminal::restore();
    let report = result?;
    if let Some(file) = report_file {
        file.write(serde_json::to_string_pretty(&report))?;
    }
    Ok(report)
}

/// A run, from its start to its report.
struct Run<'a> {
    file: &'a PartitionFile,
    options: &'a Options,
    frequency: TscFrequency,
    /// How long it took to clear the guests' memory.
    clearing: Duration,
    closing: Arc<AtomicBool>,
    board: Arc<SwitchBoard>,
    /// Until the supervisor has them.
    host_ports: Option<HostPorts>,
    /// Until the supervisor has it.
    operators: Option<Operators>,
    /// Until the supervisor has them.
    interrupts: Option<Interrupts>,
    /// Where samples go, until they do.
    samples_file: Option<Output>,
    /// What of the file system is needed to the end.
    given_back: Vec<Allowed>,
    /// The machine, for the report.
    host: Host,
    steps: Steps,
}

impl Run<'_> {
    fn start(
        &mut self,
        prepared: Vec<Prepared>,
        kickers: Vec<Kicker>,
        console: Option<Console>,
        screen: Screen<io::Stdout>,
        signals: fs::File,
        endings: Endings,
    ) -> Result<Report, RunError> {
        let delay = start_delay(prepared.len());
        let epoch = Tsc::now().after(self.frequency.ticks(delay));
        let base = Timebase { epoch, frequency: self.frequency };
        let starting = report::Starting {
            first_release_ns: self.options.began.map(|began| nanos(began.elapsed()) + delay.0),
            clearing_ns: nanos(self.clearing),
        };
        let trace =
            self.options.trace.as_ref().map(|path| self.create_trace(path, base)).transpose()?;
        let desk = ScheduleDesk::new(self.board.clone(), self.file.schedule_names(), base);
        let (mut accounts, mut threads, mut inits) = (Vec::new(), Vec::new(), Vec::new());
        let mut disks = Vec::new();
        for Prepared { mut account, thread, init, disks: own } in prepared {
            disks.extend(own);
            account.start(base, self.options.samples.is_some());
            accounts.push(account);
            threads.push(thread);
            inits.push(init);
        }
        let mut controls: Vec<Arc<Control>> = accounts.iter().map(|a| a.control.clone()).collect();
        let mut supervisor =
            Supervisor::new(accounts, desk, trace, screen, console, signals, endings)?;
        supervisor.host_ports = self.host_ports.take();
        supervisor.operators = self.operators.take();
        if let Some(time) = self.file.watchdog() {
            let windowed = supervisor.accounts.iter().filter(|account| account.records.is_some());
            let threads = windowed.map(|account| account.control.clone());
            let threads = threads.chain(kickers.iter().map(|kicker| kicker.control.clone()));
            let frame = self.file.schedules().frame();
            let watchdog = HostWatchdog::start(time, frame, threads.collect());
            supervisor.watchdog = Some(watchdog.map_err(RunError::Watchdog)?);
        }
        supervisor.interrupts = self.interrupts.take();
        if let Some(thread) = &self.options.provoke {
            provoke(thread, &supervisor.accounts, &kickers)?;
        }
        self.steps.pass()?;
        // Nothing of the host is opened any more, and no guest has run yet.
        let doors = (sandbox::Kind::Main, self.options.seccomp);
        if !sandbox::enter(doors.0, doors.1, "main", &self.given_back)? {
            supervisor.screen.line("takt", "this kernel has no Landlock: files stay within reach");
        }
        self.steps.pass()?;
        // Kickers first: no window may begin whose end nobody has been told of.
        let mut running: Vec<Running<()>> = Vec::new();
        for Kicker { control, thread } in kickers {
            controls.push(control);
            running.push(thread.start(base));
        }
        running.extend(threads.into_iter().map(|thread| thread.start(base)));
        let mut bells = Vec::new();
        for DiskThread { control, bell, thread } in disks {
            controls.push(control);
            bells.push(bell);
            running.push(thread.start(base));
        }
        let names: Vec<&str> = self.file.partitions().iter().map(Partition::name).collect();
        supervisor.screen.line(
            "takt",
            &format!("{}: starting {}; Ctrl-] q ends the run", self.file.name(), names.join(", ")),
        );
        supervisor.screen.line("takt", &starting.to_string());
        if self.options.without_kick {
            supervisor.screen.line("takt", "TEST: windows are not ended by kicks");
        }
        if let Some(release) = self.options.late_wake_up {
            let text = format!("TEST: the wake-up for release {release} comes late");
            supervisor.screen.line("takt", &text);
        }
        let start = Footprint::now();
        // The time that was asked for is that of the schedule.
        let ahead = Duration::from_nanos(self.frequency.nanos(epoch.since(Tsc::now())).0);
        let supervised = supervisor.supervise(self.options.duration.map(|time| time + ahead));
        let process = report::Process { start, end: Footprint::now(), starting };
        let duration = self.frequency.nanos(Tsc::now().since(epoch));
        self.closing.store(true, Ordering::Relaxed);
        Control::stop_all(&controls);
        for bell in bells {
            // Fails only if it has been rung 2^64 times, and then its thread is awake.
            let _ = bell.write(1);
        }
        // A thread whose guest has ended waits for the word to start it anew, which the
        // supervisor can give no more.
        let supervised = supervised.map(Supervisor::without_restarts);
        for thread in running {
            thread.join();
        }
        let mut supervisor = supervised?;
        supervisor.note_endings();
        supervisor.drain();
        supervisor.serve_host_ports(HostPorts::finish);
        if let (Some(trace), Some(path)) = (supervisor.trace.take(), &self.options.trace) {
            let failed = |source| RunError::Output { what: "trace", path: path.clone(), source };
            trace.finish().map_err(failed)?;
        }
        if let Some(file) = self.samples_file.take() {
            let partitions = supervisor.accounts.iter().filter_map(Account::course).collect();
            let samples = Samples { schema_version: samples::SCHEMA_VERSION, partitions };
            file.write(serde_json::to_string(&samples))?;
        }
        let host_ports = supervisor.host_ports.as_mut().map_or_else(Vec::new, HostPorts::accounts);
        Ok(self.report(&supervisor, &inits, base, duration, host_ports, process))
    }

    fn create_trace(&self, path: &Path, base: Timebase) -> Result<Trace, RunError> {
        let partitions: Vec<(&str, Cpu)> =
            self.file.partitions().iter().map(|p| (p.name(), p.cpu())).collect();
        let schedules: Vec<&str> = self.file.schedule_names().iter().map(String::as_str).collect();
        Trace::create(path, base, &partitions, &schedules).map_err(|source| RunError::Output {
            what: "trace",
            path: path.to_owned(),
            source,
        })
    }
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// Locks all memory, now and later: no page of a guest or of Takt is ever missing.
fn lock_memory() -> Result<(), RunError> {
    // SAFETY: changes how the process's memory is kept, not what is in it.
    let result = unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) };
    if result == 0 { Ok(()) } else { Err(RunError::Lock(io::Error::last_os_error())) }
}

/// What is still to be changed in the file system at the end of the run.
fn given_back(
    file: &PartitionFile,
    options: &Options,
    devices: &Devices,
    domains: &Domains,
) -> Vec<Allowed> {
    let figures = Allowed::Read("/proc/self".into());
    let control = options.control.as_deref().or(file.control());
    let ends = file.channels().iter().filter_map(|channel| match &channel.host {
        Some(HostPort::Socket(path)) if appliance::results().is_none() => Some(path.as_path()),
        _ => None,
    });
    let folder = |socket: &Path| match socket.parent() {
        Some(folder) if folder != "" => Allowed::RemoveFiles(folder.to_owned()),
        _ => Allowed::RemoveFiles(".".into()),
    };
    let sockets = control.into_iter().chain(ends).map(folder);
    let cgroups = domains.root().map(Allowed::WriteAndRemoveFolders);
    let devices = devices.folders().into_iter().map(Allowed::GiveBack);
    [figures].into_iter().chain(sockets).chain(cgroups).chain(devices).collect()
}
