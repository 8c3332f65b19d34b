//! Ctrl-C ends a recording as its time does: the file is whole.
//!
//! The process waits for Takt's next line then. A handler that shuts the connection down ends the wait, and nothing has
//! to look at a clock.

use std::io;
use std::os::fd::RawFd;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

static CONNECTION: AtomicI32 = AtomicI32::new(-1);
static CAME: AtomicBool = AtomicBool::new(false);

/// Has the next SIGINT, SIGTERM or SIGHUP that is not ignored end what comes by this connection. A second one ends the process.
///
/// # Errors
/// What the kernel says.
pub fn ends(connection: RawFd) -> io::Result<()> {
    CONNECTION.store(connection, Ordering::SeqCst);
    // SAFETY: all zeros is a `sigaction` without flags and with an empty mask.
    let mut action: libc::sigaction = unsafe { std::mem::zeroed() };
    action.sa_sigaction = shut_down as *const () as libc::sighandler_t;
    action.sa_flags = libc::SA_RESETHAND;
    for signal in [libc::SIGINT, libc::SIGTERM, libc::SIGHUP] {
        // SAFETY: all zeros is a `sigaction`.
        let mut before: libc::sigaction = unsafe { std::mem::zeroed() };
        // SAFETY: reads into a live structure.
        let mut result = unsafe { libc::sigaction(signal, std::ptr::null(), &raw mut before) };
        // `nohup` and shells in the background have it ignored, so that the command goes on.
        if result == 0 && before.sa_sigaction != libc::SIG_IGN {
            // SAFETY: the handler has the signature of one without SA_SIGINFO, and calls only what is safe in a handler
            // (POSIX, section 2.4.3).
            result = unsafe { libc::sigaction(signal, &raw const action, std::ptr::null_mut()) };
        }
        if result < 0 {
            return Err(io::Error::last_os_error());
        }
    }
    Ok(())
}

/// Whether it came.
pub fn came() -> bool {
    CAME.load(Ordering::SeqCst)
}

extern "C" fn shut_down(_signal: libc::c_int) {
    CAME.store(true, Ordering::SeqCst);
    // SAFETY: takes numbers only. The connection is open until the command has ended, and with it the process.
    unsafe { libc::shutdown(CONNECTION.load(Ordering::SeqCst), libc::SHUT_RDWR) };
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsRawFd;
    use std::os::unix::net::UnixStream;

    use super::*;

    fn action_of(signal: libc::c_int) -> libc::sighandler_t {
        // SAFETY: all zeros is a `sigaction`.
        let mut action: libc::sigaction = unsafe { std::mem::zeroed() };
        // SAFETY: reads into a live structure.
        unsafe { libc::sigaction(signal, std::ptr::null(), &raw mut action) };
        action.sa_sigaction
    }

    #[test]
    fn a_signal_that_is_ignored_stays_so() {
        // SAFETY: takes a number and a constant.
        unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) };
        let (connection, _other) = UnixStream::pair().unwrap();
        ends(connection.as_raw_fd()).unwrap();
        assert_eq!(action_of(libc::SIGHUP), libc::SIG_IGN);
        assert_eq!(action_of(libc::SIGTERM), shut_down as *const () as libc::sighandler_t);
    }
}
