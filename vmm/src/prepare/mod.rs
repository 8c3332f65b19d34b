//! Preparing partitions: everything that can fail, before anything runs.
//!
//! A partition that is prepared has its memory, its machine, its image in place, and a thread that
//! is pinned, has its reservation and waits for the epoch.

mod crew;
mod linux;
mod plc;
mod spawn;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use kvm_ioctls::Kvm;
use takt_scheduler::reservation::CpuReservations;
use takt_scheduler::sleep::Steering;
use takt_scheduler::switch::ScheduleState;
use takt_scheduler::table::{Cpu, PartitionId};
use takt_scheduler::time::{Timebase, TscFrequency};
use vmm_sys_util::eventfd::EventFd;

use crate::account::Account;
use crate::appliance::Role;
use crate::channels::Channels;
use crate::config::{Kind, Partition, PartitionFile};
use crate::console_log::ConsoleLog;
use crate::cpuset::Domains;
use crate::disk::DiskThread;
use crate::event;
use crate::health::bus_locks;
use crate::hooks::Hooks;
use crate::init_watch::{Console, InitSeen};
use crate::interrupts::Interrupts;
use crate::memory::Pages;
use crate::net::Cable;
use crate::passthrough::Devices;
use crate::report;
use crate::resctrl::Groups;
use crate::run_error::RunError;
use crate::sandbox::{self, Mode};
use crate::saver::Files;
use crate::vcpu::guest_timer::Deadlines;
use crate::vcpu::thread::{self, Place, Ready, Spawn};
use crate::vcpu::{Control, window_enforcer};
use crate::vhost::Closer;
use crate::vsock::Vsock;

/// A partition that is ready to run.
pub struct Prepared {
    /// What the supervisor thread keeps of it.
    pub account: Account,
    /// Its thread.
    pub thread: Ready<()>,
    /// Those of further processors.
    pub further: Vec<Ready<()>>,
    /// What the report asks of a Linux.
    pub linux: Option<LinuxParts>,
    /// Those that serve its disks.
    pub disks: Vec<DiskThread>,
}

/// What is kept of a Linux beside its account.
pub struct LinuxParts {
    /// When its first process was seen.
    pub init: InitSeen,
    /// The host's side of its network interfaces.
    pub cables: Vec<Cable>,
    /// What has gone through them until they were closed.
    pub nets: Vec<report::Net>,
    /// That of its sockets.
    pub vsock: Option<Vsock>,
    /// What closes both, if there are any.
    pub closer: Option<Closer>,
}

impl LinuxParts {
    /// Closes the devices that the host's kernel works on. A tap device that Takt has made is gone then, and its counts with it.
    pub fn close_devices(&mut self) {
        self.nets = self.cables.iter().map(Cable::report).collect();
        if let Some(closer) = &mut self.closer {
            closer.close();
        }
    }

    /// Whether a device that the host's kernel works on was still open when the end of the run went on.
    #[must_use]
    pub fn is_held_up(&self) -> bool {
        self.closer.as_ref().is_some_and(Closer::is_held_up)
    }
}

/// A thread that ends windows, ready to run.
pub struct WindowEnforcer {
    /// Whose windows it ends.
    pub cpu: Cpu,
    /// For stopping it.
    pub control: Arc<Control>,
    /// The thread.
    pub thread: Ready<()>,
}

