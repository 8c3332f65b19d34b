//! The calls of the kernel, as they are: numbers in, a number out.

use core::arch::asm;

/// Why a call failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Error {
    /// There is no call of this number.
    BadNumber,
    /// The memory is not the program's.
    BadPointer,
    /// There is no such object or port.
    BadId,
    /// The time is over.
    TimedOut,
    /// The queue or channel is full.
    Full,
    /// There is no message.
    Empty,
    /// The message is too long.
    TooLong,
    /// This task may not do this now.
    NotAllowed,
    /// The task's priority is above the ceiling of the semaphore, or it holds it already.
    Ceiling,
    /// A number that this version of the crate does not know.
    Other,
}

impl Error {
    fn of(result: i64) -> Self {
        match result {
            -1 => Self::BadNumber,
            -2 => Self::BadPointer,
            -3 => Self::BadId,
            -4 => Self::TimedOut,
            -5 => Self::Full,
            -6 => Self::Empty,
            -7 => Self::TooLong,
            -8 => Self::NotAllowed,
            -9 => Self::Ceiling,
            _ => Self::Other,
        }
    }
}

/// Makes a call of the kernel.
///
/// # Safety
/// The arguments must be those of the call `number`: a pointer among them must be to memory that the call may read or
/// write as it does.
pub unsafe fn call(number: u64, arguments: [u64; 4]) -> Result<u64, Error> {
    let result: i64;
    let [a, b, c, d] = arguments;
    // SAFETY: the kernel keeps all registers but rax, rcx and r11, and touches no memory but what the
    // caller vouches for.
    unsafe {
        asm!(
            "syscall",
            inlateout("rax") number => result,
            in("rdi") a, in("rsi") b, in("rdx") c, in("r10") d,
            lateout("rcx") _, lateout("r11") _,
            options(nostack),
        );
    }
    u64::try_from(result).map_err(|_| Error::of(result))
}

/// Nanoseconds since the partition's start, now.
#[must_use]
pub fn time() -> u64 {
    // SAFETY: it has no arguments.
    unsafe { call(1, [0; 4]) }.unwrap_or(0)
}

/// The most bytes of a line of the log.
pub const LOG_BYTES: usize = 120;

/// Logs a line; what is longer than [`LOG_BYTES`] is cut. [`log!`](crate::log) takes numbers too.
pub fn log(text: &str) {
    let text = cut(text);
    // SAFETY: the text is readable. A line that the kernel drops is counted there.
    let _ = unsafe { call(2, [text.as_ptr() as u64, text.len() as u64, 0, 0]) };
}

/// As many whole characters of a text as a line has room for.
fn cut(text: &str) -> &str {
    let most = text.len().min(LOG_BYTES);
    let fits = (0..=most).rev().find_map(|end| text.get(..end));
    fits.unwrap_or_default()
}

/// Stops this program, with a code that is told in the log.
pub fn stop(code: u32) -> ! {
    loop {
        // SAFETY: it has no pointers.
        let _ = unsafe { call(14, [code.into(), 0, 0, 0]) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_cut_between_two_characters() {
        let long = "a".repeat(LOG_BYTES - 1) + "\u{fc}b";
        assert_eq!(cut(&long), &long[..LOG_BYTES - 1]);
        assert_eq!(cut(&long[1..]), &long[1..=LOG_BYTES]);
        assert_eq!((cut("ab"), cut("")), ("ab", ""));
    }
}
