//! A PLC's processor as it was before the first instruction, for the next start.
//!
//! A restart clears the guest's memory, sets the registers and enters the image. What else the guest
//! before it has changed in the processor would stay: a page of memory types, an offset of the time
//! stamp counter, a mask of the extended state, a page that KVM writes to. The new guest did not ask
//! for it and cannot know it. So all of that is read once, when the processor is new, and put back.
//!
//! A new processor in a new machine would do the same without a list, as it does for a Linux. But
//! making one takes many times a window's length, and the machine of a PLC has devices, interrupts and
//! mapped memory that all would have to be made again.
//!
//! # Which model-specific registers
//!
//! Those that KVM lists (`KVM_GET_MSR_INDEX_LIST`) less `LEFT_OUT`, and `UNLISTED`; of both
//! those that this host's KVM can read. What a guest may change is among them: the entry points of
//! system calls, memory types, auxiliary values, speculation control, the pages of KVM's own
//! interface, and the adjustment of the time stamp counter. At a restart only what differs is written,
//! since some writes have effects of their own. Two registers of AMD's KVM does not let anybody put
//! back, so a PLC cannot change them ([`registers`](crate::registers)). It is done by the partition's thread in a window of its
//! partition's, so it takes no time from others.

use std::sync::Arc;

use kvm_bindings::{
    KVM_VCPUEVENT_VALID_SMM, Msrs, kvm_msr_entry, kvm_sregs, kvm_vcpu_events, kvm_xcrs, kvm_xsave,
};
use kvm_ioctls::{Cap, Kvm, VcpuFd};

use crate::machine::{self, MachineError, cannot};

/// Registers that KVM lists and that need not be put back, both ends included.
const LEFT_OUT: [([u32; 2], &str); 14] = [
    ([0x10, 0x10], "the time stamp counter: its offset is set, which also undoes writes to it"),
    ([0x34, 0x34], "a count of system management interrupts that no guest can set"),
    ([0x8b, 0x8b], "the microcode's revision"),
    ([0xc1, 0xd4], "performance counters, of which there are none; platform information"),
    ([0x10a, 0x10a], "what the processor is immune to"),
    ([0x186, 0x199], "performance counters' events"),
    ([0x309, 0x345], "fixed performance counters and their capabilities"),
    ([0x38d, 0x3f2], "control of performance counters"),
    ([0x480, 0x493], "capabilities of VMX"),
    ([0x560, 0x58f], "processor trace, which no guest is told of"),
    ([0x4000_0000, 0x4000_10ff], "Hyper-V's, which no guest has, and which reading would set up"),
    ([0x4b56_4d07, 0x4b56_4d07], "the answer to a page fault, which is an event and no state"),
    ([0xc000_0300, 0xc000_0303], "control of AMD's performance counters"),
    ([0xc001_0000, 0xc001_0007], "AMD's performance counters and their events"),
];
/// More of those: AMD's core performance counters.
const LEFT_OUT_AMD: [u32; 2] = [0xc001_0200, 0xc001_020b];

/// Registers that a guest can change and that KVM does not list: memory types (variable, fixed,
/// default), debug control, the only bank of machine checks, extended state of supervisors, AMD's
/// work-arounds.
const UNLISTED: [[u32; 2]; 9] = [
    [0x200, 0x20f],
    [0x250, 0x250],
    [0x258, 0x259],
    [0x268, 0x26f],
    [0x2ff, 0x2ff],
    [0x1d9, 0x1d9],
    [0x400, 0x403],
    [0xda0, 0xda0],
    [0xc001_0140, 0xc001_0141],
];

/// The state of a processor that no guest has used yet.
#[derive(Clone)]
pub struct FirstState {
    special: kvm_sregs,
    /// In the order of their numbers.
    registers: Msrs,
    /// Room for what a guest has made of them.
    found: Msrs,
    /// `None`: the processor has none, and neither has the host.
    extended: Option<(kvm_xcrs, Arc<kvm_xsave>)>,
}

impl FirstState {
    /// Reads it.
    ///
    /// # Errors
    /// See [`MachineError`].
    pub fn of(kvm: &Kvm, vcpu: &VcpuFd) -> Result<Self, MachineError> {
        let list = kvm.get_msr_index_list().map_err(cannot("list model-specific registers"))?;
        let mut indices: Vec<u32> = list.as_slice().iter().copied().filter(is_kept).collect();
        indices.extend(UNLISTED.into_iter().flat_map(|[first, last]| first..=last));
        indices.sort_unstable();
        indices.dedup();
        let entries = readable(vcpu, &indices)?;
        let extended = if kvm.check_extension(Cap::Xsave) && kvm.check_extension(Cap::Xcrs) {
            let xcrs = vcpu.get_xcrs().map_err(cannot("read extended control registers"))?;
            let mut xsave = vcpu.get_xsave().map_err(cannot("read the extended state"))?;
            set_floating_point(&mut xsave);
            Some((xcrs, Arc::new(xsave)))
        } else {
            None
        };
        let special = vcpu.get_sregs().map_err(cannot("read special registers"))?;
        Ok(Self { special, registers: room(&entries)?, found: room(&entries)?, extended })
    }