/// What all partitions have in common while they are prepared.
pub struct Preparation<'a> {
    /// What to prepare.
    pub file: &'a PartitionFile,
    /// KVM.
    pub kvm: Kvm,
    /// The memory between partitions.
    pub channels: &'a Channels<'a>,
    /// What partitions get of the host's devices.
    pub devices: &'a Devices,
    /// Of which pages the memory of each partition is, in their order.
    pub pages: &'a [Pages],
    /// What programs have retained over a stop of Takt.
    pub retained: &'a Files,
    /// Shares of the cache and of the way to memory.
    pub groups: &'a Groups,
    /// CPUs that got a scheduling domain of their own.
    pub domains: &'a Domains,
    /// What threads ring when they have told of their ends.
    pub bell: EventFd,
    /// Set when the run is over: console output is not taken any more.
    pub closing: Arc<AtomicBool>,
    /// Which schedule holds.
    pub board: Arc<ScheduleState>,
    /// The first machine's, for all: a kernel refines its figure for some time after it has booted.
    pub frequency: Option<TscFrequency>,
    /// How long it has taken to get and clear the guests' memory: in the appliance, huge pages are set aside for it
    /// first.
    pub clearing: Duration,
    /// The serial port of the Linux that has the terminal, once there is one.
    pub console: Option<Console>,
    /// What others know of each Linux.
    pub linuxes: BTreeMap<PartitionId, LinuxLinks>,
    /// What may interrupt PLC guests.
    pub interrupts: Interrupts,
    /// Whether the clock by which threads sleep may be steered.
    pub steering: Steering,
    /// What a test wants.
    pub hooks: &'a Hooks,
    /// Of the threads that end windows, which are made last.
    pub enforcers: BTreeMap<Cpu, Arc<Control>>,
    /// What follows from a system call that a thread may not make.
    pub mode: Mode,
    /// Whose modules are Takt's to load.
    pub role: Role,
    /// What starts threads that have no part in the schedule.
    pub spawner: Spawn<'a>,
}

/// What others know of a Linux, made before any partition is prepared.
pub struct LinuxLinks {
    /// What sources ring to wake it.
    pub doorbell: EventFd,
    /// The CPUs of its processors.
    pub cpus: Vec<Cpu>,
    /// The deadlines of each processor's timer; empty if there are windows of others on none of these CPUs.
    pub deadlines: Vec<Arc<Deadlines>>,
}

impl LinuxLinks {
    /// Of each Linux of a file.
    ///
    /// # Errors
    /// If the host has no event descriptor left.
    pub fn of(
        file: &PartitionFile,
        board: &Arc<ScheduleState>,
        hooks: &Hooks,
    ) -> Result<BTreeMap<PartitionId, Self>, RunError> {
        let is_linux = |p: &&Partition| matches!(p.kind(), Kind::Linux { .. });
        let links = |p: &Partition| -> Result<_, RunError> {
            let cpus = hooks.processors(p.cpus().collect());
            let quiet = |cpu: &Cpu| file.schedules().quiet_on(*cpu, Some(p.id()));
            let mut quiet: Vec<_> = cpus.iter().map(quiet).collect();
            // Who has the deadlines of one processor has those of all.
            if quiet.iter().all(Option::is_none) || !hooks.quiet() {
                quiet.clear();
            }
            let new = |quiet| Arc::new(Deadlines::new(quiet, board.clone()));
            let deadlines = quiet.into_iter().map(new).collect();
            Ok((p.id(), Self { doorbell: event::eventfd()?, cpus, deadlines }))
        };
        file.partitions().iter().filter(is_linux).map(links).collect()
    }
}

/// What a run needs of its preparation.
pub struct Finish {
    /// As in [`Preparation`].
    pub closing: Arc<AtomicBool>,
    /// As in [`Preparation`].
    pub console: Option<Console>,
    /// `None` if no PLC has any.
    pub interrupts: Option<Interrupts>,
    /// As in [`Preparation`].
    pub clearing: Duration,
}

