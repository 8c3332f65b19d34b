//! Descriptors that the process which started Takt has left open.

use std::io;

/// Closes all descriptors but the three standard ones. To be called before anything is opened:
/// whatever is open then is somebody else's, and no business of a hypervisor.
///
/// # Errors
/// What the kernel says: it has this call since Linux 5.9.
pub fn close_inherited() -> io::Result<()> {
    // SAFETY: takes integers only. No value in this process owns what is closed, see above.
    let result = unsafe { libc::syscall(libc::SYS_close_range, 3u32, u32::MAX, 0u32) };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
