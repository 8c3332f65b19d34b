//! The disks of a Linux guest: where they are in its machine, and who serves them.
//!
//! ```text
//! write to the register --> KVM: ioeventfd --> disk's thread --> file
//!                          KVM: irqfd     <--/
//! ```
//!
//! The device is `takt_devices::disk`. Its thread is of the ordinary class and on the CPU of its
//! Linux, so that a guest that reads and writes without end spends what is its own: what the
//! windows leave. Nothing of it happens on the thread of a vCPU that has windows but the handful of
//! writes to registers that a driver makes when it starts. What it reads is memory, and its acknowledgement of an
//! interrupt ends in KVM.
//!
//! A disk is found by its memory-mapped registers, which ACPI names to Linux (`LNRO0005`; kernel,
//! `drivers/virtio/virtio_mmio.c`). As a PCI function it would need capabilities and
//! message-signalled interrupts in addition; see `docs/decisions/0010-disk.md`.

mod error;
mod file;
mod thread;

use std::mem;
use std::sync::Arc;

use kvm_ioctls::VmFd;
use takt_devices::disk::Shape;
use takt_devices::disk::device::DiskDevice;
use takt_devices::disk::handover::Handover;
use takt_devices::disk::server::{Disk, DiskId, Server};
use takt_devices::virtio::registers::Registers;
use vmm_sys_util::eventfd::{EFD_CLOEXEC, EventFd};

use crate::config;
use crate::event::{self, eventfd};
use crate::machine::MachineError;
use crate::memory::GuestMemory;
use crate::vcpu::thread::Place;
use crate::virtio::Slot;
use file::DiskFile;

pub use error::DiskError;
pub use file::DiskFileError;
pub use thread::DiskThread;

/// A disk, as the machines know it that its Linux has one after the other.
pub struct Drive {
    number: u32,
    shape: Shape,
    shared: Arc<Handover>,
    /// Rung by the guest.
    bell: EventFd,
    /// Rung for the guest.
    interrupt: EventFd,
}

impl Drive {
    /// Opens a disk and makes the thread that serves it, for the guest that has `memory`.
    ///
    /// # Errors
    /// If the file cannot be had, or the host gives no thread.
    pub fn open(
        number: u32,
        disk: &config::Disk,
        memory: &GuestMemory,
        place: Place,
    ) -> Result<(Self, DiskThread), DiskError> {
        let (medium, shape) = DiskFile::open(disk)?;
        let shared = Arc::new(Handover::new(Slot(number).page(memory)?));
        let bell = EventFd::new(EFD_CLOEXEC).map_err(DiskError::Bell)?;
        let interrupt = eventfd()?;
        let disk = Disk { shape, id: id(number), medium };
        let server = Server::new(shared.clone(), memory.only_ram()?, disk);
        let thread = DiskThread::new(
            number,
            place,
            server,
            event::clone(&bell)?,
            event::clone(&interrupt)?,
        )?;
        Ok((Self { number, shape, shared, bell, interrupt }, thread))
    }

    /// Connects the disk to a machine that has not run yet.
    ///
    /// # Errors
    /// If KVM refuses.
    pub fn attach(&self, vm: &VmFd, memory: &GuestMemory) -> Result<Registers, MachineError> {
        // The slots of disks come first.
        let slot = Slot(self.number);
        slot.attach(vm, std::slice::from_ref(&self.bell), &self.interrupt)?;
        Ok(Registers::new(DiskDevice::new(self.shape, self.shared.clone()), slot.page(memory)?))
    }

    /// Takes the disk away from a guest that does not run any more. Afterwards nothing is written to
    /// its memory.
    pub fn reset(&self) {
        self.shared.recall();
    }

    /// What tells of it.
    #[must_use]
    pub fn watch(&self) -> DiskWatch {
        DiskWatch { number: self.number, shared: self.shared.clone(), error: false, broken: false }
    }
}

/// The supervisor's view of a disk.
pub struct DiskWatch {
    number: u32,
    shared: Arc<Handover>,
    /// What has been told.
    error: bool,
    broken: bool,
}

impl DiskWatch {
    /// What is to be told: the first error of its file, and that a driver broke its queue, each once.
    pub fn look(&mut self) -> Option<String> {
        let Self { number, shared, error, broken } = self;
        if let Some(first) = shared.error().filter(|_| !mem::replace(error, true)) {
            return Some(format!("disk {number}: {first}; its Linux sees I/O errors"));
        }
        let tells = shared.was_broken() && !mem::replace(broken, true);
        tells.then(|| {
            format!("disk {number}: the guest's driver broke the queue, and has to reset the disk")
        })
    }
}

/// What Linux shows as the serial number of the disk.
fn id(number: u32) -> DiskId {
    let mut id = DiskId::default();
    id.iter_mut().zip(format!("takt-{number}").bytes()).for_each(|(to, from)| *to = from);
    id
}

#[cfg(test)]
mod tests {
    use std::io::Error;

    use super::*;
    use crate::memory::Pages;

    #[test]
    fn the_first_error_of_a_disk_is_told_once() {
        let memory = GuestMemory::for_linux(1 << 20, Pages::Small, &[], 1).unwrap();
        let shared = Arc::new(Handover::new(Slot(0).page(&memory).unwrap()));
        let mut watch =
            DiskWatch { number: 1, shared: shared.clone(), error: false, broken: false };
        assert_eq!(watch.look(), None);
        shared.note(Error::from_raw_os_error(libc::ENOSPC));
        shared.note(Error::from_raw_os_error(libc::EIO));
        let told = "disk 1: No space left on device (os error 28); its Linux sees I/O errors";
        assert_eq!(watch.look().as_deref(), Some(told));
        assert_eq!(watch.look(), None);
    }
}
