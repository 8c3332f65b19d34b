//! `takt run`: from a partition file to a report.
//!
//! Everything that can fail is done before the first guest instruction: memory, machines, images,
//! threads with their reservations. Then all partitions start from one epoch, and from there on
//! nothing is allocated or mapped for a guest.

mod epoch;
mod options;
mod output;
mod own_process;
mod result;
mod start;
mod this_host;

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use takt_scheduler::switch::ScheduleState;
use takt_scheduler::table::Cpu;
use takt_scheduler::time::{Nanos, Tsc, TscFrequency};

pub use options::{Options, duration};
use output::Output;
use start::Started;

use crate::account::Account;
use crate::appliance::expedited_rcu::ExpeditedRcu;
use crate::channels::Channels;
use crate::config::{Channel, HostPort, PartitionFile, Program, live_channels};
use crate::control::{Door, Operators};
use crate::cpuset::Domains;
use crate::event::{self, eventfd};
use crate::footprint;
use crate::hooks::Steps;
use crate::host_ports::HostPorts;
use crate::huge_pages;
use crate::interrupts::Interrupts;
use crate::live::Live;
use crate::machine::{self, MachineError};
use crate::memory::Pages;
use crate::outlet::Trace;
use crate::outlet::{Outlet, StandardOutput};
use crate::passthrough::{Devices, emergency_stop};
use crate::prepare::{Finish, LinuxLinks, Preparation};
use crate::report::{self, Host, Report};
use crate::resctrl::Groups;
use crate::run_error::RunError;
use crate::samples::{self, Samples};
use crate::sandbox::{self, Allowed};
use crate::saver::Files;
use crate::screen::{self, Screen};
use crate::steering;
use crate::supervisor::{Sources, Supervisor, take_signals};
use crate::terminal;
use crate::vcpu::{Control, kick, thread};

/// Runs all partitions of `file` until the run is over.
///
/// # Errors
/// See [`RunError`]. A partition that fails is not an error of the run: the report tells of it.
pub fn run(file: &PartitionFile, options: &Options) -> Result<Report, RunError> {
    let steps = options.hooks.steps();
    sandbox::prepare(|| {
        let written = emergency_stop::do_it();
        terminal::restore();
        written
    })?;
    let signals = take_signals()?;
    own_process::stay_alive();
    own_process::lock_memory()?;
    steps.pass()?;
    kick::install()
        .map_err(|e| io::Error::from_raw_os_error(e.errno()))
        .map_err(|source| RunError::Host { what: "install the kick's signal handler", source })?;
    let control = options
        .control
        .as_deref()
        .or(file.control())
        .map(|path| Door::open(path, file.viewers().filter(|_| !options.role.owns_machine())))
        .transpose()?;
    steps.pass()?;
    // Given back after all threads have been let go.
    let devices = Devices::take(file, options.role)?;
    steps.pass()?;
    // While there is no guest and no thread that it would be a copy of. Dropped after all threads
    // have written their values.
    let _guardian = devices.guardian(options.seccomp)?;
    steps.pass()?;
    let queues: Vec<Channel> =
        file.partitions().iter().filter_map(live_channels).flatten().collect();
    let channels = Channels::new(file.channels())?.with_live(&queues)?;
    let mut retained = Files::open(file)?;
    let keeps = |program: &Program| program.place.retained_bytes > 0;
    let retains = file.partitions().iter().any(|p| p.programs().iter().any(keeps));
    let mut operators = (control.is_some() || retains)
        .then(|| Operators::new(control, file, &channels))
        .transpose()?;
    steps.pass()?;
    let expedited = ExpeditedRcu::begin(options.role);
    // Dropped after all threads have been let go.
    let domains = Domains::set_up(file.schedules())?;
    steps.pass()?;
    // Dropped after all threads have been let go.
    let groups = Groups::set_up(file.partitions())?;
    steps.pass()?;
    let before = Instant::now();
    let pages = huge_pages::choose(file.partitions(), options.role)?;
    let choosing = before.elapsed();
    let bell = eventfd()?;
    let schedules = file.schedules();
    let spawn = |name: &str, kind, work: Box<dyn FnOnce() + Send>| {
        thread::detached(name, (kind, options.seccomp), work)
    };
    let saver = retained.start(&spawn)?;
    let board = Arc::new(ScheduleState::new(schedules.frame(), schedules.tables().len()));
    let mut preparation = Preparation {
        file,
        kvm: machine::open_kvm()?,
        channels: &channels,
        devices: &devices,
        pages: &pages,
        retained: &retained,
        domains: &domains,
        groups: &groups,
        bell: event::clone(&bell)?,
        closing: Arc::default(),
        board: board.clone(),
        frequency: None,
        clearing: choosing,
        console: None,
        interrupts: Interrupts::new()?,
        steering: steering::look(),
        hooks: &options.hooks,
        linuxes: LinuxLinks::of(file, &board, &options.hooks)?,
        enforcers: BTreeMap::new(),
        mode: options.seccomp,
        role: options.role,
        spawner: &spawn,
    };
    let mut prepared = Vec::new();
    for partition in file.partitions() {
        prepared.push(preparation.partition(partition)?);
        steps.pass()?;
    }
    let kickers =
        if options.hooks.kicks() { preparation.window_enforcers(&prepared)? } else { Vec::new() };
    steps.pass()?;
    let Some(frequency) = preparation.frequency else {
        return Err(MachineError::Missing("a machine to run").into());
    };

    if let Some(operators) = &mut operators {
        operators.attach(Live::open(file, &channels, &retained, saver)?);
    }
    let host_ports = HostPorts::open(&channels, frequency, options.role.results(), &spawn)?;
    steps.pass()?;
    let output = |what, path: &Option<PathBuf>| {
        path.as_deref().map(|path| Output::create(what, path)).transpose()
    };
    let report_file = output("report", &options.report)?;
    let samples_file = output("samples", &options.samples)?;
    let create = |path: &PathBuf| create_trace(path, options.seccomp);
    let trace_outlet = options.trace.as_ref().map(create).transpose()?.map(Arc::new);
    let quotas = screen::quotas(file.partitions().len());
    let output = StandardOutput::new();
    let console_outlet =
        Outlet::start("console", options.seccomp, &quotas, output).map(Arc::new)?;
    let sources = Sources::new(signals, bell)?;
    steps.pass()?;
    let raw = terminal::make_raw()
        .map_err(|source| RunError::Host { what: "put the terminal into raw mode", source })?;
    let Finish { closing, board, console, interrupts, clearing } = preparation.finish();
    let given_back = given_back(file, options, &devices, &domains, &groups);
    let host = this_host::look(frequency.khz());
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
        trace_outlet,
        trace_dropped: 0,
        console_outlet: console_outlet.clone(),
        patience: Patience::LONG,
        given_back,
        pages,
        host,
        enforcers: Vec::new(),
        steps,
    };
    let screen = Screen::new(console_outlet, raw, file.partitions().len());
    let controls: Vec<Arc<Control>> = prepared.iter().map(|p| p.account.control.clone()).collect();
    let guard = devices.guard(&controls);
    options.hooks.start_panicking(options.seccomp)?;
    drop(expedited);
    let result = run
        .start(prepared, kickers, console, screen, sources)
        .and_then(|started| run.last(started));
    drop(guard);
    terminal::restore();
    let report = result.inspect_err(|_| run.settle())?;
    if let Some(file) = report_file {
        file.write(serde_json::to_string_pretty(&report))?;
    }
    // If what came before it was not read, the table would not be read either.
    if report.output.unread_bytes == 0 {
        let table = format!("\n{}", report.table());
        // Finds room: all before it has been written.
        let _ = run.console_outlet.push(screen::OWN, table.as_bytes());
        run.settle();
    }
    Ok(report)
}

