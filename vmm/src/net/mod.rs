//! The network interfaces of a Linux guest: set up here, and worked by the host's kernel.
//!
//! ```text
//! write to the register --> KVM: ioeventfd --> vhost-net's worker --> tap device --> the host's network
//!                          KVM: irqfd     <--/
//! ```
//!
//! The device is `takt_devices::net`. Takt touches no packet: what a guest and its network send each other goes
//! through a thread of the kernel's (`worker`) that reads and writes the guest's memory. Before a run, Takt
//! opens both devices, tells that thread which memory is the guest's, and puts it onto the CPU of the guest. In a
//! run the guest's own thread makes some calls when its driver starts or resets the interface, and no thread
//! of Takt's does anything for a packet.
//!
//! `docs/network.md` says what that means for windows.

mod count;
mod error;
mod tap;
mod vhost;
mod worker;

use std::sync::Arc;

use kvm_ioctls::VmFd;
use takt_devices::net::{Link, Mac, NetDevice, QUEUES};
use takt_devices::virtio::registers::Registers;
use vm_memory::GuestMemoryMmap;
use vmm_sys_util::eventfd::EventFd;

use crate::appliance::{self, Role};
use crate::config;
use crate::event::eventfd;
use crate::machine::MachineError;
use crate::memory::GuestMemory;
use crate::vcpu::thread::Place;
use crate::virtio::Slot;

pub use count::Counts;
pub use error::NetError;
use tap::Tap;
use vhost::{Vhost, VhostNet};

/// Loads what interfaces need of the kernel, if this is the appliance. Elsewhere that is the user's.
///
/// # Errors
/// See [`NetError`].
pub fn load_modules(role: Role) -> Result<(), NetError> {
    appliance::load_for_networks(role).map_err(NetError::Modules)
}

/// An interface, as the machines know it that its Linux has one after the other.
pub struct Interface {
    slot: Slot,
    mac: Mac,
    memory: GuestMemoryMmap,
    link: Arc<Link>,
    /// Rung by the guest, for each queue.
    bells: [EventFd; QUEUES],
    /// Rung for the guest.
    interrupt: EventFd,
}

/// What the supervisor keeps of an interface. When it is dropped the kernel's thread ends and the tap device is
/// let go of.
pub struct Cable {
    tap: String,
    link: Arc<Link>,
    counts: Counts,
    vhost: Arc<Vhost>,
}

impl Interface {
    /// Opens what an interface needs of the host, for the guest that has `memory` and is at `place`.
    ///
    /// # Errors
    /// If the host does not have it, or does not let it.
    pub fn open(
        slot: Slot,
        net: &config::Net,
        memory: &GuestMemory,
        place: Place,
    ) -> Result<(Self, Cable), NetError> {
        let memory = memory.only_ram()?;
        let tap = Tap::open(net)?;
        let counts = Counts::of(&net.tap)?;
        let bells = [eventfd()?, eventfd()?];
        let interrupt = eventfd()?;
        let vhost = Arc::new(Vhost::open(memory.clone())?);
        worker::place(&vhost, &net.tap, place)?;
        vhost.prepare(&bells, &interrupt)?;
        let carrier = VhostNet { vhost: vhost.clone(), tap };
        let link = Arc::new(Link::new(carrier));
        let cable = Cable { tap: net.tap.clone(), link: link.clone(), counts, vhost };
        Ok((Self { slot, mac: net.mac, memory, link, bells, interrupt }, cable))
    }

    /// Connects the interface to a machine that has not run yet.
    ///
    /// # Errors
    /// If KVM refuses.
    pub fn attach(&self, vm: &VmFd) -> Result<Registers, MachineError> {
        self.slot.attach(vm, &self.bells, &self.interrupt)?;
        let device = NetDevice::new(self.mac, self.memory.clone(), self.link.clone());
        Ok(Registers::new(device))
    }

    /// Takes the interface away from a guest that does not run any more. Afterwards nothing is written to
    /// its memory.
    pub fn reset(&self) {
        self.link.reset();
    }
}

impl Cable {
    /// What has gone through it.
    #[must_use]
    pub fn report(&self) -> crate::report::Net {
        let [to_guest, from_guest] = self.counts.read();
        crate::report::Net {
            tap: self.tap.clone(),
            to_guest,
            from_guest,
            refused_queues: self.link.refusals(),
        }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.link.reset();
        self.vhost.end();
    }
}
