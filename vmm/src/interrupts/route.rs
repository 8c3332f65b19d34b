//! The ways of interrupts through KVM: in by an eventfd, and the guest's requests out by another.

use kvm_bindings::{
    KVM_IRQ_ROUTING_MSI, KvmIrqRouting, kvm_irq_routing_entry, kvm_irq_routing_entry__bindgen_ty_1,
    kvm_irq_routing_msi,
};
use kvm_ioctls::{IoEventAddress, VmFd};
use takt_abi::port;
use vmm_sys_util::eventfd::EventFd;

use crate::event::eventfd;
use crate::machine::MachineError;

/// What a message-signalled interrupt is written to: the local APIC with number 0, which is all that
/// the bits above choose (Intel SDM volume 3, "Message Address Register Format").
const MESSAGE_ADDRESS: u32 = 0xfee0_0000;

/// Both ways of one source.
pub struct Wires {
    /// A write injects the vector.
    pub signal: EventFd,
    /// Readable after the guest has asked for the vector.
    pub asked: EventFd,
}

/// Makes the ways for these vectors, in this order.
///
/// # Errors
/// If KVM refuses.
pub fn attach(
    vm: &VmFd,
    vectors: impl Iterator<Item = u8> + Clone,
) -> Result<Vec<Wires>, MachineError> {
    let refused = |source| MachineError::Call { what: "attach a device's interrupt", source };
    let entries: Vec<_> =
        (0..).zip(vectors.clone()).map(|(gsi, vector)| message(gsi, vector)).collect();
    let routing = KvmIrqRouting::from_entries(&entries)
        .map_err(|_| MachineError::Missing("room for the routes of interrupts"))?;
    vm.set_gsi_routing(&routing).map_err(refused)?;
    let address = IoEventAddress::Pio(port::ARM.into());
    (0..)
        .zip(vectors)
        .map(|(gsi, vector)| {
            let wires = Wires { signal: eventfd()?, asked: eventfd()? };
            vm.register_irqfd(&wires.signal, gsi).map_err(refused)?;
            vm.register_ioevent(&wires.asked, &address, u32::from(vector)).map_err(refused)?;
            Ok(wires)
        })
        .collect()
}

/// A route from an interrupt number of KVM's to a vector: fixed delivery, triggered by an edge.
fn message(gsi: u32, vector: u8) -> kvm_irq_routing_entry {
    kvm_irq_routing_entry {
        gsi,
        type_: KVM_IRQ_ROUTING_MSI,
        u: kvm_irq_routing_entry__bindgen_ty_1 {
            msi: kvm_irq_routing_msi {
                address_lo: MESSAGE_ADDRESS,
                data: vector.into(),
                ..Default::default()
            },
        },
        ..Default::default()
    }
}
