//! The signals that end a run, as something to read.
//!
//! A handler could only note that there was one. Read from a descriptor, a signal is an
//! event like the others, and a run that it ends is ended in the same way as by the keyboard.

use std::fs::File;
use std::io;
use std::os::fd::FromRawFd;

use vmm_sys_util::signal::{block_signal, create_sigset};

use super::error::{SupervisorError, cannot};

/// Signals that end a run.
const ENDING: [libc::c_int; 4] = [libc::SIGINT, libc::SIGTERM, libc::SIGHUP, libc::SIGQUIT];

/// Blocks the signals that end a run, in this thread and all that it starts; they are then read
/// from a descriptor.
///
/// # Errors
/// If the host refuses the descriptor.
pub fn take_signals() -> Result<File, SupervisorError> {
    for signal in ENDING {
        // Fails only for a signal that is blocked already, as a parent process may have done.
        let _ = block_signal(signal);
    }
    let set = create_sigset(&ENDING)
        .map_err(|e| cannot("make a set of signals")(io::Error::from_raw_os_error(e.errno())))?;
    // SAFETY: the set is live and initialised; -1 asks for a new descriptor.
    let fd = unsafe { libc::signalfd(-1, &raw const set, libc::SFD_CLOEXEC | libc::SFD_NONBLOCK) };
    if fd < 0 {
        return Err(cannot("read signals from a descriptor")(io::Error::last_os_error()));
    }
    // SAFETY: the descriptor is new and has no other owner.
    Ok(unsafe { File::from_raw_fd(fd) })
}
