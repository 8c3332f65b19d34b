//! What follows from a system call that is not in a thread's list.
//!
//! It is an error in Takt, or the work of somebody who has found one. Either way the process is not
//! to go on; but ending it at once, as the kernel can, would leave the outputs as they are. So the
//! kernel sends a signal instead, in the place of the call, and its handler has the safe values written,
//! says which thread it was, and ends the process. It allocates nothing and takes no lock, and what
//! it calls is in every list. If even that goes wrong, the kernel ends the process: the signal is
//! blocked in its own handler.

use std::cell::Cell;
use std::ffi::{c_int, c_void};
use std::fmt::{self, Write};
use std::io;
use std::sync::OnceLock;

use vmm_sys_util::signal::register_signal_handler;

use crate::outlet::takes_last_words;

/// Exit status of a process that was ended so.
pub const STATUS: u8 = 5;
/// Longest name of a thread that is shown.
const NAME_MAX: usize = 32;

thread_local! {
    /// The name of this thread, and its length.
    static NAME: Cell<([u8; NAME_MAX], usize)> = const { Cell::new(([0; NAME_MAX], 0)) };
}

/// What is to be done before the end.
static LAST_WORK: OnceLock<fn() -> Option<bool>> = OnceLock::new();

/// The name under which the calling thread is shown.
pub fn set_name(name: &str) {
    let mut bytes = [0; NAME_MAX];
    let length = name.len().min(NAME_MAX);
    for (to, from) in bytes.iter_mut().zip(name.bytes()) {
        *to = from;
    }
    NAME.set((bytes, length));
}

/// Installs the handler, which calls `emergency_stop` first: it must be safe in a signal handler, and tells
/// whether it has been done; `None` if there is nothing to do.
///
/// # Errors
/// What `sigaction` says.
pub fn install(emergency_stop: fn() -> Option<bool>) -> io::Result<()> {
    LAST_WORK.get_or_init(|| emergency_stop);
    register_signal_handler(libc::SIGSYS, handler)
        .map_err(|e| io::Error::from_raw_os_error(e.errno()))
}

/// Lets the kernel end the process at a fault. The standard library's handlers look for the overflow of a stack, and then
/// take themselves away by a call that no list has.
pub fn leave_faults_to_the_kernel() {
    for fault in [libc::SIGSEGV, libc::SIGBUS] {
        // SAFETY: takes a handler away; nothing of this process runs at these signals any more.
        unsafe { libc::signal(fault, libc::SIG_DFL) };
    }
}

/// The part of `siginfo_t` that is filled in for a filter's signal: `_sigsys` of
/// `include/uapi/asm-generic/siginfo.h`.
#[repr(C)]
struct Forbidden {
    signal: c_int,
    errno: c_int,
    code: c_int,
    instruction: *const c_void,
    call: c_int,
    architecture: u32,
}

extern "C" fn handler(_: c_int, info: *mut libc::siginfo_t, _: *mut c_void) {
    let done = LAST_WORK.get().and_then(|emergency_stop| emergency_stop());
    // SAFETY: the kernel hands a filled-in structure to a handler with SA_SIGINFO, which lives as
    // long as the handler runs; this is how its first bytes are laid out for this signal.
    let (call, instruction) = unsafe {
        let info = info.cast::<Forbidden>();
        ((*info).call, (*info).instruction)
    };
    let values = last_words(done);
    let mut text = Text::default();
    let (name, length) = NAME.get();
    let name = name.get(..length).and_then(|name| std::str::from_utf8(name).ok()).unwrap_or("?");
    // What does not fit is cut off.
    let _ = writeln!(
        text,
        "\ntakt: thread {name} made the system call {call} at {instruction:p}, which its list does not have; {values}, and this is the end"
    );
    if takes_last_words() {
        // SAFETY: writes from the live buffer.
        unsafe { libc::write(libc::STDERR_FILENO, text.bytes.as_ptr().cast(), text.length) };
    }
    // SAFETY: nothing of the process is left.
    unsafe { libc::_exit(STATUS.into()) }
}

/// What is said of the safe values.
const fn last_words(done: Option<bool>) -> &'static str {
    match done {
        Some(true) => "safe values are written",
        Some(false) => {
            "a guest has not left its processor: its safe values are left to the guardian"
        }
        None => "takt writes no safe values: there are none, or no guest runs",
    }
}

/// Text of bounded length.
struct Text {
    bytes: [u8; 320],
    length: usize,
}

impl Default for Text {
    fn default() -> Self {
        Self { bytes: [0; 320], length: 0 }
    }
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for (to, from) in self.bytes.iter_mut().skip(self.length).zip(text.bytes()) {
            *to = from;
            self.length += 1;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn safe_values_are_said_to_be_written_only_if_they_are() {
        // No guest has been started in this process.
        assert_eq!(crate::passthrough::emergency_stop::do_it(), None);
        for (done, written) in [(Some(true), true), (Some(false), false), (None, false)] {
            assert_eq!(last_words(done).contains("values are written"), written, "{done:?}");
        }
    }

    #[test]
    fn a_fault_is_handled_by_the_kernel_alone() {
        leave_faults_to_the_kernel();
        for fault in [libc::SIGSEGV, libc::SIGBUS] {
            let mut action = std::mem::MaybeUninit::<libc::sigaction>::uninit();
            // SAFETY: the kernel fills in a live structure, and changes nothing.
            let handler = unsafe {
                assert_eq!(libc::sigaction(fault, std::ptr::null(), action.as_mut_ptr()), 0);
                action.assume_init().sa_sigaction
            };
            assert_eq!(handler, libc::SIG_DFL);
        }
    }

    #[test]
    fn a_text_that_is_too_long_is_cut_off() {
        let mut text = Text::default();
        for _ in 0..100 {
            text.write_str("abcdefg").unwrap();
        }
        assert_eq!(text.length, 320);
        assert_eq!(&text.bytes[315..], b"abcde");
    }

    #[test]
    fn a_long_name_is_cut_off() {
        set_name(&"x".repeat(100));
        assert_eq!(NAME.get(), ([b'x'; NAME_MAX], NAME_MAX));
        set_name("plc");
        assert_eq!(NAME.get().1, 3);
    }
}
