//! The virtual machine of one partition, as KVM objects.
//!
//! What a guest can see of a processor and a board is decided here, once, before its first
//! instruction. The two kinds differ on purpose. Linux gets what it needs to run unmodified:
//! interrupt controllers, timer, paravirtual clock. The PLC gets a processor, memory and ports,
//! and nothing that could interrupt it unless its file says so. Neither gets nested virtualisation or
//! performance counters ([`cpuid`]).

use kvm_bindings::{
    CpuId, KVM_CAP_ENFORCE_PV_FEATURE_CPUID, KVM_CAP_SPLIT_IRQCHIP, KVM_CAP_X86_DISABLE_EXITS,
    KVM_MAX_CPUID_ENTRIES, KVM_VCPU_TSC_CTRL, KVM_VCPU_TSC_OFFSET, KVM_X86_DISABLE_EXITS_PAUSE,
    Msrs, kvm_device_attr, kvm_enable_cap, kvm_lapic_state, kvm_msr_entry,
};
use kvm_ioctls::{Cap, Kvm, VcpuFd, VmFd};
use takt_plan::linux_map::TASK_STATE_SEGMENT;
use takt_scheduler::time::TscFrequency;
use thiserror::Error;
use vmm_sys_util::ioctl::ioctl_with_ref;

use crate::apic_keys::ApicKeys;
use crate::cpuid;
use crate::event::EventError;
use crate::health::bus_locks;
use crate::memory::{GuestMemory, MemoryError};
use crate::registers;
use crate::topology;

/// `KVM_CAP_HALT_POLL` of `include/uapi/linux/kvm.h`; kvm-ioctls has no name for it.
const KVM_CAP_HALT_POLL: u32 = 182;

/// What kvm-ioctls has no call for: the first it offers for other architectures only.
mod request {
    use kvm_bindings::{KVMIO, kvm_device_attr};

    vmm_sys_util::ioctl_iow_nr!(KVM_SET_DEVICE_ATTR, KVMIO, 0xe1, kvm_device_attr);
    vmm_sys_util::ioctl_iow_nr!(KVM_GET_DEVICE_ATTR, KVMIO, 0xe2, kvm_device_attr);
    vmm_sys_util::ioctl_iow_nr!(KVM_X86_SETUP_MCE, KVMIO, 0x9c, u64);
}

