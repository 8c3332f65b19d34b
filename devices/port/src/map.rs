//! A part of the function's memory, mapped.
//!
//! Linux maps `resource1` and `resource2` as uncached. On processors that respect what a guest says of its memory
//! (AMD's) each access then goes to memory. The function's memory is plain memory of the host, so it is
//! mapped by its physical address instead, which Linux does cached as the memory types of the machine say
//! (`/dev/mem`, drivers/char/mem.c); if the kernel does not allow that, as under lockdown, it is mapped
//! uncached. Both keep stores in order. The `_wc` files would not: write combining reorders stores, and the channels
//! depend on their order.

#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::ptr::{self, NonNull};

use takt_channel::{OwnPages, PeerPages};

use crate::error::PortsError;
use crate::function;
use crate::table::Region;

/// A mapped file, for as long as this value lives. It is handed out as atomics only.
#[derive(Debug)]
pub(crate) struct Map {
    start: NonNull<u8>,
    bytes: usize,
}

// SAFETY: the mapping belongs to the process, not to a thread, and is used through atomics only.
unsafe impl Send for Map {}
// SAFETY: as above.
unsafe impl Sync for Map {}

impl Map {
    /// Maps all of a region of the function in this folder, for reading.
    pub(crate) fn readable(function: &Path, region: usize) -> Result<Map, PortsError> {
        Self::new(function, region, OpenOptions::new().read(true), libc::PROT_READ)
    }

    /// Maps all of a region of the function in this folder, for reading and writing.
    pub(crate) fn writable(function: &Path, region: usize) -> Result<Map, PortsError> {
        let access = libc::PROT_READ | libc::PROT_WRITE;
        Self::new(function, region, OpenOptions::new().read(true).write(true), access)
    }

    fn new(
        function: &Path,
        region: usize,
        options: &OpenOptions,
        access: i32,
    ) -> Result<Map, PortsError> {
        let path = function.join(format!("resource{region}"));
        let failed = |doing, source| PortsError::File { doing, path: path.clone(), source };
        let file = options.open(&path).map_err(|error| failed("open", error))?;
        let bytes = file.metadata().map_err(|error| failed("look at", error))?.len();
        if let Some(memory) = function::region(function, region).filter(|m| m.bytes == bytes) {
            let cached = options.open("/dev/mem").and_then(|all| Self::of(&all, memory, access));
            if let Ok(cached) = cached {
                return Ok(cached);
            }
        }
        let whole = Region { offset: 0, bytes };
        Self::of(&file, whole, access).map_err(|error| failed("map", error))
    }

    fn of(file: &File, part: Region, access: i32) -> io::Result<Map> {
        let out_of_range = |_| io::Error::from(io::ErrorKind::InvalidInput);
        let bytes = usize::try_from(part.bytes).map_err(out_of_range)?;
        let offset = libc::off_t::try_from(part.offset).map_err(out_of_range)?;
        // SAFETY: a new mapping at an address of the kernel's choice replaces nothing.
        let start = unsafe {
            libc::mmap(ptr::null_mut(), bytes, access, libc::MAP_SHARED, file.as_raw_fd(), offset)
        };
        match NonNull::new(start.cast()) {
            Some(start) if start.as_ptr() != libc::MAP_FAILED.cast() => Ok(Map { start, bytes }),
            _ => Err(io::Error::last_os_error()),
        }
    }

    /// Length in bytes.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes as u64
    }

    /// All of it, to look at.
    pub(crate) fn whole(&self) -> Option<PeerPages<'_>> {
        self.peer(Region { offset: 0, bytes: self.bytes() })
    }

    /// A region that this partition writes; `None` if it is not within the mapping. Only a map
    /// that is [`writable`](Self::writable) has such regions.
    pub(crate) fn own(&self, region: Region) -> Option<OwnPages<'_>> {
        let (start, bytes) = self.part(region)?;
        // SAFETY: within the mapping, which outlives the result and, by the caller's choice of
        // constructor, can be written; this type gives it away as atomics only.
        unsafe { OwnPages::new(start, bytes) }.ok()
    }

    /// A region to look at; `None` if it is not within the mapping.
    pub(crate) fn peer(&self, region: Region) -> Option<PeerPages<'_>> {
        let (start, bytes) = self.part(region)?;
        // SAFETY: within the mapping, which outlives the result; this type gives it away as
        // atomics only.
        unsafe { PeerPages::new(start, bytes) }.ok()
    }

    fn part(&self, region: Region) -> Option<(NonNull<u8>, usize)> {
        let end = region.offset.checked_add(region.bytes)?;
        if end > self.bytes() {
            return None;
        }
        let offset = usize::try_from(region.offset).ok()?;
        // SAFETY: the offset is within the mapping, or at its end.
        Some((unsafe { self.start.add(offset) }, usize::try_from(region.bytes).ok()?))
    }
}

impl Drop for Map {
    fn drop(&mut self) {
        // SAFETY: this is the whole mapping that `new` made, and nothing borrows it any more.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.bytes) };
    }
}
