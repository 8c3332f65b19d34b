//! Preparing partitions: everything that can fail, before anything runs.
//!
//! A partition that is prepared has its memory, its machine, its image in place, and a thread that
//! is pinned, has its reservation and waits for the epoch.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, TryRecvError};
use std::time::{Duration, Instant};

use kvm_ioctls::{Kvm, VcpuFd};
use rtrb::{Consumer, RingBuffer};
use takt_abi::PortTable;
use takt_abi::memory::PORT_TABLE;
use takt_devices::output;
use takt_devices::serial::{IrqLine, SerialPort};
use takt_scheduler::reservation::CpuReservations;
use takt_scheduler::switch::SwitchBoard;
use takt_scheduler::table::{Cpu, PartitionId, Role};
use takt_scheduler::time::{Nanos, Timebase, Tsc, TscFrequency};
use vmm_sys_util::eventfd::{EFD_CLOEXEC, EFD_NONBLOCK, EventFd};

use crate::account::{Account, Finished};
use crate::board::{self, Board};
use crate::boot::StartMode;
use crate::boot::linux::Image;
use crate::boot::long_mode::{self, StartError};
use crate::boot::plc::PlcImage;
use crate::boot::touch::{TouchError, touch};
use crate::channels::Channels;
use crate::config::{Kind, Partition, PartitionFile, ScheduleChange};
use crate::control::Orders;
use crate::cpuset::Domains;
use crate::disk::{DiskThread, Drive};
use crate::doorbell;
use crate::gather::Gather;
use crate::health::{Reporter, Watch};
use crate::init_watch::{Console, InitSeen, InitWatch};
use crate::interrupts::{Interrupts, apic};
use crate::machine::{self, MachineError};
use crate::memory::GuestMemory;
use crate::passthrough::{Devices, Granted};
use crate::pci::Pci;
use crate::restart::{LinuxRestart, PlcRestart, Restart, Revival};
use crate::run_error::RunError;
use crate::sandbox::{self, Mode};
use crate::terminal::Lines;
use crate::vcpu::guest::{End, Guest};
use crate::vcpu::kick::Kickable;
use crate::vcpu::plc::PlcGuest;
use crate::vcpu::record::Record;
use crate::vcpu::thread::{self, Place, Ready};
use crate::vcpu::windowed::{Plan, Windowed};
use crate::vcpu::{Control, background, kicker};

/// Window records that the event thread may be behind.
const RECORDS: usize = 4096;

/// A partition that is ready to run.
pub struct Prepared {
    /// What the event thread keeps of it.
    pub account: Account,
    /// Its thread.
    pub thread: Ready<()>,
    /// For Linux.
    pub init: Option<InitSeen>,
    /// Those that serve its disks.
    pub disks: Vec<DiskThread>,
}

/// A thread that ends windows, ready to run.
pub struct Kicker {
    /// For stopping it.
    pub control: Arc<Control>,
    /// The thread.
    pub thread: Ready<()>,
}

/// How a vCPU thread tells of its end.
struct Ending {
    partition: PartitionId,
    sender: Sender<(PartitionId, Finished)>,
    bell: EventFd,
}

impl Ending {
    fn tell(&self, finished: Finished) {
        // The event thread takes part until all threads are joined.
        let _ = self.sender.send((self.partition, finished));
        let _ = self.bell.write(1);
    }
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
    /// CPUs that got a scheduling domain of their own.
    pub domains: &'a Domains,
    /// Where threads tell of their ends.
    pub sender: Sender<(PartitionId, Finished)>,
    /// What they ring then.
    pub bell: EventFd,
    /// Set when the run is over: nobody takes console output any more.
    pub closing: Arc<AtomicBool>,
    /// Which schedule holds.
    pub board: Arc<SwitchBoard>,
    /// The first machine's, for all: a kernel refines its figure for some time after it has booted.
    pub frequency: Option<TscFrequency>,
    /// How long it has taken to clear the guests' memory.
    pub clearing: Duration,
    /// The serial port of the Linux guest, once there is one.
    pub console: Option<Console>,
    /// What sources ring to wake the Linux guest.
    pub doorbell: EventFd,
    /// What may interrupt PLC guests.
    pub interrupts: Interrupts,
    /// For tests: the release whose wake-ups come late.
    pub late_wake_up: Option<u64>,
    /// What follows from a system call that a thread may not make.
    pub mode: Mode,
}