/// How long the end of a run waits for what it has to say.
#[derive(Clone, Copy)]
struct Patience {
    /// For a reader that takes nothing at all.
    stalled: Duration,
    /// For one that takes a little again and again.
    slow: Duration,
}

impl Patience {
    /// Somebody has sent a signal, and kills what does not end.
    const SHORT: Self =
        Self { stalled: Duration::from_millis(20), slow: Duration::from_millis(30) };
    const LONG: Self = Self { stalled: Duration::from_secs(1), slow: Duration::from_secs(5) };
}

/// A run, from its start to its report.
struct Run<'a> {
    file: &'a PartitionFile,
    options: &'a Options,
    frequency: TscFrequency,
    /// How long it took to clear the guests' memory.
    clearing: Duration,
    closing: Arc<AtomicBool>,
    board: Arc<ScheduleState>,
    /// Until the supervisor has them.
    host_ports: Option<HostPorts>,
    /// Until the supervisor has it.
    operators: Option<Operators>,
    /// Until the supervisor has them.
    interrupts: Option<Interrupts>,
    /// Where samples go, until they do.
    samples_file: Option<Output>,
    /// Where the trace goes.
    trace_outlet: Option<Arc<Outlet>>,
    /// Events that it has not got.
    trace_dropped: u64,
    /// Where the screen is.
    console_outlet: Arc<Outlet>,
    patience: Patience,
    /// What of the file system is needed to the end.
    given_back: Vec<Allowed>,
    /// Of which pages the memory of each partition is, in their order.
    pages: Vec<Pages>,
    /// The machine, for the report.
    host: Host,
    /// What ends windows, once it does.
    enforcers: Vec<(Cpu, Arc<Control>)>,
    steps: Steps,
}

