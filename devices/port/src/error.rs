//! What can go wrong, by when it does: finding the ports, taking one, using it.

use std::io;
use std::path::PathBuf;

use takt_channel::{LengthError, OpenError, ReadError, ReceiveError, ReturnCode, SendError};
use thiserror::Error;

use crate::table::{Direction, TableError};

/// Why there are no ports at all.
#[derive(Debug, Error)]
pub enum PortsError {
    /// No such function on the PCI bus.
    #[error(
        "no PCI function 1af4:10f0 in {0}: is this a partition of Takt, and has a [[channel]] of its \
         partition file an end in it?"
    )]
    NotFound(PathBuf),
    /// A file of the function, or of the kernel, cannot be used.
    #[error("cannot {doing} {path}: {source}{}", root_hint(source))]
    File {
        /// What was tried.
        doing: &'static str,
        /// The file.
        path: PathBuf,
        /// What the kernel says.
        source: io::Error,
    },
    /// This program cannot use the table of ports.
    #[error("the table of ports: {0}")]
    Table(#[from] TableError),
}

fn root_hint(error: &io::Error) -> &'static str {
    if error.kind() == io::ErrorKind::PermissionDenied { " (only root may)" } else { "" }
}

/// Why a port could not be taken.
#[derive(Debug, Error)]
pub enum PortError {
    /// This partition has no port of that name.
    #[error("this partition has no port {name}; it has {}", list(.has))]
    Unknown {
        /// What was asked for.
        name: String,
        /// The names of those that there are.
        has: Vec<String>,
    },
    /// It sends where it should receive, or the other way round.
    #[error("port {name} is a {}", .is.name())]
    Direction {
        /// The port.
        name: String,
        /// Its direction.
        is: Direction,
    },
    /// It is a queuing port where a sampling port is asked for, or the other way round.
    #[error("port {name} is a {is} port")]
    Kind {
        /// The port.
        name: String,
        /// Its kind.
        is: &'static str,
    },
    /// Another process, or another handle of this one, has it.
    #[error("port {0} is in use: an end of a channel has one owner at a time")]
    Busy(String),
    /// The memory of the channel is not what the table says.
    #[error("port {name}: {error}")]
    Open {
        /// The port.
        name: String,
        /// What differs.
        error: OpenError,
    },
    /// A file of the function, or of the kernel, cannot be used.
    #[error(transparent)]
    File(#[from] PortsError),
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

impl PortError {
    /// NO_ACTION if it is in use, INVALID_MODE for the wrong direction, INVALID_CONFIG for what
    /// differs from the partition file; `None` if the system is at fault.
    #[must_use]
    pub fn code(&self) -> Option<ReturnCode> {
        match self {
            Self::Busy(_) => Some(ReturnCode::NoAction),
            Self::Direction { .. } => Some(ReturnCode::InvalidMode),
            Self::Unknown { .. } | Self::Kind { .. } => Some(ReturnCode::InvalidConfig),
            Self::Open { error, .. } => Some(error.code()),
            Self::File(_) => None,
        }
    }
}

/// Why a call brought nothing.
#[derive(Debug, Error)]
pub enum CallError {
    /// There is no sample, or none that can be believed.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The sample is still the one that the caller knows.
    #[error("no newer message has been written")]
    NothingNewer,
    /// The message has the wrong length.
    #[error(transparent)]
    Length(#[from] LengthError),
    /// The message was not sent.
    #[error(transparent)]
    Send(#[from] SendError),
    /// No message was received.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The time-out passed.
    #[error("the time-out passed")]
    TimedOut,
    /// The kernel would not let this thread wait.
    #[error("cannot wait for the doorbell: {0}")]
    Wait(#[from] io::Error),
}

impl CallError {
    /// The return code of ARINC 653; `None` if the system is at fault.
    #[must_use]
    pub fn code(&self) -> Option<ReturnCode> {
        match self {
            Self::Read(error) => Some(error.code()),
            Self::NothingNewer => Some(ReturnCode::NoAction),
            Self::Length(error) => Some(error.code()),
            Self::Send(error) => Some(error.code()),
            Self::Receive(error) => Some(error.code()),
            Self::TimedOut => Some(ReturnCode::TimedOut),
            Self::Wait(_) => None,
        }
    }
}
