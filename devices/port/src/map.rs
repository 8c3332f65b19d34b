//! A part of the function's memory, mapped.
//!
//! Linux maps `resource1` and `resource2` as uncached, which costs time on processors that respect
//! what a guest says of its memory, but keeps stores in order. The `_wc` files beside them would be
//! faster there and wrong: write combining reorders stores, and the channels depend on their order.

#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::os::fd::AsRawFd;
use std::path::Path;
use std::ptr::{self, NonNull};

use takt_channel::{OwnPages, PeerPages};

use crate::error::PortsError;
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
    /// Maps all of a file for reading.
    pub(crate) fn readable(path: &Path) -> Result<Map, PortsError> {
        Self::new(path, File::open(path), libc::PROT_READ)
    }

    /// Maps all of a file for reading and writing.
    pub(crate) fn writable(path: &Path) -> Result<Map, PortsError> {
        let file = OpenOptions::new().read(true).write(true).open(path);
        Self::new(path, file, libc::PROT_READ | libc::PROT_WRITE)
    }

    fn new(path: &Path, file: std::io::Result<File>, access: i32) -> Result<Map, PortsError> {
        let failed = |doing, source| PortsError::File { doing, path: path.to_owned(), source };
        let file = file.map_err(|error| failed("open", error))?;
        let bytes = file.metadata().map_err(|error| failed("look at", error))?.len();
        let bytes = usize::try_from(bytes).unwrap_or(0);
        // SAFETY: a new mapping at an address of the kernel's choice replaces nothing.
        let start = unsafe {
            libc::mmap(ptr::null_mut(), bytes, access, libc::MAP_SHARED, file.as_raw_fd(), 0)
        };
        match NonNull::new(start.cast()) {
            Some(start) if start.as_ptr() != libc::MAP_FAILED.cast() => Ok(Map { start, bytes }),
            _ => Err(failed("map", std::io::Error::last_os_error())),
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
