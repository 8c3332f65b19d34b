//! The machine of the Linux partition, made anew for each of its starts.
//!
//! A restart has to find what a power-on finds. KVM has no reset for a virtual machine, so each
//! start gets a new one; memory, console and images stay. The machine that was is taken apart
//! first, since its interrupts hang on the same event descriptors.

use std::sync::{Arc, LazyLock, Mutex};
use std::time::Instant;

use kvm_ioctls::{Kvm, VcpuFd, VmFd};
use takt_devices::ports::{Overlap, PortBus};
use takt_devices::power::{AcpiPower, KeyboardController, PowerLine};
use takt_devices::serial;
use takt_devices::watchdog::{self, Timer, Watchdog};
use takt_scheduler::time::{Nanos, TscFrequency};
use thiserror::Error;
use vm_memory::{Bytes, GuestAddress};
use vmm_sys_util::eventfd::EventFd;

use crate::apic_keys::ApicKeys;
use crate::boot;
use crate::boot::acpi::{
    AcpiConfig, POWER_BUTTON_GSI, POWER_PORT, SERIAL_IRQ, SERIAL_PORT, WATCHDOG_PORT,
};
use crate::boot::linux::{Image, LinuxImageError};
use crate::boot::long_mode::{self, StartError};
use crate::disk::Drive;
use crate::init_watch::Console;
use crate::machine::{self, Machine, MachineError, TimerOwner};
use takt_plan::linux_map::{HOLE_END, HOLE_START, PCI_WINDOW};

use crate::memory::GuestMemory;
use crate::pci::{PciError, PciPortDevice};
use crate::vcpu::guest_timer::{Deadlines, GuestTimer};
use crate::vcpu::kick;
use crate::vcpu::linux::{Board, LinuxGuest};
use crate::vhost::Carried;
use crate::virtio::Slot;

