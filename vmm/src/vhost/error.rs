//! Why the kernel does not work on a device's queues.

use std::io;

use thiserror::Error;

use crate::event::EventError;
use crate::vcpu::thread::ThreadError;

/// A device of the kernel's could not be had.
#[derive(Debug, Error)]
pub enum VhostError {
    /// It is not there.
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
    /// It refuses a step.
    #[error("{path} cannot {what}: {source}")]
    Call {
        /// The device.
        path: &'static str,
        /// What was attempted.
        what: &'static str,
        /// What it said.
        source: ::vhost::Error,
    },
    /// It works by other rules than Takt's devices.
    #[error("this kernel's {path} lacks virtio 1 (VIRTIO_F_VERSION_1)")]
    Old {
        /// The device.
        path: &'static str,
    },
    /// The thread that moves packets is not to be seen.
    #[error(
        "cannot find the kernel's thread {worker} that moves the packets of {whose}; before Linux 6.4 it is seen from the first PID namespace only, not from a container"
    )]
    NoWorker {
        /// The tap device, or the socket's number.
        whose: String,
        /// The thread's name.
        worker: String,
    },
    /// It stays where it is.
    #[error("cannot pin the kernel's thread {worker} that moves the packets of {whose}: {source}")]
    Pin {
        /// The tap device, or the socket's number.
        whose: String,
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
}