/// What a run needs of its preparation.
pub struct Finish {
    /// As in [`Preparation`].
    pub closing: Arc<AtomicBool>,
    /// As in [`Preparation`].
    pub board: Arc<SwitchBoard>,
    /// As in [`Preparation`].
    pub console: Option<Console>,
    /// `None` if no PLC has any.
    pub interrupts: Option<Interrupts>,
    /// As in [`Preparation`].
    pub clearing: Duration,
}

/// A virtual processor, and what its thread has to do for it before it is ready.
struct Processor<R> {
    vcpu: VcpuFd,
    ready: R,
}

/// What a guest's thread keeps for as long as the guest exists.
struct Body {
    /// The memory lives as long as the processor.
    _memory: GuestMemory,
    own: Arc<Control>,
    health: Reporter,
    ending: Ending,
}

impl Preparation<'_> {
    /// Prepares a partition.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn partition(&mut self, partition: &Partition) -> Result<Prepared, RunError> {
        match partition.kind() {
            Kind::Plc { image } => self.plc(partition, image.as_deref()),
            Kind::Linux { kernel, initrd, cmdline } => {
                self.linux(partition, kernel, initrd.as_deref(), cmdline)
            }
        }
    }

    fn plc(&mut self, partition: &Partition, image: Option<&Path>) -> Result<Prepared, RunError> {
        let unfit = |source| RunError::Plc { partition: partition.name().to_owned(), source };
        let bytes = partition.memory_bytes();
        let image = PlcImage::read(image, bytes).map_err(unfit)?;
        let ports = self.channels.of(partition.id(), partition.kind());
        let memory = self.clear(|| GuestMemory::for_plc(bytes, &ports.views))?;
        let devices = self.devices.of(partition.id()).cloned();
        let interrupts = devices.as_ref().is_some_and(Granted::interrupts);
        let machine = machine::for_plc(&self.kvm, &memory, interrupts)?;
        if let Some(devices) = &devices {
            devices.map_into(&machine.vm)?;
        }
        let entry = image.load(&memory).map_err(unfit)?;
        let mut table = memory
            .port_table(PORT_TABLE)
            .ok_or(MachineError::Missing("the PLC guest's port table"))?;
        let tsc = *self.frequency.get_or_insert(machine.tsc);
        table.write(PortTable { tsc_khz: tsc.khz().into(), ..ports.table });
        for region in &ports.own {
            region.format(&memory)?;
        }
        doorbell::attach_sources(&machine.vm, &ports.table, &self.doorbell)?;
        long_mode::write_tables(memory.regions()).map_err(StartError::from)?;
        let lines = devices.as_ref().map_or(&[][..], |devices| &devices.lines);
        self.interrupts.attach(partition.name(), machine.vm, lines)?;
        let space = devices.as_ref().and_then(|devices| devices.space.clone());
        if let Some(space) = &space {
            space.start(&memory)?;
        }
        let (console, output) = output::dropping();
        let frame = self.file.schedules().frame();
        let guest = PlcGuest::new(&memory, bytes, tsc.khz(), frame, console)
            .ok_or(MachineError::Missing("the PLC guest's pages"))?
            .with_devices(devices);
        let (restart, revivals) = PlcRestart::new(memory.clone(), image, ports.own, space);
        let touched = memory.clone();
        let ready = move |vcpu: &mut VcpuFd| -> Result<(), TouchError> {
            touch(vcpu, &touched)?;
            long_mode::set_registers(vcpu, entry)?;
            if interrupts {
                apic::reset(vcpu).map_err(StartError::from)?;
            }
            Ok(())
        };
        let processor = Processor { vcpu: machine.vcpu, ready };
        let mut prepared = self.spawn(partition, processor, memory, guest, output, revivals)?;
        prepared.account.restart = Some(Restart::Plc(restart));
        Ok(prepared)
    }

    fn linux(
        &mut self,
        partition: &Partition,
        kernel: &Path,
        initrd: Option<&Path>,
        cmdline: &str,
    ) -> Result<Prepared, RunError> {
        let unfit = |source| RunError::Linux { partition: partition.name().to_owned(), source };
        let pci = Pci::new(self.channels.of(partition.id(), partition.kind()))?;
        let views = pci.as_ref().map(Pci::views).unwrap_or_default();
        let memory = self.clear(|| GuestMemory::for_linux(partition.memory_bytes(), &views))?;
        let irq = eventfd()?;
        let watchdog = partition.watchdog().map(board::timer);
        let (writer, output) = output::waiting(self.closing.clone());
        let init = InitSeen::default();
        let watch = InitWatch::new(writer, init.clone());
        let console = SerialPort::new(IrqLine(clone(&irq)?), watch);
        self.console = Some(console.clone());
        let place = Place {
            cpu: partition.cpu(),
            domain: self.domains.entry(partition.cpu()),
            reservation: None,
            ports: Vec::new(),
            doors: (sandbox::Kind::Disk, self.mode),
        };
        let (mut drives, mut disks) = (Vec::new(), Vec::new());
        for (number, disk) in (0..).zip(partition.disks()) {
            let (drive, thread) = Drive::open(number, disk, &memory, place.clone())?;
            drives.push(drive);
            disks.push(thread);
        }
        let mut board = Board {
            partition: partition.name().to_owned(),
            kvm: machine::open_kvm()?,
            memory: memory.clone(),
            kernel: Image::open(kernel).map_err(unfit)?,
            initrd: initrd.map(Image::open).transpose().map_err(unfit)?,
            cmdline: cmdline.to_owned(),
            console,
            irq,
            card: pci.map(Pci::into_card),
            bell: clone(&self.doorbell)?,
            drives,
            frequency: self.frequency,
            watchdog: watchdog.clone(),
            vm: None,
        };
        let (vcpu, guest) = board.start()?;
        self.frequency = board.frequency;
        let (restart, revivals) = LinuxRestart::new(board, self.mode)?;
        let processor = Processor { vcpu, ready: |_: &mut VcpuFd| Ok(()) };
        let mut prepared = self.spawn(partition, processor, memory, guest, output, revivals)?;
        prepared.account.restart = Some(Restart::Linux(restart));
        prepared.account.is_terminal = true;
        prepared.account.watchdog = watchdog;
        prepared.init = Some(init);
        prepared.disks = disks;
        Ok(prepared)
    }

    /// Makes a guest's memory, most of which is to clear it, and takes the time.
    fn clear<T>(&mut self, make: impl FnOnce() -> T) -> T {
        let before = Instant::now();
        let memory = make();
        self.clearing += before.elapsed();
        memory
    }

    /// Makes the thread of a partition: in its windows, or in the background.
    fn spawn<G, R>(
        &mut self,
        partition: &Partition,
        Processor { vcpu, ready }: Processor<R>,
        memory: GuestMemory,
        guest: G,
        output: output::OutputEnd,
        revivals: Receiver<Revival<G>>,
    ) -> Result<Prepared, RunError>
    where
        G: Guest + Send + 'static,
        R: FnOnce(&mut VcpuFd) -> Result<(), TouchError> + Send + 'static,
    {
        let (id, cpu, name) = (partition.id(), partition.cpu(), partition.name().to_owned());
        let control: Arc<Control> = Arc::default();
        let (health, reporter) = Watch::new(partition.health());
        let body = Body {
            _memory: memory,
            own: control.clone(),
            health: reporter,
            ending: Ending { partition: id, sender: self.sender.clone(), bell: clone(&self.bell)? },
        };
        let schedules = self.file.schedules();
        let says_done = guest.says_done();
        let plan = match (schedules.placements()[id.0].role, schedules.timetable_of(id)) {
            (Role::Windowed { guard }, Some(timetable)) => Some(Plan {
                timetable,
                board: self.board.clone(),
                guard,
                late_wake_up: self.late_wake_up,
                on_switch: match partition.on_schedule_change() {
                    ScheduleChange::Ignore => None,
                    ScheduleChange::Warm => Some(StartMode::Warm),
                    ScheduleChange::Cold => Some(StartMode::Cold),
                },
            }),
            _ => None,
        };
        let reservation =
            CpuReservations::of(schedules, cpu).partitions.into_iter().find(|(p, _)| *p == id);
        let reservation = reservation.map(|(_, r)| r);
        let ports = guest.io_ranges();
        let domain = self.domains.entry(cpu);
        let place = Place { cpu, domain, reservation, ports, doors: (G::THREAD, self.mode) };
        let (thread, records): (_, Option<Consumer<Record>>) = match plan {
            Some(plan) => {
                let (producer, consumer) = RingBuffer::new(RECORDS);
                let run = move |kickable: &mut Kickable, base: Timebase| {
                    let windowed = Windowed::new(plan, base, producer);
                    body.run_windowed(windowed, kickable, guest, &revivals);
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, ready, run)?, Some(consumer))
            }
            None => {
                let run = move |kickable: &mut Kickable, _: Timebase| {
                    body.run_background(kickable, guest, &revivals);
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, ready, run)?, None)
            }
        };
        let account = Account {
            name,
            control,
            output,
            is_terminal: false,
            records,
            gather: Gather::default(),
            says_done,
            health,
            releases: None,
            samples: None,
            occupied: Nanos::ZERO,
            watchdog: None,
            restart: None,
            restarts: 0,
            finished: None,
            ended_run: false,
            start_mode: StartMode::Cold,
            orders: Orders::default(),
            lines: Lines::default(),
        };
        Ok(Prepared { account, thread, init: None, disks: Vec::new() })
    }

    /// What is needed beyond the preparation. The rest is closed: the way to make machines, for one.
    #[must_use]
    pub fn finish(self) -> Finish {
        let Self { closing, board, console, interrupts, clearing, .. } = self;
        let interrupts = Some(interrupts).filter(|interrupts| !interrupts.is_empty());
        Finish { closing, board, console, interrupts, clearing }
    }

    /// One thread per CPU with windows, to end them.
    ///
    /// # Errors
    /// See [`RunError`].
    pub fn kickers(&self, prepared: &[Prepared]) -> Result<Vec<Kicker>, RunError> {
        let schedules = self.file.schedules();
        let mut kickers = Vec::new();
        for cpu in schedules.cpus() {
            let Some(timetable) = schedules.timetable_on(cpu) else { continue };
            let owner = |p: PartitionId| prepared[p.0].account.control.clone();
            let owners = schedules.tables().iter();
            let owners =
                owners.map(|t| t.windows_on(cpu).map(|w| owner(w.partition)).collect()).collect();
            let windows = kicker::Windows { timetable, owners, board: self.board.clone() };
            let control: Arc<Control> = Arc::default();
            let own = control.clone();
            let reservation = CpuReservations::of(schedules, cpu).kicker;
            let domain = self.domains.entry(cpu);
            let doors = (sandbox::Kind::Kicker, self.mode);
            let place = Place { cpu, domain, reservation, ports: Vec::new(), doors };
            let body = move |base: Timebase| kicker::run(&windows, &base, &own);
            let Cpu(number) = cpu;
            let thread = thread::plain(&format!("kicker-{number}"), place, control.clone(), body)?;
            kickers.push(Kicker { control, thread });
        }
        Ok(kickers)
    }
}

