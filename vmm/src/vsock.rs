//! Sockets between the host and a Linux guest that need no network: the kernel's vhost-vsock
//! ([`vhost`](crate::vhost)).
//!
//! Programs of the host reach the guest by its number (CID), which belongs to the partition from before the run to its end.
//! A guest that restarts has it again at once.

use std::io;
use std::sync::Arc;

use takt_devices::virtio::carried::{Carrier, Link, QUEUES, Ring};
use takt_devices::vsock;
use takt_plan::Cid;
use thiserror::Error;
use vhost::vhost_kern::vhost_binding::{VHOST_VSOCK_SET_GUEST_CID, VHOST_VSOCK_SET_RUNNING};
use vmm_sys_util::ioctl::ioctl_with_ref;

use crate::appliance::{self, Role};
use crate::memory::{GuestMemory, MemoryError};
use crate::report;
use crate::vcpu::thread::Place;
use crate::vhost::{Carried, Model, Vhost, VhostError, Wires};
use crate::virtio::Slot;

const MODEL: Model = Model { path: "/dev/vhost-vsock", module: "vhost_vsock" };

/// A Linux does not get its socket device.
#[derive(Debug, Error)]
pub enum VsockError {
    /// The modules of the appliance.
    #[error("cannot load what `vsock` needs: {0}")]
    Modules(io::Error),
    /// The number cannot be had.
    #[error("cannot have {cid}: {source}{}", remedy(source))]
    Cid {
        /// The number.
        cid: Cid,
        /// What the host said.
        source: io::Error,
    },
    /// The kernel's device.
    #[error(transparent)]
    Vhost(#[from] VhostError),
    /// The memory that the packets are in.
    #[error(transparent)]
    Memory(#[from] MemoryError),
}

fn remedy(error: &io::Error) -> &'static str {
    match error.raw_os_error() {
        Some(libc::EADDRINUSE) => {
            "; another guest of this host has it, most likely of another takt"
        }
        _ => "",
    }
}

/// What the supervisor keeps of the device. The kernel's thread ends, and the number is free, when the device is closed
/// ([`Closer`](crate::vhost::Closer)).
pub struct Vsock {
    cid: Cid,
    link: Arc<Link>,
}

/// Opens what sockets need of the host, for the guest that has `memory` and is at `place`.
///
/// # Errors
/// If the host does not have it, or does not let it.
pub fn open(
    slot: Slot,
    cid: Cid,
    memory: &GuestMemory,
    place: Place,
    role: Role,
) -> Result<(Carried, Vsock), VsockError> {
    appliance::load_for_sockets(role).map_err(VsockError::Modules)?;
    let memory = memory.only_ram()?;
    let wires = Wires::new()?;
    let vhost = Vhost::open(MODEL, &cid.to_string(), memory.clone(), place, &wires)?;
    let number = u64::from(cid.0);
    // SAFETY: the kernel reads the live number.
    check(unsafe { ioctl_with_ref(&vhost, VHOST_VSOCK_SET_GUEST_CID(), &number) })
        .map_err(|source| VsockError::Cid { cid, source })?;
    let link = Arc::new(Link::new(VhostVsock(vhost)));
    let socket = Vsock { cid, link: link.clone() };
    let end = link.clone();
    let device = move || vsock::device(cid.0, memory.clone(), end.clone());
    Ok((Carried::new(slot, wires, link, device), socket))
}

impl Vsock {
    /// How it went.
    #[must_use]
    pub fn report(&self) -> report::Vsock {
        report::Vsock { cid: self.cid.0, refused_queues: self.link.refusals() }
    }
}

struct VhostVsock(Vhost);

impl VhostVsock {
    fn set_running(&self, running: bool) -> io::Result<()> {
        let running = libc::c_int::from(running);
        // SAFETY: the kernel reads the live number.
        check(unsafe { ioctl_with_ref(&self.0, VHOST_VSOCK_SET_RUNNING(), &running) })
    }
}

impl Carrier for VhostVsock {
    fn features(&self) -> u64 {
        self.0.features()
    }

    fn start(&mut self, agreed: u64, rings: [Ring; QUEUES]) -> io::Result<()> {
        // The kernel takes both rings or none.
        self.0.set_rings(agreed, &rings).map_err(io::Error::other)?;
        self.set_running(true)
    }

    fn stop(&mut self) {
        // Fails only if the device has no owner, and then it has no rings.
        let _ = self.set_running(false);
    }
}

fn check(result: libc::c_int) -> io::Result<()> {
    if result < 0 { Err(io::Error::last_os_error()) } else { Ok(()) }
}
