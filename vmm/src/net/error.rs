//! Why a partition does not get a network interface.

use std::io;

use thiserror::Error;

use crate::memory::MemoryError;
use crate::vhost::VhostError;

/// A network interface could not be made.
#[derive(Debug, Error)]
pub enum NetError {
    /// The modules of the appliance.
    #[error("cannot load what network interfaces need: {0}")]
    Modules(io::Error),
    /// The tap device cannot be had.
    #[error("cannot have the tap device {tap}: {source}{}", remedy(source))]
    Attach {
        /// Its name.
        tap: String,
        /// What the host said.
        source: io::Error,
    },
    /// The file says how to make it, and it is there.
    #[error(
        "the tap device {tap} is there already, and `{key}` is for one that Takt makes; remove the key, or the device (ip link delete {tap})"
    )]
    Exists {
        /// Its name.
        tap: String,
        /// The key of the partition file.
        key: &'static str,
    },
    /// A step of setting it up.
    #[error("cannot {what} the tap device {tap}: {source}")]
    SetUp {
        /// Its name.
        tap: String,
        /// What was attempted.
        what: &'static str,
        /// What the host said.
        source: io::Error,
    },
    /// The bridge cannot take it.
    #[error(
        "cannot put the tap device {tap} into the bridge {bridge}: {source}; is there a bridge of this name?"
    )]
    Bridge {
        /// Its name.
        tap: String,
        /// That of the bridge.
        bridge: String,
        /// What the host said.
        source: io::Error,
    },
    /// A file with a count of the kernel's.
    #[error("cannot open {path}: {source}; is /sys mounted?")]
    Count {
        /// The file.
        path: String,
        /// What the host said.
        source: io::Error,
    },
    /// A device of the kernel's that all interfaces need.
    #[error(transparent)]
    Vhost(#[from] VhostError),
    /// The memory that the packets are in.
    #[error(transparent)]
    Memory(#[from] MemoryError),
}

/// What to do about a refused tap device.
fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(libc::EBUSY) => "; another program has it, most likely another takt",
        Some(libc::EINVAL) => "; a network device of this name is there and is no tap device",
        Some(libc::EPERM) => {
            "; run as root (CAP_NET_ADMIN), or let an administrator make it: ip tuntap add"
        }
        _ => "",
    }
}
