//! Sockets between the host and a Linux guest: a virtio socket device (virtio 1.2, section 5.10) whose packets
//! another one moves ([`carried`](crate::virtio::carried)).
//!
//! The guest is known by a number, its context identifier (CID). Of the three queues the last is for events, of which
//! there is one kind: that the guest has moved to another host. A partition never does, so that queue is not carried
//! and whatever a driver makes of it is left alone.

use std::sync::Arc;

use virtio_bindings::virtio_config::VIRTIO_F_VERSION_1;
use virtio_bindings::virtio_ids::VIRTIO_ID_VSOCK;
use vm_memory::GuestMemoryMmap;

use crate::virtio::carried::{CarriedDevice, Link, QUEUE_SIZE, QUEUES, RINGS};
use crate::virtio::{Description, bits};

/// The device of the guest that has this identifier and this RAM.
#[must_use]
pub fn device(cid: u32, memory: GuestMemoryMmap, link: Arc<Link>) -> CarriedDevice {
    let description = Description {
        id: VIRTIO_ID_VSOCK,
        offered: link.features() & bits(&RINGS),
        required: bits(&[VIRTIO_F_VERSION_1]),
        queues: QUEUES + 1,
        queue_size: QUEUE_SIZE,
        config: u64::from(cid).to_le_bytes().to_vec(),
    };
    CarriedDevice::new(description, memory, link)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::virtio::carried::tests::{Call, Guest, KNOWN, Kind, QUEUE_PARTS};

    #[test]
    fn a_driver_finds_its_number_and_two_of_three_queues_are_carried() {
        let mut guest = Guest::new(Kind::Vsock);
        assert_eq!(guest.read(0x8), 19);
        assert_eq!([guest.read(0x100), guest.read(0x104)], [7, 0]);
        // The kernel's end knows more: sequences of packets, and a log of changed pages.
        let offered = guest.registers.offered();
        assert_eq!((offered, KNOWN & !offered != 0), (bits(&RINGS), true), "{offered:#x}");
        for (queue, most) in [(0, 256), (1, 256), (2, 256), (3, 0)] {
            guest.write(0x30, queue);
            assert_eq!(guest.read(0x34), most, "queue {queue}");
        }
        guest.start(offered, [256, 64], QUEUE_PARTS);
        assert_eq!((guest.read(0x70), guest.read(0x60)), (0xf, 1));
        let calls = guest.calls();
        let [Call::Start(agreed, rings)] = &calls[..] else { panic!("{calls:?}") };
        assert_eq!((*agreed, rings.map(|ring| ring.size())), (offered, [256, 64]));
    }

    #[test]
    fn the_queue_of_events_may_lie_nowhere() {
        let mut guest = Guest::new(Kind::Vsock);
        guest.registers.accept(1 << 32);
        let nowhere = [0xffff_ffff_ffff_fff0; 3];
        for (number, parts) in (0..).zip([QUEUE_PARTS[0], QUEUE_PARTS[1], nowhere]) {
            guest.registers.set_up_queue(number, 256, parts);
        }
        guest.registers.set_running();
        let calls = guest.calls();
        let [Call::Start(_, rings)] = &calls[..] else { panic!("{calls:?}") };
        guest.assert_inside(rings);
        // Taken away, it ends the others too: a driver does that before a reset only.
        guest.write(0x30, 2);
        guest.write(0x44, 0);
        assert_eq!(guest.calls(), [Call::Stop]);
    }
}