/// A virtual machine that KVM would not make, or not as it has to be.
#[derive(Debug, Error)]
pub enum MachineError {
    /// `/dev/kvm` cannot be used.
    #[error("cannot use /dev/kvm: {0}; is the kvm module loaded, and may this user open it?")]
    Open(kvm_ioctls::Error),
    /// This host's KVM lacks something.
    #[error("this host's KVM lacks {0}")]
    Missing(&'static str),
    /// A call that sets the machine up failed.
    #[error("KVM cannot {what}: {source}")]
    Call {
        /// What was attempted.
        what: &'static str,
        /// What KVM said.
        source: kvm_ioctls::Error,
    },
    /// Memory could not be attached.
    #[error(transparent)]
    Memory(#[from] MemoryError),
    /// There is nothing to bring an interrupt by.
    #[error(transparent)]
    Event(#[from] EventError),
}

/// Names the operation of a failed KVM call.
pub(crate) fn cannot(what: &'static str) -> impl FnOnce(kvm_ioctls::Error) -> MachineError {
    move |source| MachineError::Call { what, source }
}

/// Opens `/dev/kvm` and checks that it is what the rest relies on.
///
/// # Errors
/// [`MachineError::Open`] or [`MachineError::Missing`].
pub fn open_kvm() -> Result<Kvm, MachineError> {
    let kvm = Kvm::new().map_err(MachineError::Open)?;
    match missing(&kvm).first() {
        Some(name) => Err(MachineError::Missing(name)),
        None => Ok(kvm),
    }
}

/// What the rest relies on and this KVM does not have.
#[must_use]
pub fn missing(kvm: &Kvm) -> Vec<&'static str> {
    let needed = [
        (Cap::Irqchip, "an in-kernel interrupt controller (KVM_CAP_IRQCHIP)"),
        (Cap::Irqfd, "interrupts by eventfd (KVM_CAP_IRQFD)"),
        (Cap::Ioeventfd, "doorbells by eventfd (KVM_CAP_IOEVENTFD)"),
        (Cap::ImmediateExit, "immediate exit (KVM_CAP_IMMEDIATE_EXIT)"),
        (Cap::ReadonlyMem, "read-only memory slots (KVM_CAP_READONLY_MEM)"),
        (Cap::X86UserSpaceMsr, "registers by user space (KVM_CAP_X86_USER_SPACE_MSR, Linux 5.10)"),
        (Cap::X86MsrFilter, "filters for registers (KVM_CAP_X86_MSR_FILTER, Linux 5.10)"),
        (Cap::SyncRegs, "registers in shared memory (KVM_CAP_SYNC_REGS)"),
        (Cap::GetTscKhz, "the TSC's frequency (KVM_CAP_GET_TSC_KHZ)"),
    ];
    needed.into_iter().filter(|(cap, _)| !kvm.check_extension(*cap)).map(|(_, name)| name).collect()
}

/// A virtual machine with its virtual processors and all of its memory.
pub struct Machine {
    /// The processor that starts; its thread will own it.
    pub vcpu: VcpuFd,
    /// Further ones. They wait until the guest starts them, by way of KVM's own interrupt controller.
    pub further: Vec<VcpuFd>,
    /// The machine, for devices' interrupts.
    pub vm: VmFd,
    /// Speed of the TSC, which host and guests share.
    pub tsc: TscFrequency,
    /// What is kept as long as the guest can switch an APIC; `None` if it has none.
    pub apic_keys: Option<ApicKeys>,
}

/// A machine for a PLC guest. Without interrupts it has no interrupt controller, so nothing is ever
/// injected, and a halt is an exit. With them it has only that of the processor: no I/O
/// APIC, no timer of a board; see `docs/decisions/0008-interrupts-of-passed-through-devices.md`.
///
/// # Errors
/// See [`MachineError`].
pub fn for_plc(kvm: &Kvm, memory: &GuestMemory, interrupts: bool) -> Result<Machine, MachineError> {
    let vm = create(kvm, memory)?;
    registers::refuse(&vm).map_err(cannot("keep a guest from changing registers"))?;
    if interrupts {
        // In this form KVM keeps the processor's controller, and the board's is left to Takt, which
        // makes none. The argument is the number of its pins.
        let split = kvm_enable_cap { cap: KVM_CAP_SPLIT_IRQCHIP, ..Default::default() };
        vm.enable_cap(&split).map_err(cannot("create an interrupt controller"))?;
        switch_polling_off(&vm)?;
    }
    let vcpu = vm.create_vcpu(0).map_err(cannot("create a vCPU"))?;
    vcpu.set_cpuid2(&supported(kvm)?).map_err(cannot("set the CPUID"))?;
    bound_machine_checks(&vcpu)?;
    let apic_keys = interrupts.then(|| ApicKeys::hold(&vm, 1)).transpose()?;
    finish(vm, vec![vcpu], apic_keys)
}

/// Leaves a processor one bank of machine checks instead of 32, which no PLC reads and a restart would
/// have to clear.
fn bound_machine_checks(vcpu: &VcpuFd) -> Result<(), MachineError> {
    let capabilities = 1u64;
    // SAFETY: the kernel reads the live number.
    let result = unsafe { ioctl_with_ref(vcpu, request::KVM_X86_SETUP_MCE(), &capabilities) };
    if result == 0 {
        Ok(())
    } else {
        Err(cannot("set up its machine checks")(kvm_ioctls::Error::last()))
    }
}

/// Who sets the deadlines of a Linux's timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimerOwner {
    /// KVM, as the guest writes them.
    Kvm,
    /// Takt: the guest's writes are exits.
    Takt,
}

/// A machine for Linux: interrupt controllers with their timer, and the processor state that a PC's
/// firmware would leave behind.
///
/// There is no timer of the board (PIT). A kernel that knows its TSC's frequency and has a timer with
/// deadlines needs none, and KVM would keep it as a timer of the host that interrupts windows.
///
/// # Errors
/// See [`MachineError`].
pub fn for_linux(
    kvm: &Kvm,
    memory: &GuestMemory,
    timer: TimerOwner,
    processors: usize,
) -> Result<Machine, MachineError> {
    let vm = create(kvm, memory)?;
    vm.create_irq_chip().map_err(cannot("create the interrupt controllers"))?;
    if timer == TimerOwner::Takt {
        registers::take_over(&vm).map_err(cannot("hand registers over"))?;
    }
    switch_polling_off(&vm)?;
    let mut cpuid = supported(kvm)?;
    complete_for_linux(&mut cpuid);
    // Takt has its timers if there are windows of others on one of its CPUs.
    let is_beside_windows = timer == TimerOwner::Takt && processors > 1;
    if is_beside_windows {
        keep_spinning_inside(&vm)?;
        withhold(&mut cpuid, YIELDS);
    }
    let mut vcpus = Vec::with_capacity(processors);
    for number in 0..processors as u32 {
        let vcpu = vm.create_vcpu(number.into()).map_err(cannot("create a vCPU"))?;
        topology::describe(&mut cpuid, number, processors as u32)
            .ok_or(MachineError::Missing("room for the CPUID of a processor"))?;
        vcpu.set_cpuid2(&cpuid).map_err(cannot("set the CPUID"))?;
        if is_beside_windows {
            enforce_features(&vcpu)?;
        }
        set_firmware_state(&vcpu, number == 0)?;
        vcpus.push(vcpu);
    }
    let apic_keys = Some(ApicKeys::hold(&vm, processors)?);
    finish(vm, vcpus, apic_keys)
}

/// A processor that spins for another one stays in the guest. KVM would give its time to the one that does not run
/// (`kvm_vcpu_on_spin` in virt/kvm/kvm_main.c), and `yield_to` (kernel/sched/core.c) interrupts the CPU of that one for it, on which
/// a window may be open. Must come before there are processors.
fn keep_spinning_inside(vm: &VmFd) -> Result<(), MachineError> {
    let args = [KVM_X86_DISABLE_EXITS_PAUSE.into(), 0, 0, 0];
    let pauses = kvm_enable_cap { cap: KVM_CAP_X86_DISABLE_EXITS, args, ..Default::default() };
    vm.enable_cap(&pauses).map_err(cannot("keep pauses from being exits"))
}

/// Refuses hypercalls of features that the processor's CPUID does not have.
fn enforce_features(vcpu: &VcpuFd) -> Result<(), MachineError> {
    let (cap, args) = (KVM_CAP_ENFORCE_PV_FEATURE_CPUID, [1, 0, 0, 0]);
    let enforced = kvm_enable_cap { cap, args, ..Default::default() };
    vcpu.enable_cap(&enforced).map_err(cannot("refuse hypercalls that are not offered"))
}

/// A halted guest must give its CPU away at once, not poll on it for the next interrupt.
fn switch_polling_off(vm: &VmFd) -> Result<(), MachineError> {
    let no_polling = kvm_enable_cap { cap: KVM_CAP_HALT_POLL, ..Default::default() };
    vm.enable_cap(&no_polling).map_err(cannot("switch halt polling off"))
}

fn create(kvm: &Kvm, memory: &GuestMemory) -> Result<VmFd, MachineError> {
    // The call is interrupted by any signal that is pending, and then simply has to be repeated.
    let vm = loop {
        match kvm.create_vm() {
            Err(e) if e.errno() == libc::EINTR => {}
            result => break result.map_err(cannot("create a virtual machine"))?,
        }
    };
    cpuid::switch_counters_off(&vm).map_err(cannot("switch performance counters off"))?;
    vm.set_tss_address(TASK_STATE_SEGMENT as usize)
        .map_err(cannot("place its task state segment"))?;
    memory.map_into(&vm)?;
    if bus_locks::are_told(kvm) {
        bus_locks::tell(&vm).map_err(cannot("have bus locks told"))?;
    }
    Ok(vm)
}

fn finish(
    vm: VmFd,
    vcpus: Vec<VcpuFd>,
    apic_keys: Option<ApicKeys>,
) -> Result<Machine, MachineError> {
    vcpus.iter().try_for_each(share_tsc)?;
    let mut vcpus = vcpus.into_iter();
    let vcpu = vcpus.next().ok_or(MachineError::Missing("a processor"))?;
    let khz = vcpu.get_tsc_khz().map_err(cannot("tell the TSC's frequency"))?;
    let tsc = TscFrequency::from_khz(khz).ok_or(MachineError::Missing("a usable TSC"))?;
    Ok(Machine { vcpu, further: vcpus.collect(), vm, tsc, apic_keys })
}

/// Sets the guest's TSC offset to 0: an instant stamped by any guest can be compared with one
/// stamped by the host or by another guest.
pub(crate) fn share_tsc(vcpu: &VcpuFd) -> Result<(), MachineError> {
    let offset = 0u64;
    let attribute = tsc_offset_at(&raw const offset as u64);
    // SAFETY: the kernel reads the live attribute, and 8 bytes from the live `offset` it names.
    let result = unsafe { ioctl_with_ref(vcpu, request::KVM_SET_DEVICE_ATTR(), &attribute) };
    if result == 0 {
        Ok(())
    } else {
        Err(cannot("let the guest share the host's TSC (Linux 5.16)")(kvm_ioctls::Error::last()))
    }
}

/// How far the guest's TSC is ahead of the host's, in ticks; `None` if KVM does not tell. Waits for a guest that runs: only the
/// processor's own thread may ask.
pub(crate) fn tsc_offset(vcpu: &VcpuFd) -> Option<i64> {
    let mut offset = 0i64;
    let attribute = tsc_offset_at(&raw mut offset as u64);
    // SAFETY: the kernel reads the live attribute, and writes 8 bytes to the live `offset` it names.
    let result = unsafe { ioctl_with_ref(vcpu, request::KVM_GET_DEVICE_ATTR(), &attribute) };
    (result == 0).then_some(offset)
}

/// KVM's name for a processor's TSC offset, which is at this address.
fn tsc_offset_at(addr: u64) -> kvm_device_attr {
    let attr = u64::from(KVM_VCPU_TSC_OFFSET);
    kvm_device_attr { group: KVM_VCPU_TSC_CTRL, attr, addr, flags: 0 }
}

fn supported(kvm: &Kvm) -> Result<CpuId, MachineError> {
    let supported = kvm.get_supported_cpuid(KVM_MAX_CPUID_ENTRIES);
    let mut supported = supported.map_err(cannot("tell the CPUID it supports"))?;
    cpuid::withhold(&mut supported);
    Ok(supported)
}

/// Adds what KVM leaves to the VMM.
fn complete_for_linux(cpuid: &mut CpuId) {
    /// Leaf 1, ECX: KVM emulates it, but older hosts (6.1) do not announce it.
    const TSC_DEADLINE_TIMER: u32 = 1 << 24;
    /// Leaf 1, ECX: without it Linux looks for no hypervisor and finds neither kvmclock nor a
    /// reason to trust its TSC.
    const HYPERVISOR: u32 = 1 << 31;
    /// Of KVM's own features asynchronous page faults, which locked memory does not have, and the paravirtual end of
    /// interrupt; see `docs/decisions/0005-no-paravirtual-eoi.md`.
    const UNUSED: u32 = 1 << 4 | 1 << 6 | 1 << 10 | 1 << 14;

    for entry in cpuid.as_mut_slice().iter_mut().filter(|entry| entry.function == 1) {
        entry.ecx |= TSC_DEADLINE_TIMER | HYPERVISOR;
    }
    withhold(cpuid, UNUSED);
}

/// Features of KVM's by which a processor gives its time to another one: in place of spinning for a lock, and behind an interrupt.
const YIELDS: u32 = 1 << 7 | 1 << 13;

/// Takes features of KVM's away (`Documentation/virt/kvm/x86/cpuid.rst`).
fn withhold(cpuid: &mut CpuId, features: u32) {
    const KVM_FEATURES: u32 = 0x4000_0001;
    let own = cpuid.as_mut_slice().iter_mut().filter(|entry| entry.function == KVM_FEATURES);
    own.for_each(|entry| entry.eax &= !features);
}

/// What a firmware has done to a processor before it starts a kernel on the `first`.
fn set_firmware_state(vcpu: &VcpuFd, first: bool) -> Result<(), MachineError> {
    /// `IA32_MTRR_DEF_TYPE`: memory types are on, the default is write-back. Without it Linux
    /// takes all memory for uncached.
    const MTRR_DEF_TYPE: u32 = 0x2ff;
    const MTRR_ENABLED_WRITE_BACK: u64 = 1 << 11 | 6;
    /// `IA32_MISC_ENABLE`: fast string operations.
    const MISC_ENABLE: u32 = 0x1a0;

    let entry = |index, data| kvm_msr_entry { index, data, ..Default::default() };
    let entries = [entry(MTRR_DEF_TYPE, MTRR_ENABLED_WRITE_BACK), entry(MISC_ENABLE, 1)];
    let msrs = Msrs::from_entries(&entries)
        .map_err(|_| MachineError::Missing("room for two model-specific registers"))?;
    let set = vcpu.set_msrs(&msrs).map_err(cannot("set model-specific registers"))?;
    if set != entries.len() {
        return Err(MachineError::Missing("a model-specific register that Linux needs"));
    }
    // The guest starts the others by an interrupt that resets their controllers.
    if !first {
        return Ok(());
    }
    let mut apic = vcpu.get_lapic().map_err(cannot("read the local APIC"))?;
    wire_local_interrupts(&mut apic);
    vcpu.set_lapic(&apic).map_err(cannot("set the local APIC"))
}

/// "Virtual wire mode": the legacy controller on pin LINT0, the non-maskable interrupt on LINT1.
fn wire_local_interrupts(apic: &mut kvm_lapic_state) {
    const LINT0: usize = 0x350;
    const LINT1: usize = 0x360;
    const DELIVER_EXTERNAL: u32 = 7 << 8;
    const DELIVER_NMI: u32 = 4 << 8;

    for (register, mode) in [(LINT0, DELIVER_EXTERNAL), (LINT1, DELIVER_NMI)] {
        for (byte, value) in apic.regs[register..].iter_mut().zip(mode.to_le_bytes()) {
            *byte = value as _;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kvm_bindings::kvm_cpuid_entry2;

    #[test]
    fn linux_is_told_of_its_hypervisor() {
        let leaf = |function, ebx| kvm_cpuid_entry2 { function, ebx, ..Default::default() };
        let kvm = kvm_cpuid_entry2 { function: 0x4000_0001, eax: u32::MAX, ..Default::default() };
        let mut cpuid = CpuId::from_entries(&[leaf(1, 0x0708_1234), leaf(7, 5), kvm]).unwrap();
        complete_for_linux(&mut cpuid);
        let [one, seven, kvm] = cpuid.as_slice() else { panic!() };
        assert_eq!(kvm.eax >> 6 & 1, 0, "paravirtual end of interrupt");
        // Time that it was kept from its processor, locks that give it away, flushes and interrupts by one call.
        assert_eq!([5, 7, 9, 11].map(|bit| kvm.eax >> bit & 1), [1; 4], "what KVM says it has");
        assert_eq!((one.ebx, one.ecx >> 31, one.ecx >> 24 & 1), (0x0708_1234, 1, 1));
        assert_eq!((seven.ebx, seven.ecx), (5, 0));
        withhold(&mut cpuid, YIELDS);
        let kvm = cpuid.as_slice()[2].eax;
        assert_eq!([5, 7, 9, 11, 13].map(|bit| kvm >> bit & 1), [1, 0, 1, 1, 0], "no yields");
    }

    #[test]
    fn local_interrupts_are_wired_like_a_pc() {
        let mut apic = kvm_lapic_state::default();
        wire_local_interrupts(&mut apic);
        assert_eq!(apic.regs[0x351] as u8, 7);
        assert_eq!(apic.regs[0x361] as u8, 4);
    }
}
