//! Memory of the function, for writes of any width to any place.

#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::ptr;

/// A mapped file, to the end of the process.
pub struct Bar {
    start: *mut u8,
    bytes: u64,
}

impl Bar {
    /// For reading only.
    pub fn readable(path: &Path) -> io::Result<Bar> {
        Self::map(&File::open(path)?, libc::PROT_READ)
    }

    /// For reading and writing.
    pub fn writable(path: &Path) -> io::Result<Bar> {
        let file = OpenOptions::new().read(true).write(true).open(path)?;
        Self::map(&file, libc::PROT_READ | libc::PROT_WRITE)
    }

    fn map(file: &File, access: i32) -> io::Result<Bar> {
        let bytes = file.metadata()?.len();
        let length = usize::try_from(bytes).map_err(io::Error::other)?;
        // SAFETY: a new mapping at an address of the kernel's choice replaces nothing.
        let start = unsafe {
            libc::mmap(ptr::null_mut(), length, access, libc::MAP_SHARED, file.as_raw_fd(), 0)
        };
        if start == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        Ok(Bar { start: start.cast(), bytes })
    }

    /// Length in bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Eight bytes; 0 outside.
    pub fn load(&self, at: u64) -> u64 {
        let Some(at) = self.inside(at, 8) else { return 0 };
        // SAFETY: inside the mapping, which stays to the end of the process; nothing in this process
        // holds references into it.
        unsafe { self.start.add(at).cast::<u64>().read_unaligned() }
    }

    /// The low 1, 2, 4 or 8 bytes of `value`; nothing outside or of another width.
    pub fn store(&self, at: u64, bytes: u64, value: u64) {
        let Some(at) = self.inside(at, bytes) else { return };
        // SAFETY: inside the mapping, as above. That the writes destroy what other programs have
        // there is what this one is for. One instruction each, hence inline assembly: a volatile
        // write must be aligned.
        unsafe {
            let to = self.start.add(at);
            match bytes {
                1 => std::arch::asm!("mov [{}], {}", in(reg) to, in(reg_byte) value as u8),
                2 => std::arch::asm!("mov [{}], {:x}", in(reg) to, in(reg) value as u16),
                4 => std::arch::asm!("mov [{}], {:e}", in(reg) to, in(reg) value as u32),
                8 => std::arch::asm!("mov [{}], {}", in(reg) to, in(reg) value),
                _ => {}
            }
        }
    }

    fn inside(&self, at: u64, bytes: u64) -> Option<usize> {
        let end = at.checked_add(bytes)?;
        if end <= self.bytes { usize::try_from(at).ok() } else { None }
    }
}
