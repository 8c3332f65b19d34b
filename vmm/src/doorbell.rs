//! Doorbells: how a source wakes a Linux guest that waits for its messages.
//!
//! ```text
//! out 0x7a10, port --> KVM: ioeventfd --> eventfd --> KVM: irqfd --> I/O APIC pin 16 of Linux
//! ```
//!
//! A ring never leaves the kernel of the host. The PLC's instruction is one exit, which adds to a
//! counter and goes back; no thread of Takt wakes up, so none can be late. The interrupt is brought
//! by a worker thread of the kernel's, of the ordinary class and on the PLC's CPU: when no window is
//! in the way. A guest that rings without end spends its own window, and interrupts Linux as often
//! as Linux takes it.
//!
//! Each Linux has one counter for all sources, because it has one pin for them: which port has something new is seen in
//! the channels. A PLC reaches each Linux by the numbers of the ports whose channels lead there.
//!
//! KVM takes only the rings of ports that have a doorbell. Any other value goes the way of every
//! access that means nothing: an exit to Takt, which counts it as illegal.

use kvm_ioctls::{IoEventAddress, VmFd};
use takt_abi::port;
use vmm_sys_util::eventfd::EventFd;

use crate::boot::acpi::PCI_GSI;
use crate::machine::MachineError;

/// Lets a PLC ring `bell` by the number of a port.
///
/// # Errors
/// If KVM refuses.
pub fn attach_source(vm: &VmFd, port: u32, bell: &EventFd) -> Result<(), MachineError> {
    vm.register_ioevent(bell, &IoEventAddress::Pio(port::DOORBELL.into()), port)
        .map_err(|source| MachineError::Call { what: "attach a doorbell", source })
}

/// Gives a Linux an interrupt for each ring of `bell`; several before it looks are one.
///
/// # Errors
/// If KVM refuses.
pub fn attach_listener(vm: &VmFd, bell: &EventFd) -> Result<(), MachineError> {
    vm.register_irqfd(bell, PCI_GSI)
        .map_err(|source| MachineError::Call { what: "attach the doorbells' interrupt", source })
}
