//! What a function returns, and the text of the last failure.

use std::cell::RefCell;
use std::ffi::{CString, c_char};

use takt_port::channel::ReturnCode;
use takt_port::{CallError, PortError, PortsError};

/// The result of a call: 0 to 6 are the return codes of ARINC 653 part 1, section 3.6, as far as ports have them.
/// Negative ones are for what the standard does not know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Code {
    /// The request was carried out.
    NoError = 0,
    /// There is nothing to give, or the port is in use.
    NoAction = 1,
    /// The queue is empty or full; or the other end cannot be believed, and a message of its queue was skipped.
    NotAvailable = 2,
    /// The message is empty, or the buffer is shorter than the longest message.
    InvalidParam = 3,
    /// There is no such port, or the message is too long.
    InvalidConfig = 4,
    /// The port has the other direction.
    InvalidMode = 5,
    /// The time-out passed.
    TimedOut = 6,
    /// A pointer is null, a text is not UTF-8, or the port was taken by a process from which this one was forked.
    BadArgument = -1,
    /// The machine has no ports, or a file of theirs cannot be used.
    System = -2,
}

impl From<ReturnCode> for Code {
    fn from(code: ReturnCode) -> Code {
        match code {
            ReturnCode::NoError => Code::NoError,
            ReturnCode::NoAction => Code::NoAction,
            ReturnCode::NotAvailable => Code::NotAvailable,
            ReturnCode::InvalidParam => Code::InvalidParam,
            ReturnCode::InvalidConfig => Code::InvalidConfig,
            ReturnCode::InvalidMode => Code::InvalidMode,
            ReturnCode::TimedOut => Code::TimedOut,
        }
    }
}

/// Why a call failed: its code, and the text for [`takt_port_last_error`].
#[derive(Debug)]
pub(crate) struct Failure {
    code: Code,
    text: String,
}

impl Failure {
    pub(crate) fn argument(text: &str) -> Failure {
        Failure { code: Code::BadArgument, text: text.to_owned() }
    }

    pub(crate) fn mode(text: String) -> Failure {
        Failure { code: Code::InvalidMode, text }
    }
}

impl From<PortsError> for Failure {
    fn from(error: PortsError) -> Failure {
        Failure { code: Code::System, text: error.to_string() }
    }
}

impl From<PortError> for Failure {
    fn from(error: PortError) -> Failure {
        Failure { code: error.code().map_or(Code::System, Code::from), text: error.to_string() }
    }
}

impl From<CallError> for Failure {
    fn from(error: CallError) -> Failure {
        Failure { code: error.code().map_or(Code::System, Code::from), text: error.to_string() }
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::new(CString::default());
}

/// Ends a call: keeps the text of a failure for the thread, and gives the code.
pub(crate) fn finish(result: Result<(), Failure>) -> Code {
    match result {
        Ok(()) => Code::NoError,
        Err(Failure { code, text }) => {
            // A name from the table of ports is cut at its first zero, so there is none in the text.
            let text = CString::new(text).unwrap_or_default();
            LAST.with(|last| last.replace(text));
            code
        }
    }
}

/// The text of this thread's last failure; empty before the first. It is good until the thread's next call.
#[unsafe(no_mangle)]
pub extern "C" fn takt_port_last_error() -> *const c_char {
    LAST.with(|last| last.borrow().as_ptr())
}
