//! The signals that end a run, as something to read.
//!
//! A handler could only note that there was one. Read from a descriptor, a signal is an
//! event like the others, and a run that it ends is ended in the same way as by the keyboard.
//!
//! A signal that is ignored at the start stays so: `nohup` ignores SIGHUP so that a run goes on when its terminal is
//! closed, and a shell without job control ignores SIGINT and SIGQUIT for what it has in the background. The kernel
//! discards an ignored signal only while it is not blocked.

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
    let ending: Vec<_> = ENDING.into_iter().filter(|signal| !is_ignored(*signal)).collect();
    for &signal in &ending {
        // Fails only for a signal that is blocked already, as a parent process may have done.
        let _ = block_signal(signal);
    }
    let set = create_sigset(&ending)
        .map_err(|e| cannot("make a set of signals")(io::Error::from_raw_os_error(e.errno())))?;
    // SAFETY: the set is live and initialised; -1 asks for a new descriptor.
    let fd = unsafe { libc::signalfd(-1, &raw const set, libc::SFD_CLOEXEC | libc::SFD_NONBLOCK) };
    if fd < 0 {
        return Err(cannot("read signals from a descriptor")(io::Error::last_os_error()));
    }
    // SAFETY: the descriptor is new and has no other owner.
    Ok(unsafe { File::from_raw_fd(fd) })
}

fn is_ignored(signal: libc::c_int) -> bool {
    // SAFETY: all zeros is a `sigaction`.
    let mut action: libc::sigaction = unsafe { std::mem::zeroed() };
    // SAFETY: changes no action, and fills in a live structure. It cannot fail for a signal that there is.
    unsafe { libc::sigaction(signal, std::ptr::null(), &raw mut action) };
    action.sa_sigaction == libc::SIG_IGN
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;

    #[test]
    fn a_signal_that_is_ignored_ends_no_run() {
        // SAFETY: takes a number and a constant.
        unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) };
        let mut signals = take_signals().unwrap();
        let mut came = |signal: libc::c_int| {
            // SAFETY: takes a number. The signal is for this thread, which blocks it or ignores it.
            unsafe { libc::raise(signal) };
            signals.read(&mut [0; 128]).is_ok()
        };
        assert!(!came(libc::SIGHUP));
        assert!(came(libc::SIGTERM));
    }
}
