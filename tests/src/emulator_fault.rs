//! A fault of the emulator that is known and not healed, so that it is not taken for one of Takt's.
//!
//! With several CPUs QEMU now and then lets the emulated host take an interrupt right after VMRUN's exit, before STGI,
//! which no processor does. The host's kernel still has the guest's segments there, faults in the handler, and panics.
//! (docs/decisions/0012-qemu-takes-its-lock.md)

use crate::Outcome;

/// What `scripts/run` and `scripts/host` end with if the machine left no result.
const NO_RESULT: i32 = 3;

/// Runs a machine, and once more if QEMU's fault has ended it. Says so.
pub fn unless_qemu_failed(mut machine: impl FnMut() -> Outcome) -> Outcome {
    let first = machine();
    if !has_interrupted_vmrun(first.status, &first.output) {
        return first;
    }
    println!("QEMU interrupted the host between VMRUN and STGI; the machine is run again");
    machine()
}

/// Only if the host's panic names the interrupted instruction: anything else that ends a machine is a failure.
fn has_interrupted_vmrun(status: i32, output: &str) -> bool {
    let interrupted = output.split_once("sysvec_apic_timer_interrupt+").map(|(_, frames)| frames);
    let registers = interrupted.and_then(|frames| frames.split_once("RIP: 0010:"));
    status == NO_RESULT
        && output.contains("Kernel panic - not syncing")
        && registers.is_some_and(|(_, place)| place.starts_with("__svm_vcpu_run+"))
}

#[cfg(test)]
mod tests {
    use super::has_interrupted_vmrun;

    const FRAMES: &str = "  sysvec_apic_timer_interrupt+0xa/0x90\n  asm_sysvec_apic_timer_interrupt+0x16/0x20\n\
                          RIP: 0010:__svm_vcpu_run+0x9c/0x210 [kvm_amd]\nKernel panic - not syncing: Fatal\n";

    #[test]
    fn only_a_panic_of_an_interrupt_after_vmrun_is_qemus() {
        assert!(has_interrupted_vmrun(3, FRAMES));
        assert!(!has_interrupted_vmrun(4, FRAMES));
        assert!(!has_interrupted_vmrun(3, &FRAMES.replace("Kernel panic", "Kernel")));
        assert!(!has_interrupted_vmrun(3, &FRAMES.replace("__svm_vcpu_run", "kvm_vcpu_ioctl")));
        assert!(!has_interrupted_vmrun(3, "Kernel panic - not syncing: __svm_vcpu_run+"));
    }
}