impl Run<'_> {
    /// Looks after the run until it is over.
    fn last(&mut self, started: Started) -> Result<Report, RunError> {
        let Started { supervisor, running, disks, controls, bells, linux, epoch, starting } =
            started;
        let base = epoch.base;
        let start = footprint::now();
        // The time that was asked for is that of the schedule.
        let supervised = supervisor.supervise(self.options.duration.map(|time| Nanos(nanos(time))));
        let process = report::Process { start, end: footprint::now(), starting };
        let duration = base.offset(Tsc::now());
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
        // All guests have left: from here on the watchdog is not fed.
        supervisor.watchdog = None;
        if supervisor.ended_by_signal {
            self.patience = Patience::SHORT;
        }
        supervisor.note_endings();
        supervisor.drain();
        let busy =
            disks.into_iter().filter_map(|disk| (!disk.join_within(DISK_PATIENCE)).then_some(()));
        if busy.count() > 0 {
            let text = "a disk still waits for its file, and is left to it";
            supervisor.screen.line("takt", text);
        }
        supervisor.serve_host_ports(HostPorts::finish);
        let most = if supervisor.ended_by_signal { SAVING_SHORT } else { SAVING };
        let saved = supervisor.operators.as_mut().map(|operators| operators.finish(duration, most));
        if let Some(Err(error)) = saved {
            let text = format!("not all retained values are written: {error}");
            supervisor.screen.line("takt", &text);
        }
        supervisor.tell_last_losses();
        self.trace_dropped = self.finish_trace(supervisor.trace.take())?;
        if let Some(file) = self.samples_file.take() {
            let accounts = &supervisor.accounts;
            let samples = Samples {
                schema_version: samples::SCHEMA_VERSION,
                partitions: accounts.iter().filter_map(Account::course).collect(),
                loads: accounts.iter().filter_map(|a| a.load_course(duration)).collect(),
            };
            file.write(serde_json::to_string(&samples))?;
        }
        let host_ports = supervisor.host_ports.as_mut().map_or_else(Vec::new, HostPorts::accounts);
        self.settle();
        Ok(self.report(&supervisor, &linux, &epoch, duration, host_ports, process))
    }

    /// Waits for the reader of Takt's own output, if there is one.
    fn settle(&self) {
        self.console_outlet.settle(self.patience.stalled, self.patience.slow);
    }

    /// Ends the trace, if there is one; returns how many events its file has not got.
    fn finish_trace(&self, trace: Option<Trace>) -> Result<u64, RunError> {
        let (Some(trace), Some(outlet), Some(path)) =
            (trace, &self.trace_outlet, &self.options.trace)
        else {
            return Ok(0);
        };
        let failed = |source| RunError::Output { what: "trace", path: path.clone(), source };
        let Patience { stalled, slow } = Patience::LONG;
        outlet.settle(stalled, slow);
        let dropped = trace.dropped();
        let ended = trace.finish();
        let settled = outlet.settle(stalled, slow);
        match outlet.take_error() {
            Some(error) => Err(failed(error)),
            None if !settled => Err(failed(io::ErrorKind::TimedOut.into())),
            None => ended.map_err(failed).map(|()| dropped),
        }
    }
}

/// How long the end of a run waits until what programs retain is written; who has sent a signal may wait less.
const SAVING: Duration = Duration::from_secs(5);
const SAVING_SHORT: Duration = Duration::from_secs(1);
/// How long the end of a run waits for each disk that is busy with its file.
const DISK_PATIENCE: Duration = Duration::from_millis(10);
/// Room for what waits for the trace's file: some seconds of a partition at 1000 windows a second.
const TRACE_BYTES: usize = 4 << 20;

/// The way to the trace's file; what it was is gone.
fn create_trace(path: &Path, mode: sandbox::Mode) -> Result<Outlet, RunError> {
    let file = fs::File::create(path).map_err(|source| RunError::Output {
        what: "trace",
        path: path.to_owned(),
        source,
    })?;
    Ok(Outlet::start("trace", mode, &[TRACE_BYTES], file)?)
}

fn nanos(time: Duration) -> u64 {
    u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
}

/// What is still to be changed in the file system at the end of the run.
fn given_back(
    file: &PartitionFile,
    options: &Options,
    devices: &Devices,
    domains: &Domains,
    groups: &Groups,
) -> Vec<Allowed> {
    let figures = Allowed::Read("/proc/self".into());
    let control = options.control.as_deref().or(file.control());
    let ends = file.channels().iter().filter_map(|channel| match &channel.host {
        Some(HostPort::Socket(path)) if options.role.results().is_none() => Some(path.as_path()),
        _ => None,
    });
    let folder = |socket: &Path| match socket.parent() {
        Some(folder) if folder != "" => Allowed::RemoveFiles(folder.to_owned()),
        _ => Allowed::RemoveFiles(".".into()),
    };
    let sockets = control.into_iter().chain(ends).map(folder);
    let cgroups = domains.root().into_iter().chain(groups.root());
    let cgroups = cgroups.map(Allowed::WriteAndRemoveFolders);
    let devices = devices.folders().into_iter().map(Allowed::GiveBack);
    [figures].into_iter().chain(sockets).chain(cgroups).chain(devices).collect()
}
