//! Where the virtio devices of a Linux are in its machine: the disks, behind them the network
//! interfaces, and last the socket device.

use kvm_ioctls::{IoEventAddress, NoDatamatch, VmFd};
use takt_devices::virtio::page::{BYTES, RegisterPage};
use takt_devices::virtio::registers;
use takt_plan::linux_map::VIRTIO_REGISTERS;
use vmm_sys_util::eventfd::EventFd;

use crate::boot::acpi::PCI_GSI;
use crate::machine::{MachineError, cannot};
use crate::memory::GuestMemory;

/// The place of a device, counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot(pub u32);

impl Slot {
    /// Where its registers lie.
    #[must_use]
    pub const fn registers(self) -> u32 {
        VIRTIO_REGISTERS + self.0 * BYTES as u32
    }

    /// Its interrupt: the pins behind that of the PCI function.
    #[must_use]
    pub const fn gsi(self) -> u32 {
        PCI_GSI + 1 + self.0
    }

    /// The page on which the guest sees the device's registers.
    ///
    /// # Errors
    /// If the memory was made for fewer devices.
    pub fn page(self, memory: &GuestMemory) -> Result<RegisterPage, MachineError> {
        RegisterPage::new(memory.regions(), self.registers().into())
            .ok_or(MachineError::Missing("memory for the registers of a virtio device"))
    }

    /// Lets KVM itself take what a driver writes to acknowledge interrupts, which would be an exit to Takt for each of
    /// them. No thread listens to `unheard`: see [`registers`].
    ///
    /// # Errors
    /// If KVM refuses.
    pub fn drop_acknowledgements(self, vm: &VmFd, unheard: &EventFd) -> Result<(), MachineError> {
        let at = IoEventAddress::Mmio(u64::from(self.registers()) + registers::ACKNOWLEDGE);
        vm.register_ioevent(unheard, &at, NoDatamatch)
            .map_err(cannot("take the acknowledgements of a virtio device's interrupts"))
    }

    /// Connects a device to a machine that has not run yet: what the guest rings for each of its queues, and
    /// what is rung to interrupt the guest.
    ///
    /// # Errors
    /// If KVM refuses.
    pub fn attach(
        self,
        vm: &VmFd,
        bells: &[EventFd],
        interrupt: &EventFd,
    ) -> Result<(), MachineError> {
        let notify = IoEventAddress::Mmio(u64::from(self.registers()) + registers::NOTIFY);
        for (queue, bell) in (0u32..).zip(bells) {
            vm.register_ioevent(bell, &notify, queue)
                .map_err(cannot("attach the doorbell of a virtio device"))?;
        }
        vm.register_irqfd(interrupt, self.gsi())
            .map_err(cannot("attach the interrupt of a virtio device"))
    }
}
