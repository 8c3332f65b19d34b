//! The calls of the kernel.
//!
//! A call is the instruction `syscall` with the number in `rax` and the arguments in `rdi`, `rsi`,
//! `rdx`, `r10` and `r8`. The result is in `rax`: zero or more is good, a negative number is an
//! [`Error`]. `rcx` and `r11` are destroyed, all else is kept. Times are nanoseconds; a call that can
//! wait always has a time-out.

use crate::code::codes;

codes! {
    /// The number of a call.
    pub enum Call: u32 {
        /// The job is done. Does not return. The call page makes it when a task's function returns.
        End = 0,
        /// Nanoseconds since the partition's start, now. No arguments.
        Time = 1,
        /// Logs a line: `rdi` text, `rsi` length (at most [`limit::LOG_BYTES`](crate::limit::LOG_BYTES)).
        Log = 2,
        /// Takes a semaphore: `rdi` object, `rsi` time-out.
        SemaphoreTake = 3,
        /// Gives a semaphore back: `rdi` object.
        SemaphoreGive = 4,
        /// Puts a message into a queue: `rdi` object, `rsi` message, `rdx` length. Never waits.
        QueueSend = 5,
        /// Takes a message out of a queue: `rdi` object, `rsi` buffer, `rdx` its size, `r10` time-out.
        /// The result is the message's length.
        QueueReceive = 6,
        /// Writes a mailbox: `rdi` object, `rsi` value, `rdx` length.
        MailboxWrite = 7,
        /// Reads a mailbox: `rdi` object, `rsi` buffer, `rdx` its size. The result is the length, with
        /// [`FRESH`] set if the value was written since this task last read it.
        MailboxRead = 8,
        /// Sets event flags: `rdi` object, `rsi` mask.
        FlagsSet = 9,
        /// Waits for event flags: `rdi` object, `rsi` mask, `rdx` 0 for any and 1 for all, `r10` time-out.
        /// The result is the flags that are set, of those in the mask.
        FlagsWait = 10,
        /// Clears event flags: `rdi` object, `rsi` mask.
        FlagsClear = 11,
        /// Reads a message from a channel: `rdi` port, `rsi` buffer, `rdx` its size. The result is the
        /// length. The port is an index in the image's table of ports.
        ChannelRead = 12,
        /// Writes a message to a channel: `rdi` port, `rsi` message, `rdx` length.
        ChannelWrite = 13,
        /// Stops the program: `rdi` a code of its own, told in the log. Does not return.
        Stop = 14,
    }
}

codes! {
    /// Why a call failed: the result is the negative of this.
    pub enum Error: u8 {
        /// There is no call of this number.
        BadNumber = 1,
        /// A pointer is not into the program's memory, or not with the right to read or write there.
        BadPointer = 2,
        /// There is no object or port of this number, or it is of another kind.
        BadId = 3,
        /// The time is over.
        TimedOut = 4,
        /// The queue or channel is full.
        Full = 5,
        /// There is no message.
        Empty = 6,
        /// The message is longer than the object, port or buffer takes.
        TooLong = 7,
        /// This task may not do this now.
        NotAllowed = 8,
        /// The task's priority is above the ceiling of the semaphore, or it holds it already.
        Ceiling = 9,
    }
}

/// Bit of the result of [`Call::MailboxRead`]: the value is new to this task.
pub const FRESH: i64 = 1 << 32;

impl Error {
    /// What a failed call returns in `rax`.
    #[must_use]
    pub const fn result(self) -> i64 {
        -(self as i64)
    }

    /// The error that a result tells, if it does.
    #[must_use]
    pub fn of(result: i64) -> Option<Self> {
        result.checked_neg().and_then(|code| u8::try_from(code).ok()).and_then(Self::from_code)
    }
}
