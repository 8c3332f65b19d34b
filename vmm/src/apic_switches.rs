//! Two virtual machines that never run, so that no guest makes the host's kernel change its own code.
//!
//! KVM asks in many places whether a processor's local APIC is there and switched on. The question costs nothing as long as all
//! APICs of the host are, because then it is not in the code at all: the kernel writes it into its code when the first is
//! switched off, and takes it out a second after the last is on again (the static keys `apic_sw_disabled` and
//! `apic_hw_disabled` of the kernel's `arch/x86/kvm/lapic.c`). To do so it interrupts every processor of the host, in
//! windows or not, and works with interrupts off. A guest may switch its own APIC off and on as it likes, and each Linux does so
//! while it starts. From here on one APIC is off in both ways, until the end of the run: what others do changes no code. A further
//! processor has no APIC at all, as PLCs without interrupts have none, and of that there is a third key.

use kvm_bindings::kvm_sregs;
use kvm_ioctls::{Kvm, VcpuFd};

use crate::machine::{MachineError, cannot, empty};

/// The bit of `IA32_APIC_BASE` by which an APIC is there at all (Intel SDM, volume 3A, 11.4.3).
const ENABLED: u64 = 1 << 11;

/// Keeps the kernel's code as it is while it is held. A processor keeps its machine.
pub struct ApicSwitches {
    _off: VcpuFd,
    _none: VcpuFd,
}

impl ApicSwitches {
    /// Makes the machines. To be done before the first guest's.
    ///
    /// # Errors
    /// See [`MachineError`].
    pub fn hold(kvm: &Kvm) -> Result<Self, MachineError> {
        let vm = empty(kvm)?;
        vm.create_irq_chip().map_err(cannot("create the interrupt controllers"))?;
        // By software it is off from its creation on, as after a reset.
        let vcpu = vm.create_vcpu(0).map_err(cannot("create a vCPU"))?;
        let state = vcpu.get_sregs().map_err(cannot("tell a processor's registers"))?;
        let off = kvm_sregs { apic_base: state.apic_base & !ENABLED, ..state };
        vcpu.set_sregs(&off).map_err(cannot("switch an APIC off"))?;
        let none = empty(kvm)?.create_vcpu(0).map_err(cannot("create a vCPU"))?;
        Ok(Self { _off: vcpu, _none: none })
    }
}
