//! The network interfaces of a Linux guest: set up here, and worked by the host's kernel ([`vhost`](crate::vhost)).
//!
//! `docs/network.md` says what that means for windows.

mod carrier;
mod count;
mod error;
mod tap;

use std::sync::Arc;

use takt_devices::net;
use takt_devices::virtio::carried::Link;

use crate::appliance::{self, Role};
use crate::config;
use crate::memory::GuestMemory;
use crate::vcpu::thread::Place;
use crate::vhost::{Carried, Vhost, Wires};
use crate::virtio::Slot;

use carrier::{MODEL, VhostNet};
pub use count::Counts;
pub use error::NetError;
use tap::Tap;

/// Loads what interfaces need of the kernel, if this is the appliance. Elsewhere that is the user's.
///
/// # Errors
/// See [`NetError`].
pub fn load_modules(role: Role) -> Result<(), NetError> {
    appliance::load_for_networks(role).map_err(NetError::Modules)
}

/// What the supervisor keeps of an interface. The kernel's thread ends, and the tap device is let go of, when the interface
/// is closed ([`Closer`](crate::vhost::Closer)).
pub struct Cable {
    tap: String,
    link: Arc<Link>,
    counts: Counts,
}

/// Opens what an interface needs of the host, for the guest that has `memory` and is at `place`.
///
/// # Errors
/// If the host does not have it, or does not let it.
pub fn open(
    slot: Slot,
    net: &config::Net,
    memory: &GuestMemory,
    place: Place,
) -> Result<(Carried, Cable), NetError> {
    let memory = memory.only_ram()?;
    let tap = Tap::open(net)?;
    let counts = Counts::of(&net.tap)?;
    let wires = Wires::new()?;
    let vhost = Vhost::open(MODEL, &net.tap, memory.clone(), place, &wires)?;
    let link = Arc::new(Link::new(VhostNet { vhost, tap }));
    let cable = Cable { tap: net.tap.clone(), link: link.clone(), counts };
    let (mac, end) = (net.mac, link.clone());
    let device = move || net::device(mac, memory.clone(), end.clone());
    Ok((Carried::new(slot, wires, link, device), cable))
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
