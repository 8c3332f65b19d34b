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
//! There is one counter for all sources, because there is one Linux at most and one pin of it: which
//! port has something new is seen in the channels.
//!
//! KVM takes only the rings of ports that have a doorbell. Any other value goes the way of every
//! access that means nothing: an exit to Takt, which counts it as illegal.

use kvm_ioctls::{IoEventAddress, VmFd};
use takt_abi::{PortTable, direction, port};
use vmm_sys_util::eventfd::EventFd;

use crate::boot::acpi::PCI_GSI;
use crate::machine::MachineError;

/// Lets a PLC ring `bell` for those of its ports that have a doorbell.
///
/// # Errors
/// If KVM refuses.
pub fn attach_sources(vm: &VmFd, table: &PortTable, bell: &EventFd) -> Result<(), MachineError> {
    let address = IoEventAddress::Pio(port::DOORBELL.into());
    for number in numbers(table) {
        vm.register_ioevent(bell, &address, number)
            .map_err(|source| MachineError::Call { what: "attach a doorbell", source })?;
    }
    Ok(())
}

/// Gives a Linux an interrupt for each ring of `bell`; several before it looks are one.
///
/// # Errors
/// If KVM refuses.
pub fn attach_listener(vm: &VmFd, bell: &EventFd) -> Result<(), MachineError> {
    vm.register_irqfd(bell, PCI_GSI)
        .map_err(|source| MachineError::Call { what: "attach the doorbells' interrupt", source })
}

/// The ports that ring, by their places in the table.
fn numbers(table: &PortTable) -> impl Iterator<Item = u32> {
    let ports = (0..table.count).zip(&table.ports);
    ports.filter(|(_, p)| p.direction == direction::SOURCE && p.doorbell != 0).map(|(n, _)| n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_abi::Port;

    #[test]
    fn only_sources_with_a_doorbell_ring() {
        let mut table = PortTable::EMPTY;
        let port = |direction, doorbell| Port { direction, doorbell, ..Port::NONE };
        let ports = [
            port(direction::SOURCE, 0),
            port(direction::SOURCE, 1),
            port(direction::DESTINATION, 1),
            port(direction::SOURCE, 1),
            port(direction::SOURCE, 1),
        ];
        table.ports[..5].copy_from_slice(&ports);
        table.count = 4;
        assert_eq!(numbers(&table).collect::<Vec<_>>(), [1, 3]);
    }
}
