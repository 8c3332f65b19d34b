//! What guests are not told of the processor, because they need not have it.
//!
//! Nested virtualisation and performance counters are the largest parts of KVM that a guest could
//! reach and that neither kind of partition uses: the first is a second hypervisor inside of the first,
//! the second programs counters of the host that interrupt it, in windows of others too. KVM offers them
//! to a VMM that copies all that is supported. KVM goes by what a guest has been told, so what is not told is
//! refused: `nested_vmx_allowed`, `EFER.SVME` (`__kvm_valid_efer`), and the counters beyond AMD's
//! first four, which [`switch_counters_off`] takes.

use kvm_bindings::{CpuId, KVM_CAP_PMU_CAPABILITY, KVM_PMU_CAP_DISABLE, kvm_enable_cap};
use kvm_ioctls::{Error, VmFd};

/// Leaf 1, ECX: debug store areas (2, 4), VMX (5), SMX (6), performance capabilities (15).
const LEAF_1_ECX: u32 = 1 << 2 | 1 << 4 | 1 << 5 | 1 << 6 | 1 << 15;
/// Leaf 1, EDX: debug store.
const LEAF_1_EDX: u32 = 1 << 21;
/// Leaf 7, EBX: processor trace.
const LEAF_7_EBX: u32 = 1 << 25;
/// Leaf 7, EDX: architectural last branch records.
const LEAF_7_EDX: u32 = 1 << 19;
/// Leaf 7, first subleaf, EAX: the extended leaf about counters, 0x23.
const LEAF_7_1_EAX: u32 = 1 << 8;
/// Leaf 0x8000_0001, ECX: SVM (2), instruction based sampling (10), SKINIT (12), lightweight
/// profiling (15), core, data fabric and cache counters (23, 24, 28), last branch records (26).
const LEAF_AMD_ECX: u32 =
    1 << 2 | 1 << 10 | 1 << 12 | 1 << 15 | 1 << 23 | 1 << 24 | 1 << 26 | 1 << 28;
/// Leaves that only describe what is withheld: performance monitoring (0xa, 0x23), processor trace
/// (0x14), last branch records (0x1c), SVM (0x8000_000a), instruction based sampling (0x8000_001b),
/// performance monitoring of AMD's second version (0x8000_0022).
const LEAVES: [u32; 7] = [0xa, 0x14, 0x1c, 0x23, 0x8000_000a, 0x8000_001b, 0x8000_0022];

/// Takes nested virtualisation and performance counters out of what a guest is told. (Intel SDM
/// volume 2, CPUID; AMD64 Architecture Programmer's Manual volume 3, appendix E.)
pub fn withhold(cpuid: &mut CpuId) {
    for entry in cpuid.as_mut_slice() {
        match (entry.function, entry.index) {
            (1, _) => {
                entry.ecx &= !LEAF_1_ECX;
                entry.edx &= !LEAF_1_EDX;
            }
            (7, 0) => {
                entry.ebx &= !LEAF_7_EBX;
                entry.edx &= !LEAF_7_EDX;
            }
            (7, 1) => entry.eax &= !LEAF_7_1_EAX,
            (0x8000_0001, _) => entry.ecx &= !LEAF_AMD_ECX,
            (leaf, _) if LEAVES.contains(&leaf) => {
                (entry.eax, entry.ebx, entry.ecx, entry.edx) = (0, 0, 0, 0);
            }
            _ => {}
        }
    }
}

/// Has KVM refuse the performance counters of a machine that has no processor yet. AMD's first four
/// have no bit in CPUID. A KVM that does not know the switch (before 5.18) leaves these.
///
/// # Errors
/// What KVM says, but not that it has none to switch off.
pub fn switch_counters_off(vm: &VmFd) -> Result<(), Error> {
    let mut off = kvm_enable_cap { cap: KVM_CAP_PMU_CAPABILITY, ..Default::default() };
    off.args[0] = u64::from(KVM_PMU_CAP_DISABLE);
    match vm.enable_cap(&off) {
        Err(error) if error.errno() != libc::EINVAL => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use kvm_bindings::kvm_cpuid_entry2;

    #[test]
    fn nested_virtualisation_and_counters_are_withheld_and_nothing_else() {
        let leaf = |function, index| kvm_cpuid_entry2 {
            function,
            index,
            eax: u32::MAX,
            ebx: u32::MAX,
            ecx: u32::MAX,
            edx: u32::MAX,
            ..Default::default()
        };
        let leaves = [(1, 0), (7, 0), (7, 1), (7, 2), (0xa, 0), (0xd, 1), (0x14, 1)];
        let amd = [(0x8000_0001, 0), (0x8000_000a, 0), (0x8000_0022, 0), (0x8000_0008, 0)];
        let entries: Vec<_> = leaves.into_iter().chain(amd).map(|(f, i)| leaf(f, i)).collect();
        let mut cpuid = CpuId::from_entries(&entries).unwrap();
        withhold(&mut cpuid);
        let clear = |e: &kvm_cpuid_entry2| [e.eax, e.ebx, e.ecx, e.edx].map(u32::count_zeros);
        let taken: Vec<_> = cpuid.as_slice().iter().map(clear).collect();
        let all = [32; 4];
        assert_eq!(taken[0], [0, 0, 5, 1]);
        assert_eq!(taken[1..4], [[0, 1, 0, 1], [1, 0, 0, 0], [0; 4]]);
        assert_eq!(taken[4..7], [all, [0; 4], all]);
        assert_eq!(taken[7..], [[0, 0, 8, 0], all, all, [0; 4]]);
        assert_eq!(cpuid.as_slice()[0].ecx >> 5 & 1, 0, "VMX");
        assert_eq!(cpuid.as_slice()[7].ecx >> 2 & 1, 0, "SVM");
    }
}
