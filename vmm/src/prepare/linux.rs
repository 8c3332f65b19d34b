//! A Linux's partition: memory, a board with its devices, the threads of its disks, and the host's
//! ends of its cables and sockets.

use std::path::Path;
use std::sync::Arc;

use kvm_ioctls::VcpuFd;
use takt_devices::output::{self, ConsoleOutput, OutputEnd};
use takt_devices::serial::{IrqLine, SerialPort};
use takt_scheduler::table::Role;
use takt_scheduler::time::Nanos;

use super::spawn::{Processor, Seat};
use super::{LinuxParts, Preparation, Prepared};
use crate::account::Account;
use crate::boot::linux::Image;
use crate::config::{self, Partition};
use crate::disk::Drive;
use crate::event;
use crate::init_watch::{InitSeen, InitWatch, PanicSeen};
use crate::kernel_watch::KernelWatch;
use crate::linux_machine::{self, LinuxMachine, LinuxMachineError};
use crate::machine::{self, MachineError};
use crate::memory::GuestMemory;
use crate::net;
use crate::pci::Pci;
use crate::power_button::PowerButton;
use crate::restart::{LinuxLoader, Restart};
use crate::run_error::RunError;
use crate::sandbox;
use crate::vcpu::thread::{self, Place};
use crate::vhost::{Carried, Closer, LinkWatch};
use crate::virtio::Slot;
use crate::vsock;

