//! One system call that no list has, on a thread of choice.
//!
//! A timer of the kernel's signals the thread, and the handler makes the call. It is set up before
//! the sandbox is entered, so that nothing needs to be allowed for it.

use std::ffi::{c_int, c_void};
use std::io;
use std::mem;

use vmm_sys_util::signal::{SIGRTMIN, register_signal_handler, unblock_signal};

/// How long after the start, in seconds.
const DELAY_S: libc::time_t = 1;

extern "C" fn handler(_: c_int, _: *mut libc::siginfo_t, _: *mut c_void) {
    // A handler has all signals blocked, and one that is to tell of a fault and cannot be delivered
    // ends the process at once. Fails only for a number that is no signal's.
    let _ = unblock_signal(libc::SIGSYS);
    // SAFETY: no preconditions and no effect.
    unsafe { libc::getppid() };
}

/// Has the thread of this process with this id make the call.
///
/// # Errors
/// What the kernel says.
pub fn arm(thread: i32) -> io::Result<()> {
    let signal = SIGRTMIN() + 2;
    register_signal_handler(signal, handler)
        .map_err(|e| io::Error::from_raw_os_error(e.errno()))?;
    // SAFETY: all zeros are a valid value of this structure of integers.
    let mut event: libc::sigevent = unsafe { mem::zeroed() };
    event.sigev_notify = libc::SIGEV_THREAD_ID;
    event.sigev_signo = signal;
    event.sigev_notify_thread_id = thread;
    let mut timer = std::ptr::null_mut();
    let never = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    let first = libc::timespec { tv_sec: DELAY_S, tv_nsec: 0 };
    let setting = libc::itimerspec { it_interval: never, it_value: first };
    // SAFETY: the kernel reads live structures and writes the timer's id.
    let result = unsafe {
        match libc::timer_create(libc::CLOCK_MONOTONIC, &raw mut event, &raw mut timer) {
            0 => libc::timer_settime(timer, 0, &raw const setting, std::ptr::null_mut()),
            failed => failed,
        }
    };
    if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
