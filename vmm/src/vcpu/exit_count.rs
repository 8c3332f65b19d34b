//! KVM's own counts of a vCPU's exits and of the interrupts that it has injected.
//!
//! A thread sees only those exits that KVM cannot answer by itself. A host interrupt is none of
//! them: it takes the processor out of the guest, and the guest goes on later, without a trace. KVM
//! counts it all the same. So the count, read at the end of each window, tells windows in which
//! the guest had the processor to itself from those in which it had not.
//!
//! The count comes from the binary statistics of the vCPU (`KVM_GET_STATS_FD`, 4.131 in
//! `Documentation/virt/kvm/api.rst`): a descriptor to read from, with a header and a description of
//! each value. Where the value lies never changes, so it is looked up once, and from then on one
//! `pread` gives it. debugfs has the same number, but only for those who may mount it.

use std::fs::File;
use std::os::fd::FromRawFd;
use std::os::unix::fs::FileExt;

use kvm_ioctls::VcpuFd;
use vmm_sys_util::ioctl::ioctl;

/// The statistic that counts all exits, on x86 (`arch/x86/kvm/x86.c`, `kvm_vcpu_stats_desc`).
const NAME: &[u8] = b"exits";
/// The one that counts injected interrupts, where KVM injects them.
const INJECTIONS: &[u8] = b"irq_injections";
/// Length of `struct kvm_stats_header`.
const HEADER_LEN: usize = 24;
/// Length of `struct kvm_stats_desc` without the name that follows it.
const DESCRIPTOR_LEN: usize = 16;
/// Most bytes of descriptors that are read. Linux has about 60 of 64 bytes.
const DESCRIPTORS_MAX: usize = 1 << 18;

/// kvm-ioctls does not know this call.
mod request {
    use kvm_bindings::KVMIO;

    vmm_sys_util::ioctl_io_nr!(KVM_GET_STATS_FD, KVMIO, 0xce);
}

/// Reads how often a vCPU's guest was left.
#[derive(Debug)]
pub struct ExitCount {
    statistics: File,
    offset: u64,
    injections: Option<u64>,
}

impl ExitCount {
    /// Finds the count of a vCPU; `None` if this host's KVM does not offer it, as before Linux
    /// 5.14. Allocates.
    #[must_use]
    pub fn of(vcpu: &VcpuFd) -> Option<ExitCount> {
        // SAFETY: the call has no argument, touches no memory of this process, and fails on a
        // kernel that does not know it.
        let fd = unsafe { ioctl(vcpu, request::KVM_GET_STATS_FD()) };
        if fd < 0 {
            return None;
        }
        // SAFETY: the descriptor is new and has no other owner.
        let statistics = unsafe { File::from_raw_fd(fd) };
        let mut header = [0; HEADER_LEN];
        statistics.read_exact_at(&mut header, 0).ok()?;
        let layout = Layout::of(&header)?;
        let mut descriptors = vec![0; layout.descriptors_len];
        statistics.read_exact_at(&mut descriptors, layout.descriptors).ok()?;
        let offset = layout.offset_of(NAME, &descriptors)?;
        let injections = layout.offset_of(INJECTIONS, &descriptors);
        let this = ExitCount { statistics, offset, injections };
        // A count that cannot be read is none.
        this.read().map(|_| this)
    }

    /// Exits so far; `None` if KVM cannot be read. One system call; does not allocate.
    #[must_use]
    pub fn read(&self) -> Option<u64> {
        self.read_at(self.offset)
    }

    /// Interrupts that KVM has injected so far; `None` if it does not tell. One system call; does not
    /// allocate.
    #[must_use]
    pub fn injections(&self) -> Option<u64> {
        self.read_at(self.injections?)
    }

    fn read_at(&self, offset: u64) -> Option<u64> {
        let mut count = [0; 8];
        self.statistics.read_exact_at(&mut count, offset).ok()?;
        Some(u64::from_ne_bytes(count))
    }
}

/// Where things are in the statistics, as their header says.
#[derive(Debug, PartialEq, Eq)]
struct Layout {
    /// Length of one descriptor, its name included.
    descriptor_len: usize,
    descriptors: u64,
    descriptors_len: usize,
    data: u64,
}

impl Layout {
    /// Reads `struct kvm_stats_header`; `None` if no host would mean it.
    fn of(header: &[u8; HEADER_LEN]) -> Option<Layout> {
        // flags, name_size, num_desc, id_offset, desc_offset, data_offset: 32 bits each.
        let [_, name_len, count, _, descriptors, data] =
            [0, 4, 8, 12, 16, 20].map(|at| u32_at(header, at).unwrap_or(0));
        let descriptor_len = DESCRIPTOR_LEN.checked_add(usize::try_from(name_len).ok()?)?;
        let descriptors_len = descriptor_len.checked_mul(usize::try_from(count).ok()?)?;
        (name_len > 0 && descriptors_len <= DESCRIPTORS_MAX).then_some(Layout {
            descriptor_len,
            descriptors: descriptors.into(),
            descriptors_len,
            data: data.into(),
        })
    }