/// A Linux's machine could not be made.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum LinuxMachineError {
    #[error(transparent)]
    Machine(#[from] MachineError),
    #[error("partition {partition}: {source}")]
    Image { partition: String, source: LinuxImageError },
    #[error(transparent)]
    Start(#[from] StartError),
    #[error(transparent)]
    Pci(#[from] PciError),
    #[error("two devices of the Linux machine collide: {0}")]
    Ports(#[from] Overlap),
}

/// A watchdog that waits so long for a heartbeat.
#[must_use]
pub fn timer(time: Nanos) -> Timer {
    let counts = time.0 / (u64::from(watchdog::PERIOD_MS) * 1_000_000);
    Timer::new(u32::try_from(counts).unwrap_or(u32::MAX))
}

/// The clock of watchdogs, in ns.
#[must_use]
pub fn clock() -> u64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    u64::try_from(START.elapsed().as_nanos()).unwrap_or(u64::MAX)
}

/// A processor, and the guest as its thread knows it.
pub type Processor = (VcpuFd, LinuxGuest);

/// What outlives a start.
pub struct LinuxMachine {
    /// Name of the partition.
    pub partition: String,
    /// For making machines.
    pub kvm: Kvm,
    /// All memory of the guest.
    pub memory: GuestMemory,
    /// The kernel.
    pub kernel: Image,
    /// The initial RAM disk.
    pub initrd: Option<Image>,
    /// The kernel's command line.
    pub cmdline: String,
    /// The serial port.
    pub console: Console,
    /// Its interrupt.
    pub irq: EventFd,
    /// Its PCI function, if it has ports.
    pub card: Option<PciPortDevice>,
    /// What sources ring to wake it.
    pub bell: EventFd,
    /// Its disks, by their numbers.
    pub drives: Vec<Drive>,
    /// Its network interfaces, and then its socket device.
    pub carried: Vec<Carried>,
    /// What drivers of virtio devices ring when they acknowledge an interrupt. No thread listens.
    pub unheard: EventFd,
    /// The wire of its power button, if it has one.
    pub button: Option<Arc<EventFd>>,
    /// Speed of the TSC, from the first start on.
    pub frequency: Option<TscFrequency>,
    /// What notices that the guest is silent.
    pub watchdog: Option<Timer>,
    /// How many processors it has.
    pub processors: usize,
    /// Where the deadlines of each processor's timer are placed; empty if there are no windows of others on any of
    /// its CPUs.
    pub deadlines: Vec<Arc<Deadlines>>,
    /// The machine of the last start. Its processor keeps it alive, but its interrupts go with this.
    pub vm: Option<VmFd>,
    /// Held from the first start on, without a gap: guests can ask for their restart.
    pub apic_keys: Option<ApicKeys>,
}

impl LinuxMachine {
    /// Loads the images into memory, which is zero, and makes the machine for them. Returns its first
    /// processor, about to execute the first instruction, and further ones, which wait for the first to start them.
    ///
    /// # Errors
    /// See [`LinuxMachineError`].
    pub fn start(&mut self) -> Result<(Processor, Vec<Processor>), LinuxMachineError> {
        self.vm = None;
        let fittings = AcpiConfig {
            pci: self.card.as_ref().map(|_| PCI_WINDOW),
            virtio: (self.drives.len() + self.carried.len()) as u32,
            watchdog: self.watchdog.as_ref().map(Timer::most),
            power_button: self.button.is_some(),
            processors: self.processors,
        };
        let entry = boot::linux::load(
            &self.memory,
            &mut self.kernel,
            self.initrd.as_mut(),
            &self.cmdline,
            fittings,
        )
        .map_err(|source| LinuxMachineError::Image { partition: self.partition.clone(), source })?;
        let owner = if self.deadlines.is_empty() { TimerOwner::Kvm } else { TimerOwner::Takt };
        let Machine { vcpu, further, vm, tsc, apic_keys } =
            machine::for_linux(&self.kvm, &self.memory, owner, self.processors)?;
        self.apic_keys = apic_keys;
        long_mode::start(&vcpu, self.memory.regions(), entry)?;
        vm.register_irqfd(&self.irq, SERIAL_IRQ).map_err(|source| MachineError::Call {
            what: "attach the serial port's interrupt",
            source,
        })?;
        if let Some(button) = &self.button {
            vm.register_irqfd(button, POWER_BUTTON_GSI).map_err(|source| MachineError::Call {
                what: "attach the power button's interrupt",
                source,
            })?;
        }
        let power = PowerLine::default();
        let mut ports = PortBus::default();
        let last = SERIAL_PORT + serial::PORTS - 1;
        ports.attach(SERIAL_PORT..=last, Box::new(self.console.clone()))?;
        ports.attach(POWER_PORT..=POWER_PORT + 2, Box::new(AcpiPower(power.clone())))?;
        ports.attach(0x60..=0x64, Box::new(KeyboardController::new(power.clone())))?;
        let tsc = *self.frequency.get_or_insert(tsc);
        if let Some(card) = &self.card {
            card.attach(&self.memory, tsc, &vm, &mut ports, &self.bell)?;
        }
        let disks = self.drives.iter().map(|drive| drive.attach(&vm, &self.memory));
        let carried = self.carried.iter().map(|carried| carried.attach(&vm, &self.memory));
        let virtio = disks.chain(carried).collect::<Result<Vec<_>, _>>()?;
        for slot in (0..virtio.len() as u32).map(Slot) {
            slot.drop_acknowledgements(&vm, &self.unheard)?;
        }
        self.vm = Some(vm);
        if let Some(timer) = &self.watchdog {
            let registers = Watchdog::new(timer.clone(), clock);
            let last = WATCHDOG_PORT + watchdog::PORTS - 1;
            ports.attach(WATCHDOG_PORT..=last, Box::new(registers))?;
            timer.start(clock());
        }
        let board = Arc::new(Mutex::new(Board { ports, power, virtio }));
        let guest = |number| {
            let deadlines: Option<&Arc<Deadlines>> = self.deadlines.get(number);
            let timer = deadlines.cloned().and_then(GuestTimer::new);
            LinuxGuest::on(board.clone()).with_timer(timer)
        };
        let further = (1..).zip(further).map(|(number, vcpu)| (vcpu, guest(number))).collect();
        Ok(((vcpu, guest(0).watched_by(self.watchdog.clone())), further))
    }

    /// As [`start`](Self::start), after a guest has run there. The guest must not run any more.
    ///
    /// # Errors
    /// See [`LinuxMachineError`].
    pub fn start_anew(&mut self) -> Result<(Processor, Vec<Processor>), LinuxMachineError> {
        self.vm = None;
        self.console.reset();
        // What a disk still read, or a packet that came, would lie in the new guest's memory.
        self.drives.iter().for_each(Drive::reset);
        self.carried.iter().for_each(Carried::reset);
        self.clear().map_err(StartError::from)?;
        let (mut first, further) = self.start()?;
        // Here, since the partition's own thread may be a deadline thread.
        kick::prime(&mut first.0)
            .map_err(|source| MachineError::Call { what: "run a vCPU at all", source })?;
        Ok((first, further))
    }

    /// Clears all RAM; what lies in the hole of devices belongs to others too.
    fn clear(&self) -> Result<(), vm_memory::GuestMemoryError> {
        static ZEROS: [u8; 1 << 16] = [0; 1 << 16];
        let in_hole = |start: &u64| (HOLE_START..HOLE_END).contains(start);
        for (start, length) in self.memory.ranges().filter(|(start, _)| !in_hole(start)) {
            let mut at = 0;
            while at < length {
                let piece = (length - at).min(ZEROS.len() as u64);
                let zeros = ZEROS.get(..piece as usize).unwrap_or(&ZEROS);
                self.memory.regions().write_slice(zeros, GuestAddress(start + at))?;
                at += piece;
            }
        }
        Ok(())
    }
}
