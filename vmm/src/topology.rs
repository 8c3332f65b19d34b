//! What a Linux is told of its processors, one by one.
//!
//! KVM hands on much of what the host's CPUID says of its own processor, cores and caches, which is another number of
//! them. Here all leaves that say how many processors there are, and which of them this is, say the same: one package,
//! in it a core for each processor, in each core one thread. The caches of the first two levels are a core's own. The
//! third is all cores': which host CPUs share theirs is not asked.
//!
//! The numbers of the interrupt controllers (APIC ids) are those of the processors, from 0. In the leaves they have so
//! many bits as the number of processors needs, so that fields for "how many numbers there may be" hold a power of two.

use kvm_bindings::{CpuId, KVM_CPUID_FLAG_SIGNIFCANT_INDEX, kvm_cpuid_entry2};
use takt_plan::PROCESSORS_MAX;

// Fields of leaf 4 have six bits for cores, and each number needs an entry in ACPI's table.
const _: () = assert!(PROCESSORS_MAX <= 64);

/// First word of the vendor's name in leaf 0, "Genu". All others describe themselves as AMD does.
const INTEL: u32 = 0x756e_6547;
/// Subleaves with the topology, level by level. The newer leaf 0x1f comes first for those that know it; AMD's own for
/// that is left out.
const LEVELS: [u32; 2] = [0xb, 0x1f];
const AMD_LEVELS: u32 = 0x8000_0026;

