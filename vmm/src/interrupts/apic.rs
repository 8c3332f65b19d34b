//! The local APIC of a PLC's processor, in the state in which its guest finds it.
//!
//! A guest should have nothing to set up that could be set up wrongly: the controller is on, in the
//! mode in which it needs no memory of its own (x2APIC), and nothing in it is pending. Of its own sources
//! only the pin LINT0 is open, by which the interrupt at a window's start comes to a guest that asks for it
//! ([`vcpu::tick`](crate::vcpu::tick)). A restart gets the same, whatever the guest before it has done.

use kvm_bindings::{KVM_MP_STATE_RUNNABLE, kvm_lapic_state, kvm_mp_state};
use kvm_ioctls::{Error, VcpuFd};
use takt_abi::interrupt_controller::SPURIOUS;

/// `IA32_APIC_BASE`: where the registers would be, the only processor, x2APIC mode, enabled (Intel
/// SDM volume 3, "x2APIC Mode").
const APIC_BASE: u64 = 0xfee0_0000 | 1 << 8 | 1 << 10 | 1 << 11;

/// Registers that are not 0, by their offset in the page of registers (Intel SDM volume 3, "Local
/// APIC Register Address Map").
const DESTINATION_FORMAT: (usize, u32) = (0xe0, u32::MAX);
/// Enabled, with its vector.
const SPURIOUS_VECTOR: (usize, u32) = (0xf0, 1 << 8 | SPURIOUS as u32);
/// Own sources that are masked: timer, thermal sensor, performance counters, pin LINT1, error.
const LOCAL: [usize; 5] = [0x320, 0x330, 0x340, 0x360, 0x370];
const MASKED: u32 = 1 << 16;
/// Pin LINT0: open, for interrupts whose vector comes with them (delivery mode ExtINT).
const LINT0: (usize, u32) = (0x350, 7 << 8);

/// Puts the processor's interrupt controller into its first state. The general state of the
/// processor must have been set before.
///
/// # Errors
/// What KVM says.
pub fn reset(vcpu: &VcpuFd) -> Result<(), Error> {
    let mut special = vcpu.get_sregs()?;
    special.apic_base = APIC_BASE;
    special.interrupt_bitmap = [0; 4];
    vcpu.set_sregs(&special)?;
    vcpu.set_lapic(&first_state())?;
    // A guest that has halted is still halted, however its registers are set.
    vcpu.set_mp_state(kvm_mp_state { mp_state: KVM_MP_STATE_RUNNABLE })
}

fn first_state() -> kvm_lapic_state {
    let mut apic = kvm_lapic_state::default();
    let masked = LOCAL.map(|register| (register, MASKED));
    let others = [DESTINATION_FORMAT, SPURIOUS_VECTOR, LINT0];
    for (register, value) in masked.into_iter().chain(others) {
        for (byte, value) in apic.regs[register..].iter_mut().zip(value.to_le_bytes()) {
            *byte = value as _;
        }
    }
    apic
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_controller_is_on_and_nothing_in_it_is_pending_or_open_but_the_ticks_pin() {
        let apic = first_state();
        let register =
            |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|i| apic.regs[at + i] as u8));
        assert_eq!(register(0xf0), 0x1ff);
        assert!(LOCAL.iter().all(|local| register(*local) == MASKED));
        assert_eq!(register(0x350), 0x700);
        let pending = (0x100..0x280).step_by(0x10).map(register);
        assert_eq!(pending.sum::<u32>(), 0);
    }
}
