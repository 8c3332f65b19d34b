//! A file system of the kernel's that is mounted for as long as it is needed, so that the next program finds the
//! machine as the kernel left it.

#![allow(unsafe_code)]

use std::ffi::{CStr, OsStr};
use std::os::unix::ffi::OsStrExt;
use std::{fs, io};

/// It is mounted until this is dropped.
pub struct Mounted(&'static CStr);

impl Mounted {
    /// Mounts the file system of this kind at this path.
    ///
    /// # Errors
    /// What the kernel says.
    pub fn new(kind: &'static CStr, path: &'static CStr) -> io::Result<Self> {
        fs::create_dir_all(OsStr::from_bytes(path.to_bytes()))?;
        // SAFETY: the strings end with a NUL and outlive the call; a null pointer says that there are no options.
        let done = unsafe {
            libc::mount(kind.as_ptr(), path.as_ptr(), kind.as_ptr(), 0, std::ptr::null())
        };
        if done == 0 { Ok(Self(path)) } else { Err(io::Error::last_os_error()) }
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        // SAFETY: the string ends with a NUL. What is still in use stays until it is not.
        unsafe { libc::umount2(self.0.as_ptr(), libc::MNT_DETACH) };
    }
}
