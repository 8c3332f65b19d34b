//! A device's memory in Takt's address space, from where it goes into a guest.
//!
//! Takt itself only writes safe values there. It never reads: reading a register can change the
//! device. That is why this memory is none of the regions of
//! [`GuestMemory`](crate::memory::GuestMemory), all of which are touched before a guest starts.

use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::ptr;

use kvm_bindings::kvm_userspace_memory_region;
use kvm_ioctls::VmFd;

use crate::memory::MemoryError;
use crate::vcpu::port_access::Width;

/// Slots from here on are for devices: far above those of any guest's memory, and below KVM's own
/// limit (`KVM_USER_MEM_SLOTS` in the kernel's `include/linux/kvm_host.h`: 32764).
const FIRST_SLOT: u32 = 1024;

/// Memory of a device.
#[derive(Debug)]
pub struct Mapping {
    start: *mut u8,
    bytes: usize,
}

// SAFETY: the pointer is to a mapping that this value owns and that any thread may use; all access
// is volatile, and devices are made for accesses in any order.
unsafe impl Send for Mapping {}
// SAFETY: as above.
unsafe impl Sync for Mapping {}

impl Mapping {
    /// Maps `bytes` of a file, from `offset` on.
    ///
    /// # Errors
    /// What `mmap` says.
    pub fn new(file: &File, offset: u64, bytes: u64) -> io::Result<Self> {
        let too_large = |_| io::Error::from_raw_os_error(libc::EOVERFLOW);
        let bytes = usize::try_from(bytes).map_err(too_large)?;
        let offset = libc::off_t::try_from(offset).map_err(too_large)?;
        // SAFETY: a new mapping at an address of the kernel's choice replaces no other.
        let start = unsafe {
            let rights = libc::PROT_READ | libc::PROT_WRITE;
            libc::mmap(ptr::null_mut(), bytes, rights, libc::MAP_SHARED, file.as_raw_fd(), offset)
        };
        if start == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        Ok(Self { start: start.cast(), bytes })
    }

    /// Lets a guest use it at a guest-physical address. It must be kept for as long as the guest.
    ///
    /// # Errors
    /// [`MemoryError::Slot`].
    pub fn map_into(&self, vm: &VmFd, index: u32, address: u64) -> Result<(), MemoryError> {
        let slot = kvm_userspace_memory_region {
            slot: FIRST_SLOT + index,
            flags: 0,
            guest_phys_addr: address,
            memory_size: self.bytes as u64,
            userspace_addr: self.start as u64,
        };
        // SAFETY: the slot names exactly this mapping. The guest, which its thread keeps beside
        // the vCPU, has a reference to it.
        unsafe { vm.set_user_memory_region(slot) }
            .map_err(|source| MemoryError::Slot { address, source })
    }

    /// Writes a register. What does not lie wholly inside, or at no multiple of its width, is not
    /// written.
    pub fn write(&self, offset: u64, width: Width, value: u32) {
        let Ok(offset) = usize::try_from(offset) else { return };
        let inside = offset.checked_add(width.bytes()).is_some_and(|end| end <= self.bytes);
        if !inside || !offset.is_multiple_of(width.bytes()) {
            return;
        }
        // SAFETY: inside the mapping, which lives as long as `self` and starts at a page, and
        // aligned (both checked). There are no references into it.
        unsafe {
            let register = self.start.add(offset);
            match width {
                Width::One => register.write_volatile(value as u8),
                Width::Two => register.cast::<u16>().write_volatile(value as u16),
                Width::Four => register.cast::<u32>().write_volatile(value),
            }
        }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the mapping is this value's own, and no reference leads into it. A failure
        // leaves it mapped, which does no harm.
        unsafe { libc::munmap(self.start.cast(), self.bytes) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::FileExt;

    /// A file of one page, and its mapping.
    fn page() -> (File, Mapping) {
        let path =
            std::env::temp_dir().join(format!("takt-mapping-{:?}", std::thread::current().id()));
        let mut options = File::options();
        let file = options.read(true).write(true).create(true).truncate(true).open(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        file.set_len(4096).unwrap();
        let mapping = Mapping::new(&file, 0, 4096).unwrap();
        (file, mapping)
    }

    #[test]
    fn a_register_is_written_with_its_width() {
        let (file, mapping) = page();
        mapping.write(0, Width::Four, 0x4433_2211);
        mapping.write(6, Width::Two, 0xffff_6655);
        mapping.write(4095, Width::One, 0x77);
        let mut seen = [0; 8];
        file.read_exact_at(&mut seen, 0).unwrap();
        assert_eq!(seen, [0x11, 0x22, 0x33, 0x44, 0, 0, 0x55, 0x66]);
        file.read_exact_at(&mut seen[..1], 4095).unwrap();
        assert_eq!(seen[0], 0x77);
    }

    #[test]
    fn nothing_is_written_outside_or_across() {
        let (file, mapping) = page();
        for (offset, width) in [
            (4096, Width::One),
            (4095, Width::Two),
            (4093, Width::Four),
            (1, Width::Two),
            (2, Width::Four),
            (u64::MAX, Width::One),
            (u64::MAX - 1, Width::Four),
        ] {
            mapping.write(offset, width, u32::MAX);
        }
        let mut seen = [0; 4096];
        file.read_exact_at(&mut seen, 0).unwrap();
        assert!(seen.iter().all(|byte| *byte == 0));
    }
}
