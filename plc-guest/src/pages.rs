//! The two pages that a partition shares with Takt ([`Information`] and [`Status`]).
//!
//! No reference to either is ever made: the host writes one and reads the other whenever the vCPU
//! is outside guest mode, which can be between any two instructions. All access is volatile, field
//! by field, and a snapshot is checked for having been taken in one piece.

use core::ptr::{read_volatile, write_volatile};
use takt_abi::{Exception, Information, Status, memory};

const INFORMATION: *const Information = memory::INFORMATION as *const Information;
const STATUS: *mut Status = memory::STATUS as *mut Status;

/// Address of [`Information::release_tsc`], for the loop that waits on it.
pub(crate) const RELEASE_TSC: *const u64 =
    (memory::INFORMATION as usize + core::mem::offset_of!(Information, release_tsc)) as *const u64;

/// Address of [`Information::release`], for code that can call nothing.
pub const RELEASE: usize =
    memory::INFORMATION as usize + core::mem::offset_of!(Information, release);

/// A consistent copy of the partition information page.
///
/// The host may kick the vCPU out in the middle of the copy and write the page for the next
/// window. [`Information::release`] never takes the same value twice, so a copy that begins and
/// ends with the same one is whole.
#[must_use]
pub fn information() -> Information {
    loop {
        // SAFETY: the host provides the page as read-only memory at this address and `boot` maps
        // it; every bit pattern is a valid `Information`.
        let (before, copy, after) = unsafe {
            let before = read_volatile(&raw const (*INFORMATION).release);
            let copy = read_volatile(INFORMATION);
            let after = read_volatile(&raw const (*INFORMATION).release);
            (before, copy, after)
        };
        if before == copy.release && copy.release == after {
            return copy;
        }
    }
}

/// The number of the release that the page is about: it has changed when a window has begun.
#[must_use]
#[inline]
pub fn release() -> u64 {
    // SAFETY: as in `information`.
    unsafe { read_volatile(&raw const (*INFORMATION).release) }
}

/// Tells the host that the scan of `release` started at `tsc`.
#[inline]
pub fn publish_start(release: u64, tsc: u64) {
    // SAFETY: the host provides the page as memory at this address, `boot` maps it writable, and
    // nothing else lies there. `started` is written last: who sees it sees its time stamp.
    unsafe {
        write_volatile(&raw mut (*STATUS).start_tsc, tsc);
        write_volatile(&raw mut (*STATUS).started, release.wrapping_add(1));
    }
}

/// Tells the host that the scan was finished at `tsc`.
#[inline]
pub fn publish_done(tsc: u64) {
    // SAFETY: as in `publish_start`.
    unsafe { write_volatile(&raw mut (*STATUS).done_tsc, tsc) };
}

/// Leaves a text for the host to print; what is longer than the text area is cut off.
pub fn publish_text(text: &[u8]) {
    let start = memory::TEXT as *mut u8;
    for (offset, &byte) in text.iter().take(memory::TEXT_BYTES).enumerate() {
        // SAFETY: as in `publish_start`; the offset lies within the area, which is the second
        // half of the same page.
        unsafe { write_volatile(start.add(offset), byte) };
    }
}

/// Leaves the record of the exception that ends this guest.
pub fn publish_exception(exception: Exception) {
    // SAFETY: as in `publish_start`.
    unsafe { write_volatile(&raw mut (*STATUS).exception, exception) };
}