impl Preparation<'_> {
    pub(super) fn linux(
        &mut self,
        partition: &Partition,
        kernel: &Path,
        initrd: Option<&Path>,
        cmdline: &str,
    ) -> Result<Prepared, RunError> {
        let unfit =
            |source| LinuxMachineError::Image { partition: partition.name().to_owned(), source };
        let unplugged = |source| RunError::Net { partition: partition.name().to_owned(), source };
        let pci = Pci::new(self.channels.of(partition.id(), partition.kind()))?;
        let views = pci.as_ref().map(Pci::views).unwrap_or_default();
        let (bytes, pages) = (partition.memory_bytes(), self.pages_of(partition));
        let virtio = partition.virtio_devices();
        let memory = self.clear(|| GuestMemory::for_linux(bytes, pages, &views, virtio))?;
        let irq = event::eventfd()?;
        let watchdog = partition.watchdog().map(linux_machine::timer);
        let background =
            self.file.schedules().placements()[partition.id().0].role == Role::Background;
        let (writer, output) = self.console_output(background);
        let (init, panic) = (InitSeen::default(), PanicSeen::default());
        let watch = InitWatch::new(writer, init.clone(), panic.clone());
        let console = SerialPort::new(IrqLine(event::clone(&irq)?), watch);
        let is_shown = partition.console() == Some(config::Console::Terminal);
        if is_shown {
            self.console = Some(console.clone());
        }
        let links = self.linuxes.get(&partition.id());
        let links = links.ok_or(MachineError::Missing("a Linux's links"))?;
        let (cpus, deadlines) = (links.cpus.clone(), links.deadlines.clone());
        let bell = event::clone(&links.doorbell)?;
        let place = Place {
            cpu: partition.cpu(),
            domain: self.domains.entry(partition.cpu()),
            group: self.groups.entry(partition),
            reservation: None,
            ports: Vec::new(),
            doors: (sandbox::Kind::Disk, self.mode),
        };
        let beside = place.clone();
        let (mut drives, mut disks) = (Vec::new(), Vec::new());
        for (number, disk) in (0..).zip(partition.disks()) {
            let (drive, thread) = Drive::open(number, disk, &memory, place.clone())?;
            drives.push(drive);
            disks.push(thread);
        }
        let watches = drives.iter().map(Drive::watch).collect();
        let (mut carried, mut cables, mut links) = (Vec::new(), Vec::new(), Vec::new());
        if !partition.nets().is_empty() {
            net::load_modules(self.role).map_err(unplugged)?;
        }
        for (number, net) in (drives.len() as u32..).zip(partition.nets()) {
            let (interface, cable) =
                net::open(Slot(number), net, &memory, place.clone()).map_err(unplugged)?;
            links.push(LinkWatch::new(format!("interface {}", net.tap), interface.link()));
            carried.push(interface);
            cables.push(cable);
        }
        let mut socket = None;
        if let Some(cid) = partition.vsock() {
            let slot = Slot((drives.len() + carried.len()) as u32);
            let unreachable =
                |source| RunError::Vsock { partition: partition.name().to_owned(), source };
            let (device, end) =
                vsock::open(slot, cid, &memory, place, self.role).map_err(unreachable)?;
            links.push(LinkWatch::new("sockets".into(), device.link()));
            carried.push(device);
            socket = Some(end);
        }
        let closer = (!carried.is_empty())
            .then(|| Closer::start(carried.iter().map(Carried::link).collect(), self.spawner))
            .transpose()?;
        let patience = Some(partition.power_off()).filter(|time| *time != Nanos::ZERO);
        let button = patience.map(|_| event::eventfd().map(Arc::new)).transpose()?;
        let mut board = LinuxMachine {
            partition: partition.name().to_owned(),
            kvm: machine::open_kvm()?,
            memory: memory.clone(),
            kernel: Image::open(kernel).map_err(unfit)?,
            initrd: initrd.map(Image::open).transpose().map_err(unfit)?,
            cmdline: cmdline.to_owned(),
            console: console.clone(),
            irq,
            card: pci.map(Pci::into_card),
            bell,
            drives,
            carried,
            unheard: event::eventfd()?,
            button: button.clone(),
            frequency: self.frequency,
            watchdog: watchdog.clone(),
            processors: cpus.len(),
            deadlines: deadlines.clone(),
            vm: None,
            apic_keys: None,
        };
        let ((vcpu, guest), further) = board.start()?;
        self.frequency = board.frequency;
        let seat = Seat::new(partition);
        let (crew, others) = self.crew(partition, &seat, cpus.into_iter().skip(1).zip(further))?;
        let loader = LinuxLoader { machine: board, further: others.revivals };
        let spawn = |name: &str, kind, work: Box<dyn FnOnce() + Send>| {
            let doors = (kind, self.mode);
            thread::detached_at(name, Place { doors, ..beside.clone() }, work)
        };
        let (restart, revivals) = Restart::new(loader, &spawn)?;
        let processor = Processor { vcpu, ready: |_: &mut VcpuFd| Ok(()), seat, crew };
        let mut prepared = self.spawn(partition, processor, memory, guest, output, revivals)?;
        prepared.further = others.threads;
        prepared.account.further = others.controls;
        prepared.account.can_restart(restart);
        prepared.account.is_terminal = true;
        prepared.account.is_shown = is_shown;
        prepared.account.keyboard = Some(console);
        let Account { control, further, .. } = &prepared.account;
        if background {
            let controls = [control].into_iter().chain(further);
            deadlines.iter().zip(controls).for_each(|(of, control)| of.served_by(control.clone()));
        }
        prepared.account.deadlines = deadlines;
        prepared.account.watchdog = watchdog;
        prepared.account.power_button =
            button.zip(patience).map(|(wire, patience)| PowerButton::new(wire, patience));
        prepared.account.kernel = Some(KernelWatch::new(panic));
        prepared.account.disks = watches;
        prepared.account.links = links;
        prepared.disks = disks;
        prepared.linux = Some(LinuxParts { init, cables, nets: Vec::new(), vsock: socket, closer });
        Ok(prepared)
    }
    /// The serial port's way out. A Linux with windows is not made to wait: its thread would wake again
    /// and again to look for room, with its reservation, in windows of others.
    fn console_output(&self, background: bool) -> (Box<dyn ConsoleOutput + Send>, OutputEnd) {
        if background {
            let (writer, output) = output::waiting(self.closing.clone());
            (Box::new(writer), output)
        } else {
            let (writer, output) = output::dropping();
            (Box::new(writer), output)
        }
    }
}
