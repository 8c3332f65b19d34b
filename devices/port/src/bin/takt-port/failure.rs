//! How the tool ends when it does not end well.

use std::io;

use takt_port::channel::ReturnCode;
use takt_port::{CallError, PortError, PortsError};
use thiserror::Error;

/// Exit status for a wrong call of the tool (`EX_USAGE` of BSD's `sysexits.h`).
pub const USAGE: u8 = 64;
/// Exit status if the system is at fault (`EX_SOFTWARE`).
const OTHER: u8 = 70;

/// Why the tool could not do what it was asked for.
#[derive(Debug, Error)]
pub enum Failure {
    /// There are no ports.
    #[error(transparent)]
    Ports(#[from] PortsError),
    /// The port could not be taken.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The call failed.
    #[error("{port}: {error}")]
    Call {
        /// The port.
        port: String,
        /// What it said.
        error: CallError,
    },
    /// A message or a layout cannot be understood.
    #[error("{0}")]
    Usage(String),
    /// A message that was received has not the shape of the layout.
    #[error("{0}")]
    Shape(String),
    /// Messages that were received had not the shape of the layout, and were told of when they came.
    #[error("{port}: messages that could not be shown: {count}")]
    Unshown {
        /// The port.
        port: String,
        /// How many.
        count: u64,
    },
    /// Standard input or output.
    #[error("standard {0}: {1}")]
    Stream(&'static str, io::Error),
}

impl Failure {
    /// The message is taken from its queue, so what it was is told.
    pub fn shape(port: &str, error: &str, digits: &str) -> Failure {
        Failure::Shape(format!("{port}: {error}; it is {digits}"))
    }

    /// The exit status: the return code of ARINC 653 if the call has one.
    pub fn status(&self) -> u8 {
        let code = match self {
            Self::Usage(_) => return USAGE,
            Self::Ports(_) | Self::Shape(_) | Self::Unshown { .. } | Self::Stream(..) => None,
            Self::Port(error) => error.code(),
            Self::Call { error, .. } => error.code(),
        };
        match code {
            Some(ReturnCode::NoAction) => 1,
            Some(ReturnCode::NotAvailable) => 2,
            Some(ReturnCode::InvalidParam) => 3,
            Some(ReturnCode::InvalidConfig) => 4,
            Some(ReturnCode::InvalidMode) => 5,
            Some(ReturnCode::TimedOut) => 6,
            Some(ReturnCode::NoError) | None => OTHER,
        }
    }
}
