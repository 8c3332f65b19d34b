//! `takt run`: from a partition file to a report.
//!
//! Everything that can fail is done before the first guest instruction: memory, machines, images,
//! threads with their reservations. Then all partitions start from one epoch, and from there on
//! nothing is allocated or mapped for a guest.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use kvm_ioctls::Kvm;
use rtrb::RingBuffer;
use takt_devices::output;
use takt_devices::ports::{Overlap, PortBus};
use takt_devices::power::{AcpiPower, KeyboardController, PowerLine};
use takt_devices::serial::{self, IrqLine, SerialPort};
use takt_scheduler::reservation::CpuReservations;
use takt_scheduler::table::{Cpu, PartitionId, Role};
use takt_scheduler::time::{Nanos, Timebase, Tsc, TscFrequency};
use thiserror::Error;
use vmm_sys_util::eventfd::{EFD_CLOEXEC, EFD_NONBLOCK, EventFd};

use crate::boot;
use crate::boot::acpi::{POWER_PORT, SERIAL_IRQ, SERIAL_PORT};
use crate::boot::linux::LinuxImageError;
use crate::boot::long_mode::{self, StartError};
use crate::boot::plc::PlcImageError;
use crate::config::{Kind, Partition, PartitionFile};
use crate::cpuset::{CpusetError, Domains};
use crate::init_watch::{InitSeen, InitWatch};
use crate::machine::{self, Machine, MachineError};
use crate::memory::{GuestMemory, MemoryError};
use crate::report::{self, Host, Report};
use crate::statistics;
use crate::supervisor::{Account, Console, Finished, Supervisor, SupervisorError, take_signals};
use crate::terminal::{self, Lines, Screen};
use crate::vcpu::guest::Guest;
use crate::vcpu::kicker;
use crate::vcpu::linux::LinuxGuest;
use crate::vcpu::plc::PlcGuest;
use crate::vcpu::thread::{self, Place, Ready, Running, ThreadError};
use crate::vcpu::windowed::{Plan, WindowRecord};
use crate::vcpu::{Control, background, kick, windowed};

/// From the moment that all threads are ready to the epoch: time for all of them to fall asleep.
const START_DELAY: Nanos = Nanos::from_millis(2);
/// Window records that the event thread may be behind.
const RECORDS: usize = 4096;

/// What the command line adds to the partition file.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// End by itself after this time.
    pub duration: Option<Duration>,
    /// Write the report here as JSON.
    pub report: Option<PathBuf>,
    /// How Takt was started, for the report.
    pub lane: String,
}

