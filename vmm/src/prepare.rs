//! Preparing partitions: everything that can fail, before anything runs.
//!
//! A partition that is prepared has its memory, its machine, its image in place, and a thread that
//! is pinned, has its reservation and waits for the epoch.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, channel};

use kvm_ioctls::Kvm;
use rtrb::{Consumer, RingBuffer};
use takt_abi::PortTable;
use takt_abi::memory::PORT_TABLE;
use takt_devices::output;
use takt_devices::ports::PortBus;
use takt_devices::power::{AcpiPower, KeyboardController, PowerLine};
use takt_devices::serial::{self, IrqLine, SerialPort};
use takt_scheduler::reservation::CpuReservations;
use takt_scheduler::switch::SwitchBoard;
use takt_scheduler::table::{Cpu, PartitionId, Role};
use takt_scheduler::time::{Nanos, Timebase, TscFrequency};
use vmm_sys_util::eventfd::{EFD_CLOEXEC, EFD_NONBLOCK, EventFd};

use crate::account::{Account, Finished};
use crate::boot;
use crate::boot::StartMode;
use crate::boot::acpi::{POWER_PORT, SERIAL_IRQ, SERIAL_PORT};
use crate::boot::long_mode::{self, Entry};
use crate::boot::plc::PlcImage;
use crate::boot::touch::touch;
use crate::channels::Channels;
use crate::config::{Kind, Partition, PartitionFile, ScheduleChange};
use crate::cpuset::Domains;
use crate::doorbell;
use crate::gather::Gather;
use crate::init_watch::{InitSeen, InitWatch};
use crate::machine::{self, Machine, MachineError};
use crate::memory::GuestMemory;
use crate::pci::{self, Pci};
use crate::restart::{Restart, Revival};
use crate::run_error::RunError;
use crate::supervisor::Console;
use crate::terminal::Lines;
use crate::vcpu::exit_count::ExitCount;
use crate::vcpu::guest::{End, Guest, KvmFailure};
use crate::vcpu::kick::Kickable;
use crate::vcpu::linux::LinuxGuest;
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
    /// The serial port of the Linux guest, once there is one.
    pub console: Option<Console>,
    /// What sources ring to wake the Linux guest.
    pub doorbell: EventFd,
}

