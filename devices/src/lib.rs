//! What a guest can touch.
//!
//! A device here knows offsets and bytes, not KVM, threads or guests: an access decoded by the
//! VMM comes in, bytes come out, and whatever the device wants from outside (an interrupt, a
//! restart of the machine) leaves through a small trait or a flag. So every device is tested by
//! calling it, with whatever hostile sequence of accesses a test can think of.

#![forbid(unsafe_code)]

pub mod disk;
pub mod net;
pub mod output;
pub mod pci;
pub mod ports;
pub mod power;
pub mod serial;
pub mod virtio;
pub mod vsock;
pub mod watchdog;