    /// Where in the file the single value of this name lies.
    fn offset_of(&self, name: &[u8], descriptors: &[u8]) -> Option<u64> {
        descriptors.chunks_exact(self.descriptor_len).find_map(|descriptor| {
            // flags: u32, exponent: i16, size: u16, offset: u32, bucket_size: u32, name.
            let size = u16::from_ne_bytes(descriptor.get(6..8)?.try_into().ok()?);
            let offset = u32_at(descriptor, 8)?;
            let its_name = descriptor.get(DESCRIPTOR_LEN..)?.split(|byte| *byte == 0).next()?;
            (its_name == name && size == 1).then(|| self.data + u64::from(offset))
        })
    }
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_ne_bytes(bytes.get(at..)?.first_chunk().copied()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use kvm_bindings::{kvm_regs, kvm_userspace_memory_region};
    use kvm_ioctls::{Kvm, VcpuExit};
    use vm_memory::{Bytes, GuestAddress, GuestMemoryBackend, GuestMemoryMmap};

    fn header(name_len: u32, count: u32) -> [u8; HEADER_LEN] {
        let fields = [0, name_len, count, 24, 72, 4096];
        let bytes: Vec<u8> = fields.iter().flat_map(|f: &u32| f.to_ne_bytes()).collect();
        bytes.try_into().unwrap()
    }

    fn descriptor(name: &[u8; 8], size: u16, offset: u32) -> Vec<u8> {
        let mut bytes = vec![0; 6];
        bytes.extend(size.to_ne_bytes());
        bytes.extend(offset.to_ne_bytes());
        bytes.extend([0; 4]);
        bytes.extend(name);
        bytes
    }

    #[test]
    fn the_value_is_found_by_its_whole_name() {
        let layout = Layout::of(&header(8, 4)).unwrap();
        assert_eq!((layout.descriptors, layout.descriptors_len), (72, 96));
        let descriptors = [
            descriptor(b"exits\0\0\0", 32, 0),
            descriptor(b"io_exits", 1, 8),
            descriptor(b"exits_x\0", 1, 16),
            descriptor(b"exits\0x\0", 1, 24),
        ]
        .concat();
        assert_eq!(layout.offset_of(b"exits", &descriptors), Some(4096 + 24));
        assert_eq!(layout.offset_of(b"io_exits", &descriptors), Some(4096 + 8));
        assert_eq!(layout.offset_of(b"exit", &descriptors), None);
        assert_eq!(layout.offset_of(b"", &descriptors), None);
    }

    #[test]
    fn a_header_that_cannot_be_is_refused() {
        assert_eq!(Layout::of(&header(0, 4)), None);
        assert_eq!(Layout::of(&header(u32::MAX, 1)), None);
        assert_eq!(Layout::of(&header(48, u32::MAX)), None);
        assert_eq!(Layout::of(&header(u32::MAX, u32::MAX)), None);
        assert!(Layout::of(&header(48, 4096)).is_some());
        assert_eq!(Layout::of(&header(48, 4097)), None);
    }

    #[test]
    fn truncated_descriptors_have_nothing_behind_their_end() {
        let layout = Layout::of(&header(8, 1)).unwrap();
        let whole = descriptor(b"exits\0\0\0", 1, u32::MAX);
        assert_eq!(layout.offset_of(NAME, &whole), Some(4096 + u64::from(u32::MAX)));
        for len in 0..whole.len() {
            assert_eq!(layout.offset_of(NAME, &whole[..len]), None, "{len}");
        }
        // A name that fills its place has no zero behind it.
        assert!(layout.offset_of(b"12345678", &descriptor(b"12345678", 1, 0)).is_some());
    }

    /// A guest in real mode that writes a port three times and halts.
    #[test]
    fn kvm_counts_at_least_the_exits_that_come_here() {
        let Ok(kvm) = Kvm::new() else {
            eprintln!("skipped: no /dev/kvm");
            return;
        };
        let memory = GuestMemoryMmap::<()>::from_ranges(&[(GuestAddress(0), 0x1000)]).unwrap();
        // out 0x10, al (three times); hlt
        memory.write_slice(&[0xe6, 0x10, 0xe6, 0x10, 0xe6, 0x10, 0xf4], GuestAddress(0)).unwrap();
        let vm = kvm.create_vm().unwrap();
        let region = kvm_userspace_memory_region {
            memory_size: 0x1000,
            userspace_addr: memory.get_host_address(GuestAddress(0)).unwrap() as u64,
            ..Default::default()
        };
        // SAFETY: the region is a live mapping of that size, dropped after the virtual machine.
        unsafe { vm.set_user_memory_region(region) }.unwrap();
        let mut vcpu = vm.create_vcpu(0).unwrap();
        let mut sregs = vcpu.get_sregs().unwrap();
        (sregs.cs.base, sregs.cs.selector) = (0, 0);
        vcpu.set_sregs(&sregs).unwrap();
        vcpu.set_regs(&kvm_regs { rflags: 2, ..Default::default() }).unwrap();

        let Some(count) = ExitCount::of(&vcpu) else {
            eprintln!("skipped: this KVM has no binary statistics");
            return;
        };
        let before = count.read().unwrap();
        for n in 1..=3 {
            assert!(matches!(vcpu.run().unwrap(), VcpuExit::IoOut(0x10, _)));
            assert!(count.read().unwrap() >= before + n);
        }
        assert!(matches!(vcpu.run().unwrap(), VcpuExit::Hlt));
        eprintln!("4 exits here, {} in all", count.read().unwrap() - before);
    }
}
