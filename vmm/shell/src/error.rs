//! What can go wrong before ssh takes over, and on the way to the guest.

use std::io;

use takt_plan::{Cid, FileError};
use thiserror::Error;

use crate::USAGE;

/// Exit status if the connection broke off.
const BROKEN: u8 = 1;
/// Exit status if the host or the guest cannot.
const CANNOT: u8 = 3;

/// Why there is no way into the guest.
#[derive(Debug, Error)]
pub enum ShellError {
    /// The partition file is wrong.
    #[error(transparent)]
    File(#[from] FileError),
    /// No partition of the file has a number.
    #[error("no partition of this file has the key `vsock`; docs/shell.md says what it needs")]
    NoneHas,
    /// Several have one.
    #[error("name the partition: several have the key `vsock`: {0}")]
    Several(String),
    /// The named one has none.
    #[error("no partition {name:?} of this file has the key `vsock`; those that have it: {those}")]
    NotThis {
        /// As it was given.
        name: String,
        /// Those that could be meant.
        those: String,
    },
    /// Nothing to do for this program.
    #[error(
        "none of these paths is in a partition; write it as PARTITION:PATH, such as {example}:/tmp"
    )]
    NoGuestPath {
        /// A partition that could be meant.
        example: String,
    },
    /// One connection at a time.
    #[error("paths in two partitions, {0:?} and {1:?}: copy to this machine in between")]
    TwoGuests(String, String),
    /// A local path that looks like a partition's.
    #[error(
        "{path:?} looks like a path in a partition, and no partition {name:?} has the key `vsock`; for a file of this machine write ./{path}"
    )]
    NoSuchGuest {
        /// The path.
        path: String,
        /// What is before the colon.
        name: String,
    },
    /// The path of this program is not known.
    #[error("cannot tell ssh where this program is: {0}")]
    Own(io::Error),
    /// ssh or scp does not start.
    #[error("cannot run {program}: {source}{}", missing(source))]
    Client {
        /// The program.
        program: &'static str,
        /// What the kernel said.
        source: io::Error,
    },
    /// The kernel knows no such sockets.
    #[error(
        "this machine has no sockets to its guests: {0}; are the modules vsock and vhost_vsock loaded (modprobe vhost_vsock)?"
    )]
    NoSockets(io::Error),
    /// The guest is not reached.
    #[error("cannot reach port {port} of the guest with {cid}: {source}; {}", remedy(source))]
    Unreached {
        /// The guest.
        cid: Cid,
        /// What was to listen there.
        port: u32,
        /// What the kernel said.
        source: io::Error,
    },
    /// It was reached, and is not any more.
    #[error("the connection to the guest broke off: {0}")]
    Broken(io::Error),
}

impl ShellError {
    /// Exit status.
    #[must_use]
    pub fn status(&self) -> u8 {
        match self {
            Self::Own(_) | Self::Client { .. } | Self::NoSockets(_) | Self::Unreached { .. } => {
                CANNOT
            }
            Self::Broken(_) => BROKEN,
            _ => USAGE,
        }
    }
}

fn missing(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => "; is OpenSSH's client installed (Debian: openssh-client)?",
        _ => "",
    }
}

fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(libc::ENODEV | libc::EHOSTUNREACH | libc::ENETUNREACH) => {
            "does Takt run this file, on this machine and not in an emulated one?"
        }
        Some(libc::ECONNRESET | libc::ECONNREFUSED) => {
            "no program of the guest listens there: is it still starting, and does its sshd listen on vsock (docs/shell.md)?"
        }
        Some(libc::ETIMEDOUT) => {
            "the guest does not answer: is it still starting, and has it the module vmw_vsock_virtio_transport?"
        }
        _ => "does the guest run?",
    }
}