impl Preparation<'_> {
    /// Prepares a partition.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn partition(&mut self, partition: &Partition) -> Result<Prepared, RunError> {
        if partition.hardware().bus_locks.is_some() && !bus_locks::are_told(&self.kvm) {
            return Err(RunError::BusLocks { partition: partition.name().to_owned() });
        }
        let mut prepared = match partition.kind() {
            Kind::Plc { image } => self.plc(partition, image.as_deref()),
            Kind::Linux { kernel, initrd, cmdline } => {
                self.linux(partition, kernel, initrd.as_deref(), cmdline)
            }
        }?;
        prepared.account.log = self.console_log(partition)?;
        Ok(prepared)
    }

    /// The file that keeps what a partition writes to its console.
    fn console_log(&self, partition: &Partition) -> Result<Option<ConsoleLog>, RunError> {
        let Some(path) = partition.console_log() else { return Ok(None) };
        // The appliance has no disk: what is kept there is carried out of it.
        let carried = self.role.results().map(|out| out.join(partition.console_record()));
        let log = ConsoleLog::start(carried.as_deref().unwrap_or(path), self.mode);
        let name = partition.name().to_owned();
        log.map(Some).map_err(|source| RunError::ConsoleLog { partition: name, source })
    }

    /// Of which pages a partition's memory is.
    fn pages_of(&self, partition: &Partition) -> Pages {
        self.pages.get(partition.id().0).copied().unwrap_or_default()
    }

    /// Makes a guest's memory, most of which is to clear it, and takes the time.
    fn clear<T>(&mut self, make: impl FnOnce() -> T) -> T {
        let before = Instant::now();
        let memory = make();
        self.clearing += before.elapsed();
        memory
    }

    /// What is needed beyond the preparation. The rest is closed: the way to make machines, for one.
    #[must_use]
    pub fn finish(self) -> Finish {
        let Self { closing, console, interrupts, clearing, .. } = self;
        let interrupts = Some(interrupts).filter(|interrupts| !interrupts.is_empty());
        Finish { closing, console, interrupts, clearing }
    }

    /// The deadlines of those processors of Linuxes, by their partitions and CPUs.
    fn deadlines_of(&self, which: impl Fn(PartitionId, Cpu) -> bool) -> Box<[Arc<Deadlines>]> {
        let mut all = Vec::new();
        for (id, LinuxLinks { cpus, deadlines, .. }) in &self.linuxes {
            let own = cpus.iter().zip(deadlines).filter(|(cpu, _)| which(*id, **cpu));
            all.extend(own.map(|(_, deadlines)| deadlines.clone()));
        }
        all.into()
    }

    /// What ends, or will end, the windows of a CPU.
    fn enforcer(&mut self, cpu: Cpu) -> Arc<Control> {
        self.enforcers.entry(cpu).or_default().clone()
    }

    /// One thread per CPU with windows, to end them.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn window_enforcers(
        &mut self,
        prepared: &[Prepared],
    ) -> Result<Vec<WindowEnforcer>, RunError> {
        let schedules = self.file.schedules();
        let mut enforcers = Vec::new();
        for cpu in schedules.cpus() {
            let Some(timetable) = schedules.timetable_on(cpu) else { continue };
            let owner = |p: PartitionId| prepared[p.0].account.control.clone();
            let owners = schedules.tables().iter();
            let owners =
                owners.map(|t| t.windows_on(cpu).map(|w| owner(w.partition)).collect()).collect();
            let windows = window_enforcer::Windows {
                timetable,
                owners,
                must_end_in_time: schedules.must_end_in_time_on(cpu),
                board: self.board.clone(),
                quiet: schedules.quiet_on(cpu, None),
                steering: self.steering,
                deadlines: self.deadlines_of(|_, _| true),
            };
            let control = self.enforcer(cpu);
            let own = control.clone();
            let reservation = CpuReservations::of(schedules, cpu);
            let reservation = reservation.by_a_clock_whose_steering_is(self.steering).kicker;
            let domain = self.domains.entry(cpu);
            let doors = (sandbox::Kind::WindowEnforcer, self.mode);
            let place = Place { cpu, domain, group: None, reservation, ports: Vec::new(), doors };
            let body = move |base: Timebase| window_enforcer::run(&windows, &base, &own);
            let Cpu(number) = cpu;
            let thread = thread::plain(&format!("kicker-{number}"), place, control.clone(), body)?;
            enforcers.push(WindowEnforcer { cpu, control, thread });
        }
        Ok(enforcers)
    }
}
