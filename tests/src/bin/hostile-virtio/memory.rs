//! Memory as a driver has it: pages whose physical addresses are known, and registers of a device.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::FileExt;
use std::ptr::{self, NonNull};

/// Bytes of a page.
pub const PAGE: u64 = 4096;

/// A mapped page, for as long as the program runs.
#[derive(Clone, Copy, Debug)]
pub struct Page {
    at: NonNull<u8>,
    /// Where it is in the machine's memory.
    pub physical: u64,
}

impl Page {
    /// A page of memory that stays where it is.
    ///
    /// # Errors
    /// None is to be had, or the kernel does not say where it is: that takes root (kernel,
    /// `Documentation/admin-guide/mm/pagemap.rst`).
    pub fn of_memory() -> io::Result<Self> {
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_LOCKED | libc::MAP_POPULATE;
        let at = map(flags, -1, 0)?;
        let mut entry = [0; 8];
        let pagemap = File::open("/proc/self/pagemap")?;
        pagemap.read_exact_at(&mut entry, at.addr().get() as u64 / PAGE * 8)?;
        let frame = u64::from_le_bytes(entry) & ((1 << 55) - 1);
        if frame == 0 {
            return Err(io::ErrorKind::PermissionDenied.into());
        }
        Ok(Self { at, physical: frame * PAGE })
    }

    /// The registers of a virtio device, by the name that ACPI gives it.
    ///
    /// # Errors
    /// There is none, or its driver still has it.
    pub fn of_registers(slot: u64) -> io::Result<Self> {
        let map_of_memory = fs::read_to_string("/proc/iomem")?;
        let name = format!("LNRO0005:{slot:02x}");
        let line = map_of_memory.lines().find(|line| line.contains(&name));
        let first = line.and_then(|line| line.trim().split('-').next());
        let first = first.and_then(|first| u64::from_str_radix(first, 16).ok());
        let first = first.ok_or(io::ErrorKind::NotFound)?;
        let memory = OpenOptions::new().read(true).write(true).open("/dev/mem")?;
        let at = map(libc::MAP_SHARED, memory.as_raw_fd(), first as i64)?;
        Ok(Self { at, physical: first })
    }

    /// Reads `T` at a multiple of its size.
    pub fn load<T: Copy>(&self, offset: u64) -> T {
        // SAFETY: `place` is within a page that stays mapped, and aligned; numbers have no wrong bits.
        unsafe { self.place::<T>(offset).read_volatile() }
    }

    /// Writes `T` at a multiple of its size.
    pub fn store<T: Copy>(&self, offset: u64, value: T) {
        // SAFETY: as above. Nothing else refers to the page, but the device.
        unsafe { self.place::<T>(offset).write_volatile(value) }
    }

    fn place<T>(&self, offset: u64) -> *mut T {
        let bytes = size_of::<T>() as u64;
        assert!(offset.is_multiple_of(bytes) && offset + bytes <= PAGE, "{offset:#x}");
        self.at.as_ptr().wrapping_add(offset as usize).cast()
    }
}

fn map(flags: i32, descriptor: i32, offset: i64) -> io::Result<NonNull<u8>> {
    let access = libc::PROT_READ | libc::PROT_WRITE;
    // SAFETY: a new mapping, which takes the place of none.
    let at =
        unsafe { libc::mmap(ptr::null_mut(), PAGE as usize, access, flags, descriptor, offset) };
    if at == libc::MAP_FAILED {
        return Err(io::Error::last_os_error());
    }
    NonNull::new(at.cast()).ok_or_else(|| io::ErrorKind::AddrNotAvailable.into())
}
