//! Model-specific registers that a guest may not write in KVM.
//!
//! Most writes to such a register KVM carries out by itself. Some have to be kept from it, by its filter
//! (`Documentation/virt/kvm/api.rst`, KVM_X86_SET_MSR_FILTER). What a PLC writes there fails, as in a processor that
//! has no such register. A Linux's writes are exits to Takt, which places its deadlines
//! ([`vcpu::guest_timer`](crate::vcpu::guest_timer)) and drops all others.

use kvm_bindings::{KVM_CAP_X86_USER_SPACE_MSR, kvm_enable_cap};
use kvm_ioctls::{
    Error, MsrExitReason, MsrFilterDefaultAction, MsrFilterRange, MsrFilterRangeFlags, VmFd,
};

/// `IA32_TSC_DEADLINE`: when the local APIC's timer is to go off.
pub const TSC_DEADLINE: u32 = 0x6e0;

/// The first of some registers, and how many they are.
type Range = (u32, u32);

/// A Linux's clock: deadlines, `IA32_TIME_STAMP_COUNTER` and `IA32_TSC_ADJUST`.
const CLOCK: [Range; 3] = [(TSC_DEADLINE, 1), (0x10, 1), (0x3b, 1)];

/// A register that KVM does not let anybody put back once a guest has set a bit: AMD's control of virtual machines
/// (`svm_set_vm_cr`). A restart of a PLC could not undo it. Of [`LOGGED`], AMD's hardware configuration is another
/// (`MSR_K7_HWCR` in `kvm_set_msr_common`).
const STUCK: Range = (0xc001_0114, 1);

/// Registers that KVM does not have and whose writes it logs (`vcpu_unimpl` in arch/x86/kvm/x86.c, svm/svm.c and
/// vmx/vmx.c): performance counters and their events, control of a cache, debug control, AMD's hardware
/// configuration and place of its configuration space, and what virtual machines ignore. The kernel composes a line of
/// its log with interrupts off: 6 us in the lab, in which no PLC is woken. A Linux writes to the first
/// counter while it starts.
const LOGGED: [Range; 8] = [
    (0xc1, 2),
    (0x186, 2),
    (0xc001_0000, 8),
    (0x11e, 1),
    (0x1d9, 1),
    (0xc001_0015, 1),
    (0xc001_0058, 1),
    (0xc001_0115, 1),
];

/// Has KVM refuse a PLC's writes to some registers.
///
/// # Errors
/// Those of KVM.
pub fn refuse(vm: &VmFd) -> Result<(), Error> {
    filter(vm, LOGGED.into_iter().chain([STUCK]))
}

/// Makes a Linux's writes to some registers exits.
///
/// # Errors
/// Those of KVM.
pub fn take_over(vm: &VmFd) -> Result<(), Error> {
    let mut exits = kvm_enable_cap { cap: KVM_CAP_X86_USER_SPACE_MSR, ..Default::default() };
    exits.args[0] = u64::from(MsrExitReason::Filter.bits());
    vm.enable_cap(&exits)?;
    filter(vm, CLOCK.into_iter().chain(LOGGED))
}

fn filter(vm: &VmFd, registers: impl Iterator<Item = Range>) -> Result<(), Error> {
    // One bit for each register of a range, none of which is set; KVM reads 64 at a time.
    const KEPT: [u8; 8] = [0; 8];
    let flags = MsrFilterRangeFlags::WRITE;
    let range = |(base, msr_count)| MsrFilterRange { flags, base, msr_count, bitmap: &KEPT };
    let ranges: Vec<MsrFilterRange<'_>> = registers.map(range).collect();
    vm.set_msr_filter(MsrFilterDefaultAction::ALLOW, &ranges)
}