    /// Puts it back. The registers with which a guest starts are set after this.
    ///
    /// # Errors
    /// See [`MachineError`].
    pub fn restore(&mut self, vcpu: &mut VcpuFd) -> Result<(), MachineError> {
        // First of all, since it also leaves system management mode, in which little can be set.
        let events = kvm_vcpu_events { flags: KVM_VCPUEVENT_VALID_SMM, ..Default::default() };
        vcpu.set_vcpu_events(&events).map_err(cannot("forget events"))?;
        vcpu.set_sregs(&self.special).map_err(cannot("set special registers"))?;
        // Without an interrupt controller KVM takes this one from here at each entry.
        vcpu.get_kvm_run().cr8 = self.special.cr8;
        if let Some((xcrs, xsave)) = &self.extended {
            vcpu.set_xcrs(xcrs).map_err(cannot("set extended control registers"))?;
            // SAFETY: the area is as long as that of `get_xsave`, which has filled it: no feature
            // with a larger one is on, since a process has to ask the kernel for those.
            unsafe { vcpu.set_xsave(xsave) }.map_err(cannot("set the extended state"))?;
        }
        let number = vcpu.get_msrs(&mut self.found).map_err(cannot("read registers"))?;
        if number != self.registers.as_slice().len() {
            return Err(MachineError::Missing("a model-specific register that it had"));
        }
        for (found, first) in self.found.as_slice().iter().zip(self.registers.as_slice()) {
            if found.data != first.data {
                let set = vcpu.set_msrs(&room(&[*first])?);
                if set.map_err(cannot("set a register"))? != 1 {
                    return Err(MachineError::Missing("a way to set a register that it had"));
                }
            }
        }
        // Last, since the registers of the counter and its adjustment shift it.
        machine::share_tsc(vcpu)
    }
}

/// Writes the first state of the x87 unit and SSE into the area, and says that it is there: the kernel
/// sets MXCSR from here only, and only then (`copy_uabi_to_xstate` in `arch/x86/kernel/fpu/xstate.c`;
/// `KVM_SET_FPU` leaves it). Offsets: Intel SDM volume 1, "XSAVE area".
fn set_floating_point(xsave: &mut kvm_xsave) {
    const FCW: (usize, u32) = (0, 0x37f);
    const MXCSR: (usize, u32) = (6, 0x1f80);
    const XSTATE_BV: usize = 128;
    const X87_AND_SSE: u32 = 0b11;

    let legacy = xsave.region.iter_mut().take(XSTATE_BV);
    legacy.for_each(|word| *word = 0);
    for (at, value) in [FCW, MXCSR] {
        xsave.region[at] = value;
    }
    xsave.region[XSTATE_BV] |= X87_AND_SSE;
}

#[cfg(test)]
impl FirstState {
    /// Of no processor, for tests that start no guest.
    pub fn none() -> Self {
        let none = room(&[]).unwrap();
        Self { special: kvm_sregs::default(), registers: none.clone(), found: none, extended: None }
    }
}

/// Reads those of the registers that this host's KVM can read, which stops at the first that it cannot.
fn readable(vcpu: &VcpuFd, indices: &[u32]) -> Result<Vec<kvm_msr_entry>, MachineError> {
    let asked = |&index: &u32| kvm_msr_entry { index, ..Default::default() };
    let mut entries = Vec::with_capacity(indices.len());
    let mut rest = indices;
    while !rest.is_empty() {
        let mut some = room(&rest.iter().map(asked).collect::<Vec<_>>())?;
        let number = vcpu.get_msrs(&mut some).map_err(cannot("read registers"))?;
        entries.extend(some.as_slice().iter().take(number));
        rest = rest.get(number + 1..).unwrap_or(&[]);
    }
    Ok(entries)
}

fn is_kept(index: &u32) -> bool {
    let left_out = LEFT_OUT.iter().map(|(range, _)| range).chain([&LEFT_OUT_AMD]);
    !left_out.into_iter().any(|[first, last]| (first..=last).contains(&index))
}

fn room(entries: &[kvm_msr_entry]) -> Result<Msrs, MachineError> {
    Msrs::from_entries(entries)
        .map_err(|_| MachineError::Missing("room for its model-specific registers"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_guest_can_change_is_kept_and_what_has_effects_is_not() {
        // IA32_TSC_ADJUST, IA32_PAT, STAR, KVM's system time, TSC_AUX, MISC_ENABLE, SPEC_CTRL.
        let kept = [0x3b, 0x277, 0xc000_0081, 0x4b56_4d01, 0xc000_0103, 0x1a0, 0x48];
        assert!(kept.iter().all(is_kept));
        let left_out = [0x10, 0xc1, 0x186, 0x480, 0x4000_0000, 0x4b56_4d07, 0xc001_0200];
        assert!(!left_out.iter().any(is_kept));
    }

    #[test]
    fn the_floating_point_units_are_new_and_said_to_be_there() {
        let mut xsave = kvm_xsave::default();
        xsave.region.fill(u32::MAX);
        xsave.region[128] = 4;
        set_floating_point(&mut xsave);
        assert_eq!((xsave.region[0], xsave.region[6], xsave.region[128]), (0x37f, 0x1f80, 7));
        assert_eq!(xsave.region[..128].iter().filter(|word| **word != 0).count(), 2);
    }

    #[test]
    fn ranges_go_up() {
        let left_out = LEFT_OUT.iter().map(|(range, _)| range);
        assert!(left_out.chain(&UNLISTED).all(|[first, last]| first <= last));
    }
}