/// Makes the leaves about processors those of processor `number` of `count`. (Intel SDM volume 2, CPUID; AMD64 Architecture
/// Programmer's Manual volume 3, appendix E.) `None` if there is no room for them.
#[must_use]
pub fn describe(cpuid: &mut CpuId, number: u32, count: u32) -> Option<()> {
    let numbers = count.next_power_of_two();
    let bits = numbers.trailing_zeros();
    let several = u32::from(count > 1);
    let leaf_0 = cpuid.as_slice().iter().find(|entry| entry.function == 0);
    let (last, intel) = leaf_0.map_or((0, false), |entry| (entry.eax, entry.ebx == INTEL));
    for entry in cpuid.as_mut_slice() {
        // Processors that share a cache, less one.
        let sharing = |eax: u32| if eax >> 5 & 7 < 3 { 0 } else { numbers - 1 };
        match entry.function {
            1 => {
                entry.ebx = entry.ebx & 0x0000_ffff | number << 24 | numbers << 16;
                entry.edx = entry.edx & !(1 << 28) | several << 28;
            }
            // A cache type of 0 is the end of the list.
            4 if entry.eax & 0x1f != 0 => {
                entry.eax = entry.eax & 0x3fff | sharing(entry.eax) << 14 | (numbers - 1) << 26;
            }
            0x8000_0001 if !intel => entry.ecx = entry.ecx & !2 | several << 1,
            0x8000_0008 if !intel => entry.ecx = bits << 12 | (count - 1),
            0x8000_001d if entry.eax & 0x1f != 0 => {
                entry.eax = entry.eax & 0x3fff | sharing(entry.eax) << 14;
            }
            // One thread in the core, one node in the package.
            0x8000_001e => (entry.eax, entry.ebx, entry.ecx) = (number, number, 0),
            _ => {}
        }
    }
    cpuid.retain(|entry| !LEVELS.contains(&entry.function) && entry.function != AMD_LEVELS);
    // The threads of a core, the cores of the package, and the end of the list.
    let levels = [(0, 1, 1 << 8), (bits, count, 2 << 8 | 1), (0, 0, 2)];
    for function in LEVELS.into_iter().filter(|leaf| *leaf <= last) {
        for (index, (eax, ebx, ecx)) in (0..).zip(levels) {
            let flags = KVM_CPUID_FLAG_SIGNIFCANT_INDEX;
            let (edx, padding) = (number, [0; 3]);
            let entry = kvm_cpuid_entry2 { function, index, flags, eax, ebx, ecx, edx, padding };
            cpuid.push(entry).ok()?;
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(vendor: u32, last: u32) -> CpuId {
        let entry = |function, index, eax, ebx| kvm_cpuid_entry2 {
            function,
            index,
            eax,
            ebx,
            ecx: 0xffff_ffff,
            edx: 0x1000_0007,
            ..Default::default()
        };
        let entries = [
            entry(0, 0, last, vendor),
            entry(1, 0, 0x306c3, 0x0710_0800),
            // Level 1 data, level 2, level 3, no more; of a host with 16 processors.
            entry(4, 0, 7 << 26 | 1 << 14 | 0x121, 9),
            entry(4, 1, 7 << 26 | 1 << 14 | 0x143, 9),
            entry(4, 2, 7 << 26 | 15 << 14 | 0x163, 9),
            entry(4, 3, 0, 0),
            entry(0xb, 0, 1, 2),
            entry(0xb, 1, 4, 16),
            entry(0x8000_0001, 0, 0, 0),
            entry(0x8000_0008, 0, 0x3030, 0),
            entry(0x8000_001d, 3, 15 << 14 | 0x163, 9),
            entry(0x8000_001e, 0, 7, 0x107),
            entry(0x8000_0026, 0, 1, 2),
        ];
        CpuId::from_entries(&entries).unwrap()
    }

    fn told(vendor: u32, last: u32, number: u32, count: u32) -> impl Fn(u32, u32) -> [u32; 4] {
        let mut cpuid = host(vendor, last);
        describe(&mut cpuid, number, count).unwrap();
        move |leaf, index| {
            let all = cpuid.as_slice().iter();
            let mut found = all.filter(|e| e.function == leaf && e.index == index);
            let entry = found.next().map_or([0; 4], |e| [e.eax, e.ebx, e.ecx, e.edx]);
            assert!(found.next().is_none(), "leaf {leaf:#x} is there twice");
            entry
        }
    }

    #[test]
    fn all_leaves_say_the_same_of_a_processor() {
        for (number, count, numbers, bits) in
            [(0, 1, 1, 0), (0, 2, 2, 1), (1, 2, 2, 1), (2, 3, 4, 2), (5, 6, 8, 3), (63, 64, 64, 6)]
        {
            let leaf = told(INTEL, 0x1f, number, count);
            let [_, ebx, _, edx] = leaf(1, 0);
            assert_eq!((ebx >> 24, ebx >> 16 & 0xff, ebx & 0xffff), (number, numbers, 0x0800));
            assert_eq!(edx, if count > 1 { 0x1000_0007 } else { 7 }, "hyper-threading");
            let caches = [0, 1, 2].map(|index| leaf(4, index)[0]);
            assert_eq!(caches.map(|eax| eax >> 26), [numbers - 1; 3]);
            assert_eq!(caches.map(|eax| eax >> 14 & 0xfff), [0, 0, numbers - 1]);
            assert_eq!(caches.map(|eax| eax & 0x3fff), [0x121, 0x143, 0x163]);
            assert_eq!(leaf(4, 3)[0], 0);
            for levels in LEVELS {
                assert_eq!(leaf(levels, 0), [0, 1, 0x100, number]);
                assert_eq!(leaf(levels, 1), [bits, count, 0x201, number]);
                assert_eq!(leaf(levels, 2), [0, 0, 2, number]);
            }
            assert_eq!(leaf(0x8000_0001, 0)[2], u32::MAX, "a bit of AMD's");
        }
    }

    #[test]
    fn amd_s_own_leaves_agree() {
        let leaf = told(0x6874_7541, 0xa, 2, 3);
        assert_eq!(leaf(0x8000_0001, 0)[2] & 2, 2);
        assert_eq!(leaf(0x8000_0008, 0), [0x3030, 0, 2 << 12 | 2, 0x1000_0007]);
        assert_eq!(leaf(0x8000_001d, 3)[0], 3 << 14 | 0x163);
        assert_eq!(leaf(0x8000_001e, 0)[..3], [2, 2, 0]);
        assert_eq!(leaf(0x8000_0026, 0), [0; 4]);
        // This one has no leaf 0xb, as its leaf 0 says.
        assert_eq!(leaf(0xb, 1), [0; 4]);
        let one = told(0x6874_7541, 0xa, 0, 1);
        assert_eq!((one(0x8000_0001, 0)[2] & 2, one(0x8000_0008, 0)[2]), (0, 0));
    }
}