impl Body {
    /// Runs the guest, and again whenever it has been loaded anew.
    fn run_windowed<G: Guest>(
        mut self,
        mut windowed: Windowed,
        kickable: &mut Kickable,
        mut guest: G,
        revivals: &Receiver<Revival<G>>,
    ) {
        loop {
            self.own.enter_guest();
            let end = windowed.run(kickable, &mut guest, &self.own, &mut self.health);
            guest.left();
            self.own.leave_guest();
            let starting = guest.says_done() && windowed.starting();
            self.tell(end, starting, windowed.unrecorded());
            let revival = loop {
                if !windowed.next_window(&self.own) {
                    return;
                }
                match revivals.try_recv() {
                    Ok(revival) => break revival,
                    Err(TryRecvError::Empty) => {}
                    Err(TryRecvError::Disconnected) => return,
                }
            };
            if !self.revive(kickable, &mut guest, revival) {
                return;
            }
            windowed.restarted();
        }
    }

    fn run_background<G: Guest>(
        mut self,
        kickable: &mut Kickable,
        mut guest: G,
        revivals: &Receiver<Revival<G>>,
    ) {
        loop {
            self.own.enter_guest();
            let end = background::run(kickable, &mut guest, &self.own, &mut self.health);
            guest.left();
            self.own.leave_guest();
            self.tell(end, false, 0);
            let Ok(revival) = revivals.recv() else { return };
            if !self.revive(kickable, &mut guest, revival) {
                return;
            }
        }
    }

    /// Does what is left to do after the guest has been loaded anew; false if it is not.
    fn revive<G: Guest>(
        &mut self,
        kickable: &mut Kickable,
        guest: &mut G,
        revival: Revival<G>,
    ) -> bool {
        let revived = revival(kickable, guest);
        if !revived {
            self.tell(End::NotLoaded, true, 0);
        }
        revived
    }

    fn tell(&mut self, end: End, starting: bool, unrecorded: u64) {
        self.health.end(end);
        self.ending.tell(Finished {
            end,
            at: Tsc::now(),
            starting,
            noted: self.health.noted(),
            cpu_time: thread::cpu_time(),
            unrecorded,
        });
    }
}

/// A new event descriptor.
pub(crate) fn eventfd() -> Result<EventFd, RunError> {
    EventFd::new(EFD_NONBLOCK | EFD_CLOEXEC)
        .map_err(|source| RunError::Host { what: "make an event descriptor", source })
}

/// A second handle of an event descriptor.
pub(crate) fn clone(fd: &EventFd) -> Result<EventFd, RunError> {
    fd.try_clone().map_err(|source| RunError::Host { what: "copy an event descriptor", source })
}
