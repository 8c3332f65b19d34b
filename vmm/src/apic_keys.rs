//! Keeping KVM's code as it is while guests switch their local APICs off and on.
//!
//! As long as any APIC on the host is off, KVM asks before each use of one whether it is on. The questions are
//! static keys (`apic_sw_disabled` and `apic_hw_disabled` of `arch/x86/kvm/lapic.c`): the first APIC that is
//! switched off puts them into the kernel's code, and some time after the last one has been switched on they are taken out. Each of
//! both is done with interrupts off, and with an interrupt to every processor of the host, also where a window
//! is open. A guest can have it done about once a second for as long as it likes.
//!
//! So each machine whose guest has an APIC gets a processor more, which no thread runs and whose APIC is off in both
//! senses. The questions stay in the code, and what a guest does to its own APIC is a count. The guest cannot
//! reach that processor: it is in no table, and KVM delivers nothing to an APIC that is off.

use kvm_ioctls::{VcpuFd, VmFd};

use crate::machine::{MachineError, cannot, share_tsc};

/// `IA32_APIC_BASE`: the APIC is on.
const APIC_ENABLED: u64 = 1 << 11;

/// The processor that no thread runs. The keys are held as long as it is there.
pub struct ApicKeys {
    _processor: VcpuFd,
}

impl ApicKeys {
    /// Holds the keys by a processor of this machine, whose own have smaller numbers.
    ///
    /// # Errors
    /// [`MachineError::Call`].
    pub fn hold(vm: &VmFd, number: usize) -> Result<Self, MachineError> {
        let processor = vm.create_vcpu(number as u64).map_err(cannot("create an idle vCPU"))?;
        // KVM gives guests its clock only if all processors of their machine have the same TSC.
        share_tsc(&processor)?;
        let mut registers = processor.get_sregs().map_err(cannot("read an idle vCPU"))?;
        // A new APIC is off by its own register (`IA32_APIC_BASE` is the other).
        registers.apic_base &= !APIC_ENABLED;
        processor.set_sregs(&registers).map_err(cannot("switch the APIC of an idle vCPU off"))?;
        Ok(Self { _processor: processor })
    }
}
