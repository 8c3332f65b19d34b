//! A network interface for a Linux guest: a virtio network device (virtio 1.2, section 5.1) whose packets
//! another one moves ([`carried`](crate::virtio::carried)).
//!
//! There is no queue for orders, so a driver cannot ask for other addresses or for several pairs of queues;
//! and no state of the link: it is always up.

#[cfg(test)]
mod tests;

use std::sync::Arc;

use virtio_bindings::virtio_config::VIRTIO_F_VERSION_1;
use virtio_bindings::virtio_ids::VIRTIO_ID_NET;
use virtio_bindings::virtio_net::{
    VIRTIO_NET_F_CSUM, VIRTIO_NET_F_GUEST_CSUM, VIRTIO_NET_F_GUEST_ECN, VIRTIO_NET_F_GUEST_TSO4,
    VIRTIO_NET_F_GUEST_TSO6, VIRTIO_NET_F_HOST_ECN, VIRTIO_NET_F_HOST_TSO4, VIRTIO_NET_F_HOST_TSO6,
    VIRTIO_NET_F_MAC, VIRTIO_NET_F_MRG_RXBUF,
};
use vm_memory::GuestMemoryMmap;

use crate::virtio::carried::{CarriedDevice, Link, QUEUE_SIZE, QUEUES, RINGS};
use crate::virtio::{Description, bits};

/// An Ethernet address.
pub type Mac = [u8; 6];

/// What a guest may leave to the one who gets its packets: checksums, and cutting what is too long.
const FROM_GUEST: [u32; 4] =
    [VIRTIO_NET_F_CSUM, VIRTIO_NET_F_HOST_TSO4, VIRTIO_NET_F_HOST_TSO6, VIRTIO_NET_F_HOST_ECN];
/// What may be left to the guest, if it says so.
const TO_GUEST: [u32; 4] = [
    VIRTIO_NET_F_GUEST_CSUM,
    VIRTIO_NET_F_GUEST_TSO4,
    VIRTIO_NET_F_GUEST_TSO6,
    VIRTIO_NET_F_GUEST_ECN,
];

/// What a driver has agreed to, for the host's end of the cable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Agreed {
    /// The guest takes packets whose checksum is not made yet.
    pub checksum: bool,
    /// It takes longer ones than the network has, over IPv4, over IPv6, and with congestion notification.
    pub segments: [bool; 3],
}

impl Agreed {
    /// What is among these features.
    #[must_use]
    pub fn of(features: u64) -> Self {
        let [checksum, four, six, notified] =
            TO_GUEST.map(|number| features & bits(&[number]) != 0);
        // A segment has no checksum yet, so one goes with the other. Notification is one of segments.
        let segments = [four, six, notified && (four || six)];
        Self { checksum, segments: segments.map(|takes| takes && checksum) }
    }
}

/// An interface with this address for a guest with this RAM.
#[must_use]
pub fn device(mac: Mac, memory: GuestMemoryMmap, link: Arc<Link>) -> CarriedDevice {
    let of_rings = link.features() & (bits(&RINGS) | bits(&[VIRTIO_NET_F_MRG_RXBUF]));
    let description = Description {
        id: VIRTIO_ID_NET,
        offered: of_rings | bits(&FROM_GUEST) | bits(&TO_GUEST) | bits(&[VIRTIO_NET_F_MAC]),
        required: bits(&[VIRTIO_F_VERSION_1]),
        queues: QUEUES,
        queue_size: QUEUE_SIZE,
        config: mac.to_vec(),
    };
    CarriedDevice::new(description, memory, link)
}