/// A run that did not take place, or could not tell of itself.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum RunError {
    #[error(transparent)]
    Machine(#[from] MachineError),
    #[error(transparent)]
    Memory(#[from] MemoryError),
    #[error("partition {partition}: {source}")]
    Plc { partition: String, source: PlcImageError },
    #[error("partition {partition}: {source}")]
    Linux { partition: String, source: LinuxImageError },
    #[error(transparent)]
    Start(#[from] StartError),
    #[error(transparent)]
    Cpuset(#[from] CpusetError),
    #[error(transparent)]
    Thread(#[from] ThreadError),
    #[error(transparent)]
    Supervisor(#[from] SupervisorError),
    #[error("two devices of the Linux machine collide: {0}")]
    Ports(#[from] Overlap),
    #[error("cannot lock memory: {0}; run as root, or raise the limit (ulimit -l unlimited)")]
    Lock(io::Error),
    #[error("cannot {what}: {source}")]
    Host { what: &'static str, source: io::Error },
    #[error("cannot write the report to {}: {source}", path.display())]
    Report { path: PathBuf, source: io::Error },
}

impl RunError {
    /// True if it is a file of the user's that is at fault, not the host.
    #[must_use]
    pub const fn is_users(&self) -> bool {
        matches!(self, RunError::Plc { .. } | RunError::Linux { .. })
    }
}

/// A partition that is ready to run.
struct Prepared {
    account: Account,
    thread: Ready<()>,
    init: Option<InitSeen>,
}

/// How a vCPU thread tells of its end.
struct Ending {
    partition: PartitionId,
    sender: Sender<(PartitionId, Finished)>,
    bell: EventFd,
}

impl Ending {
    fn tell(self, finished: Finished) {
        // The event thread takes part until all threads are joined.
        let _ = self.sender.send((self.partition, finished));
        let _ = self.bell.write(1);
    }
}

/// What all partitions have in common while they are prepared.
struct Preparation<'a> {
    file: &'a PartitionFile,
    kvm: Kvm,
    domains: &'a Domains,
    sender: Sender<(PartitionId, Finished)>,
    bell: EventFd,
    /// Set when the run is over: nobody takes console output any more.
    closing: Arc<AtomicBool>,
    /// The first machine's, for all: a kernel refines its figure for some time after it has booted.
    frequency: Option<TscFrequency>,
    console: Option<Console>,
}

/// Runs all partitions of `file` until the run is over.
///
/// # Errors
/// See [`RunError`]. A partition that fails is not an error of the run: the report tells of it.
pub fn run(file: &PartitionFile, options: &Options) -> Result<Report, RunError> {
    let signals = take_signals()?;
    lock_memory()?;
    kick::install()
        .map_err(|e| io::Error::from_raw_os_error(e.errno()))
        .map_err(|source| RunError::Host { what: "install the kick's signal handler", source })?;
    // Dropped after all threads have been let go.
    let domains = Domains::set_up(file.table())?;
    let (sender, endings) = channel();
    let bell = eventfd()?;
    let mut preparation = Preparation {
        file,
        kvm: machine::open_kvm()?,
        domains: &domains,
        sender,
        bell: clone(&bell)?,
        closing: Arc::default(),
        frequency: None,
        console: None,
    };
    let mut prepared = Vec::new();
    for partition in file.partitions() {
        prepared.push(preparation.partition(partition)?);
    }
    let kickers = preparation.kickers(&prepared)?;
    let Some(frequency) = preparation.frequency else {
        return Err(MachineError::Missing("a machine to run").into());
    };

    let raw = terminal::make_raw()
        .map_err(|source| RunError::Host { what: "put the terminal into raw mode", source })?;
    let run = Run { file, options, frequency, closing: preparation.closing.clone() };
    let screen = Screen::new(io::stdout(), raw);
    let result = run.start(prepared, kickers, preparation.console, screen, signals, bell, endings);
    terminal::restore();
    let report = result?;
    if let Some(path) = &options.report {
        write_report(&report, path)?;
    }
    Ok(report)
}

impl Preparation<'_> {
    fn partition(&mut self, partition: &Partition) -> Result<Prepared, RunError> {
        match partition.kind() {
            Kind::Plc { image } => self.plc(partition, image.as_deref()),
            Kind::Linux { kernel, initrd, cmdline } => {
                self.linux(partition, kernel, initrd.as_deref(), cmdline)
            }
        }
    }

    fn plc(&mut self, partition: &Partition, image: Option<&Path>) -> Result<Prepared, RunError> {
        let bytes = partition.memory_bytes();
        let memory = GuestMemory::for_plc(bytes)?;
        let entry = boot::plc::load(&memory, bytes, image)
            .map_err(|source| RunError::Plc { partition: partition.name().to_owned(), source })?;
        let machine = machine::for_plc(&self.kvm, &memory)?;
        long_mode::start(&machine.vcpu, memory.regions(), entry)?;
        let (console, output) = output::dropping();
        let frame = self.file.table().frame();
        let tsc = *self.frequency.get_or_insert(machine.tsc);
        let guest = PlcGuest::new(&memory, bytes, tsc.khz(), frame, console)
            .ok_or(MachineError::Missing("the PLC guest's pages"))?;
        self.spawn(partition, machine, memory, guest, output, None)
    }

    fn linux(
        &mut self,
        partition: &Partition,
        kernel: &Path,
        initrd: Option<&Path>,
        cmdline: &str,
    ) -> Result<Prepared, RunError> {
        let memory = GuestMemory::for_linux(partition.memory_bytes())?;
        let entry = boot::linux::load(&memory, kernel, initrd, cmdline)
            .map_err(|source| RunError::Linux { partition: partition.name().to_owned(), source })?;
        let machine = machine::for_linux(&self.kvm, &memory)?;
        long_mode::start(&machine.vcpu, memory.regions(), entry)?;

        let irq = eventfd()?;
        machine.vm.register_irqfd(&irq, SERIAL_IRQ).map_err(|source| MachineError::Call {
            what: "attach the serial port's interrupt",
            source,
        })?;
        let (writer, output) = output::waiting(self.closing.clone());
        let init = InitSeen::default();
        let console = SerialPort::new(IrqLine(irq), InitWatch::new(writer, init.clone()));
        let power = PowerLine::default();
        let mut ports = PortBus::default();
        let last = SERIAL_PORT + serial::PORTS - 1;
        ports.attach(SERIAL_PORT..=last, Box::new(console.clone()))?;
        ports.attach(POWER_PORT..=POWER_PORT + 2, Box::new(AcpiPower(power.clone())))?;
        ports.attach(0x60..=0x64, Box::new(KeyboardController::new(power.clone())))?;
        self.console = Some(console);
        let guest = LinuxGuest::new(ports, power);
        self.spawn(partition, machine, memory, guest, output, Some(init))
    }

    /// Makes the thread of a partition: in its windows, or in the background.
    fn spawn(
        &mut self,
        partition: &Partition,
        machine: Machine,
        memory: GuestMemory,
        mut guest: impl Guest + Send + 'static,
        output: output::OutputEnd,
        init: Option<InitSeen>,
    ) -> Result<Prepared, RunError> {
        let Machine { vcpu, vm, tsc } = machine;
        let tsc = *self.frequency.get_or_insert(tsc);
        let (id, cpu, name) = (partition.id(), partition.cpu(), partition.name().to_owned());
        let control: Arc<Control> = Arc::default();
        let ending =
            Ending { partition: id, sender: self.sender.clone(), bell: clone(&self.bell)? };
        let own = control.clone();
        let table = self.file.table();
        let says_done = guest.says_done();
        let (thread, records) = match (table.placements()[id.0].role, table.releases_of(id)) {
            (Role::Windowed { guard }, Some(releases)) => {
                let reservations = CpuReservations::of(table, cpu).partitions;
                let reservation = reservations.iter().find(|(p, _)| *p == id).map(|(_, r)| *r);
                let (mut producer, consumer) = RingBuffer::<WindowRecord>::new(RECORDS);
                let place = Place { cpu, domain: self.domains.entry(cpu), reservation };
                let body = move |kickable: &mut kick::Kickable, base: Timebase| {
                    // The machine's memory and descriptor live as long as its processor.
                    let _machine = (memory, vm);
                    let plan = Plan { releases, base, guard: base.frequency.ticks(guard) };
                    let (end, unrecorded) =
                        windowed::run(kickable, &mut guest, &own, &plan, &mut producer);
                    let illegal_accesses = guest.illegal_accesses();
                    let cpu_time = thread::cpu_time();
                    ending.tell(Finished { end, cpu_time, illegal_accesses, unrecorded });
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, body)?, Some(consumer))
            }
            _ => {
                let place = Place { cpu, domain: self.domains.entry(cpu), reservation: None };
                let body = move |kickable: &mut kick::Kickable, _: Timebase| {
                    let _machine = (memory, vm);
                    let end = background::run(kickable, &mut guest, &own);
                    let illegal_accesses = guest.illegal_accesses();
                    let cpu_time = thread::cpu_time();
                    ending.tell(Finished { end, cpu_time, illegal_accesses, unrecorded: 0 });
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, body)?, None)
            }
        };
        let releases =
            (records.is_some() && says_done).then(|| statistics::Releases::new(tsc)).flatten();
        let account = Account {
            name,
            control,
            output,
            is_terminal: init.is_some(),
            records,
            releases,
            finished: None,
            lines: Lines::default(),
        };
        Ok(Prepared { account, thread, init })
    }

    /// One thread per CPU with windows, to end them.
    fn kickers(&self, prepared: &[Prepared]) -> Result<Vec<Kicker>, RunError> {
        let table = self.file.table();
        let mut kickers = Vec::new();
        for cpu in table.cpus() {
            let Some(releases) = table.releases_on(cpu) else { continue };
            let owner = |p: PartitionId| prepared[p.0].account.control.clone();
            let owners = table.windows_on(cpu).map(|w| owner(w.partition)).collect();
            let windows = kicker::Windows { releases, owners };
            let control: Arc<Control> = Arc::default();
            let own = control.clone();
            let reservation = CpuReservations::of(table, cpu).kicker;
            let place = Place { cpu, domain: self.domains.entry(cpu), reservation };
            let body = move |base: Timebase| kicker::run(&windows, &base, &own);
            let Cpu(number) = cpu;
            let thread = thread::plain(&format!("kicker-{number}"), place, control.clone(), body)?;
            kickers.push(Kicker { control, thread });
        }
        Ok(kickers)
    }
}

struct Kicker {
    control: Arc<Control>,
    thread: Ready<()>,
}

/// A run, from its start to its report.
struct Run<'a> {
    file: &'a PartitionFile,
    options: &'a Options,
    frequency: TscFrequency,
    closing: Arc<AtomicBool>,
}

impl Run<'_> {
    #[expect(clippy::too_many_arguments, reason = "it takes over all that was prepared")]
    fn start(
        &self,
        prepared: Vec<Prepared>,
        kickers: Vec<Kicker>,
        console: Option<Console>,
        screen: Screen<io::Stdout>,
        signals: fs::File,
        bell: EventFd,
        endings: Receiver<(PartitionId, Finished)>,
    ) -> Result<Report, RunError> {
        let (mut accounts, mut threads, mut inits) = (Vec::new(), Vec::new(), Vec::new());
        for Prepared { account, thread, init } in prepared {
            accounts.push(account);
            threads.push(thread);
            inits.push(init);
        }
        let mut supervisor = Supervisor::new(accounts, screen, console, signals, bell, endings)?;
        let names: Vec<&str> = self.file.partitions().iter().map(Partition::name).collect();
        supervisor.screen.line(
            "takt",
            &format!("{}: starting {}; Ctrl-] q ends the run", self.file.name(), names.join(", ")),
        );

        let epoch = Tsc::now().after(self.frequency.ticks(START_DELAY));
        let base = Timebase { epoch, frequency: self.frequency };
        let start = |thread: Ready<()>| thread.start(base);
        let mut running: Vec<Running<()>> = threads.into_iter().map(start).collect();
        let mut controls: Vec<Arc<Control>> =
            supervisor.accounts.iter().map(|a| a.control.clone()).collect();
        for Kicker { control, thread } in kickers {
            controls.push(control);
            running.push(thread.start(base));
        }

        let supervised = supervisor.supervise(self.options.duration);
        let duration = self.frequency.nanos(Tsc::now().since(epoch));
        self.closing.store(true, Ordering::Relaxed);
        for control in &controls {
            control.stop();
        }
        for thread in running {
            thread.join();
        }
        let mut supervisor = supervised?;
        supervisor.note_endings();
        supervisor.drain();
        Ok(self.report(&supervisor, &inits, base, duration))
    }

    fn report(
        &self,
        supervisor: &Supervisor,
        inits: &[Option<InitSeen>],
        base: Timebase,
        duration: Nanos,
    ) -> Report {
        let describe = |((account, init), partition): ((&Account, _), &Partition)| {
            describe(account, init, partition, base, duration)
        };
        let accounts = supervisor.accounts.iter().zip(inits).zip(self.file.partitions());
        Report {
            schema_version: report::SCHEMA_VERSION,
            lane: self.options.lane.clone(),
            host: Host::current(self.frequency.khz()),
            system: self.file.name().to_owned(),
            duration_ns: duration.0,
            partitions: accounts.map(describe).collect(),
        }
    }
}

fn describe(
    account: &Account,
    init: &Option<InitSeen>,
    partition: &Partition,
    base: Timebase,
    duration: Nanos,
) -> report::Partition {
    let finished = account.finished;
    let releases = account.releases.as_ref().map(|r| report::Releases {
        releases: r.happened,
        start_up_windows: r.start_up,
        lost: r.lost,
        late_releases: r.late,
        overruns: r.overruns,
        unrecorded: finished.map_or(0, |f| f.unrecorded),
        release_latency_ns: r.latency.summary(),
        execution_ns: r.execution.summary(),
        wake_up_latency_ns: r.wake_up.summary(),
    });
    report::Partition {
        name: account.name.clone(),
        kind: match partition.kind() {
            Kind::Plc { .. } => "plc",
            Kind::Linux { .. } => "linux",
        },
        end: finished.map_or("its thread died".to_owned(), |f| f.end.to_string()),
        failed: finished.is_none_or(|f| f.end.is_failure()),
        cpu_share: finished.map_or(0.0, |f| f.cpu_time.0 as f64 / duration.0.max(1) as f64),
        illegal_accesses: finished.map_or(0, |f| f.illegal_accesses),
        console_dropped: account.output.dropped(),
        releases,
        boot_to_init_ns: init.as_ref().map(|i| i.instant().map(|at| base.offset(at).0)),
    }
}

/// Locks all memory, now and later: no page of a guest or of Takt is ever missing.
fn lock_memory() -> Result<(), RunError> {
    // SAFETY: changes how the process's memory is kept, not what is in it.
    let result = unsafe { libc::mlockall(libc::MCL_CURRENT | libc::MCL_FUTURE) };
    if result == 0 { Ok(()) } else { Err(RunError::Lock(io::Error::last_os_error())) }
}

fn write_report(report: &Report, path: &PathBuf) -> Result<(), RunError> {
    let failed = |source| RunError::Report { path: path.clone(), source };
    let mut json = serde_json::to_string_pretty(report).map_err(|e| failed(e.into()))?;
    json.push('\n');
    fs::write(path, json).map_err(failed)
}

fn eventfd() -> Result<EventFd, RunError> {
    EventFd::new(EFD_NONBLOCK | EFD_CLOEXEC)
        .map_err(|source| RunError::Host { what: "make an event descriptor", source })
}

fn clone(fd: &EventFd) -> Result<EventFd, RunError> {
    fd.try_clone().map_err(|source| RunError::Host { what: "copy an event descriptor", source })
}