/// What a guest's thread keeps for as long as the guest exists.
struct Body {
    /// The machine's memory and descriptor live as long as its processor.
    machine: (GuestMemory, kvm_ioctls::VmFd),
    own: Arc<Control>,
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
        let memory = GuestMemory::for_plc(bytes, &ports.views)?;
        let mut machine = machine::for_plc(&self.kvm, &memory)?;
        touch(&mut machine.vcpu, &memory)?;
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
        long_mode::start(&machine.vcpu, memory.regions(), entry)?;
        let (console, output) = output::dropping();
        let frame = self.file.schedules().frame();
        let guest = PlcGuest::new(&memory, bytes, tsc.khz(), frame, console)
            .ok_or(MachineError::Missing("the PLC guest's pages"))?;
        let (restart, revivals) = Restart::new(memory.clone(), image, ports.own);
        let mut prepared = self.spawn(partition, machine, memory, guest, output, revivals)?;
        prepared.account.restart = Some(restart);
        Ok(prepared)
    }

    fn linux(
        &mut self,
        partition: &Partition,
        kernel: &Path,
        initrd: Option<&Path>,
        cmdline: &str,
    ) -> Result<Prepared, RunError> {
        let pci = Pci::new(self.channels.of(partition.id(), partition.kind()))?;
        let views = pci.as_ref().map(Pci::views).unwrap_or_default();
        let memory = GuestMemory::for_linux(partition.memory_bytes(), &views)?;
        let window = pci.as_ref().map(|_| pci::WINDOW);
        let entry = boot::linux::load(&memory, kernel, initrd, cmdline, window)
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
        if let Some(pci) = pci {
            let tsc = *self.frequency.get_or_insert(machine.tsc);
            pci.attach(&memory, tsc, &machine, &mut ports, &self.doorbell)?;
        }
        self.console = Some(console);
        let guest = LinuxGuest::new(ports, power);
        // Nobody holds the other end: a Linux that has ended is not started again.
        let (_, revivals) = channel();
        let mut prepared = self.spawn(partition, machine, memory, guest, output, revivals)?;
        prepared.account.is_terminal = true;
        prepared.init = Some(init);
        Ok(prepared)
    }

    /// Makes the thread of a partition: in its windows, or in the background.
    fn spawn(
        &mut self,
        partition: &Partition,
        machine: Machine,
        memory: GuestMemory,
        guest: impl Guest + Send + 'static,
        output: output::OutputEnd,
        revivals: Receiver<Revival>,
    ) -> Result<Prepared, RunError> {
        let Machine { vcpu, vm, tsc } = machine;
        self.frequency.get_or_insert(tsc);
        let (id, cpu, name) = (partition.id(), partition.cpu(), partition.name().to_owned());
        let control: Arc<Control> = Arc::default();
        let body = Body {
            machine: (memory, vm),
            own: control.clone(),
            ending: Ending { partition: id, sender: self.sender.clone(), bell: clone(&self.bell)? },
        };
        let schedules = self.file.schedules();
        let says_done = guest.says_done();
        let plan = match (schedules.placements()[id.0].role, schedules.timetable_of(id)) {
            (Role::Windowed { guard }, Some(timetable)) => Some(Plan {
                timetable,
                board: self.board.clone(),
                guard,
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
        let place = Place { cpu, domain: self.domains.entry(cpu), reservation };
        let (thread, records): (_, Option<Consumer<Record>>) = match plan {
            Some(plan) => {
                let (producer, consumer) = RingBuffer::new(RECORDS);
                let exit_count = ExitCount::of(&vcpu);
                let run = move |kickable: &mut Kickable, base: Timebase| {
                    let windowed = Windowed::new(plan, base, producer, exit_count);
                    body.run_windowed(windowed, kickable, guest, &revivals);
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, run)?, Some(consumer))
            }
            None => {
                let run = move |kickable: &mut Kickable, _: Timebase| {
                    body.run_background(kickable, guest);
                };
                (thread::vcpu(&name, place, control.clone(), vcpu, run)?, None)
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
            releases: None,
            occupied: Nanos::ZERO,
            restart: None,
            restarts: 0,
            finished: None,
            lines: Lines::default(),
        };
        Ok(Prepared { account, thread, init: None })
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
            let place = Place { cpu, domain: self.domains.entry(cpu), reservation };
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
    fn run_windowed(
        self,
        mut windowed: Windowed,
        kickable: &mut Kickable,
        mut guest: impl Guest,
        revivals: &Receiver<Revival>,
    ) {
        loop {
            let end = windowed.run(kickable, &mut guest, &self.own);
            self.tell(end, &guest, windowed.unrecorded());
            // Without a guest there is no cycle that this wait could delay.
            let Ok(Revival { mode, entry }) = revivals.recv() else { return };
            if !self.start_anew(kickable, entry) {
                self.tell(End::Kvm(KvmFailure::Internal), &guest, windowed.unrecorded());
                return;
            }
            guest.restarted(mode);
            windowed.catch_up();
        }
    }

    fn start_anew(&self, kickable: &mut Kickable, entry: Entry) -> bool {
        let (memory, _) = &self.machine;
        // What the last exit has left to be done must not happen to the new guest.
        kickable.prime().is_ok()
            && long_mode::start(kickable.vcpu(), memory.regions(), entry).is_ok()
    }

    fn run_background(self, kickable: &mut Kickable, mut guest: impl Guest) {
        let end = background::run(kickable, &mut guest, &self.own);
        self.tell(end, &guest, 0);
    }

    fn tell(&self, end: End, guest: &impl Guest, unrecorded: u64) {
        let illegal_accesses = guest.illegal_accesses();
        let cpu_time = thread::cpu_time();
        self.ending.tell(Finished { end, cpu_time, illegal_accesses, unrecorded });
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
