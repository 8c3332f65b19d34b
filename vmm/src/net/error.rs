//! Why a partition does not get a network interface.

use std::io;

use thiserror::Error;

use crate::event::EventError;
use crate::memory::MemoryError;
use crate::vcpu::thread::ThreadError;

/// A network interface could not be made.
#[derive(Debug, Error)]
pub enum NetError {
    /// A device of the kernel's that all interfaces need.
    #[error(
        "cannot open {path}: {source}; is the module {module} loaded (modprobe {module}), and is this root?"
    )]
    Device {
        /// The device.
        path: &'static str,
        /// What makes it.
        module: &'static str,
        /// What the host said.
        source: io::Error,
    },
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
    /// vhost-net refuses a step.
    #[error("vhost-net cannot {what}: {source}")]
    Vhost {
        /// What was attempted.
        what: &'static str,
        /// What it said.
        source: vhost::Error,
    },
    /// It works by other rules than this device.
    #[error("this kernel's vhost-net lacks virtio 1 (VIRTIO_F_VERSION_1)")]
    Old,
    /// The thread that moves packets is not to be seen.
    #[error(
        "cannot find the kernel's thread {worker} that moves the packets of {tap}; before Linux 6.4 it is seen from the first PID namespace only, not from a container"
    )]
    NoWorker {
        /// The tap device.
        tap: String,
        /// The thread's name.
        worker: String,
    },
    /// It stays where it is.
    #[error("cannot pin the kernel's thread {worker} that moves the packets of {tap}: {source}")]
    Pin {
        /// The tap device.
        tap: String,
        /// The thread's name.
        worker: String,
        /// What the host said.
        source: io::Error,
    },
    /// The thread from which it inherits its place.
    #[error(transparent)]
    Thread(#[from] ThreadError),
    /// A descriptor that is rung.
    #[error(transparent)]
    Event(#[from] EventError),
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
