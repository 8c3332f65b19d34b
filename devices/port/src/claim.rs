//! One owner for each end.
//!
//! Two processes that write one region would destroy each other's messages. The channel crate cannot
//! see that, so each handle locks one byte of the function's `resource2`, that of its port's
//! number. A lock of this kind (`F_OFD_SETLK`) belongs to the open file, so it also keeps two
//! handles of one process apart, and it ends with the process however that ends: there is no lock
//! file that could be left behind, and none that somebody else could make first. It does not keep apart a
//! process and one that is forked from it: they share the open file.

#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

use crate::error::PortsError;

/// The right to use a port, until it is dropped.
#[derive(Debug)]
pub(crate) struct Claim {
    /// Whose closing gives the lock back.
    _file: File,
}

/// Takes the port with this number; `None` if somebody has it.
pub(crate) fn claim(path: &Path, index: u32) -> Result<Option<Claim>, PortsError> {
    let file = open(path)?;
    let mut lock = byte(index);
    // SAFETY: the kernel only reads `lock`, which lives through the call.
    match unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_SETLK, &raw mut lock) } {
        0 => Ok(Some(Claim { _file: file })),
        _ => match io::Error::last_os_error() {
            error if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            source => Err(failed(path.to_owned(), source)),
        },
    }
}

/// Whether somebody has the port with this number.
pub(crate) fn is_claimed(path: &Path, index: u32) -> Result<bool, PortsError> {
    let file = open(path)?;
    let mut lock = byte(index);
    // SAFETY: the kernel writes to `lock`, which lives through the call and is a `flock`.
    match unsafe { libc::fcntl(file.as_raw_fd(), libc::F_OFD_GETLK, &raw mut lock) } {
        0 => Ok(i32::from(lock.l_type) != libc::F_UNLCK),
        _ => Err(failed(path.to_owned(), io::Error::last_os_error())),
    }
}

fn open(path: &Path) -> Result<File, PortsError> {
    let opened = OpenOptions::new().read(true).write(true).open(path);
    opened.map_err(|source| PortsError::File { doing: "open", path: path.to_owned(), source })
}

fn failed(path: PathBuf, source: io::Error) -> PortsError {
    PortsError::File { doing: "lock", path, source }
}

fn byte(index: u32) -> libc::flock {
    libc::flock {
        l_type: libc::F_WRLCK as i16,
        l_whence: libc::SEEK_SET as i16,
        l_start: i64::from(index),
        l_len: 1,
        // Must be 0 for locks of this kind.
        l_pid: 0,
    }
}
