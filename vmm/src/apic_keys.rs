//! Keeping KVM's static keys as they are while guests switch their local APICs off and on.
//!
//! KVM checks whether an APIC is on only while some APIC of the host is off. These checks are behind static keys
//! (`apic_sw_disabled` and `apic_hw_disabled` of `arch/x86/kvm/lapic.c`): the kernel patches its code when the first APIC
//! is switched off, and again some time after the last one was switched on. To patch code it switches interrupts off, and interrupts
//! every processor of the host, also one whose window is open. A guest can cause that about once a second.
//!
//! So each machine whose guest has an APIC has one processor more. No thread runs it, and its APIC is off by both of its registers.
//! Then the keys stay on, and a guest that switches its own APIC only changes a count. The guest cannot
//! reach that processor: it is in no table, and KVM delivers nothing to an APIC that is off.

use kvm_ioctls::{VcpuFd, VmFd};

use crate::machine::{MachineError, cannot, share_tsc};

/// `IA32_APIC_BASE`: the APIC is on.
const APIC_ENABLED: u64 = 1 << 11;

/// The processor that no thread runs. The keys stay on as long as it is there.
pub struct ApicKeys {
    _processor: VcpuFd,
}

impl ApicKeys {
    /// Adds the processor to this machine. The guest's own have smaller numbers.
    ///
    /// # Errors
    /// [`MachineError::Call`].
    pub fn hold(vm: &VmFd, number: usize) -> Result<Self, MachineError> {
        let processor = vm.create_vcpu(number as u64).map_err(cannot("create an idle vCPU"))?;
        // KVM gives guests its clock only if all processors of their machine have the same TSC.
        share_tsc(&processor)?;
        let mut registers = processor.get_sregs().map_err(cannot("read an idle vCPU"))?;
        // A new APIC is off by its own register. `IA32_APIC_BASE` is the other one.
        registers.apic_base &= !APIC_ENABLED;
        processor.set_sregs(&registers).map_err(cannot("switch the APIC of an idle vCPU off"))?;
        Ok(Self { _processor: processor })
    }
}
