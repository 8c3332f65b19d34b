//! A network interface for a Linux guest: a virtio network device (virtio 1.2, section 5.1) whose packets
//! another one moves.
//!
//! What is here is what a driver sees of it before its first packet: features, its address, and two queues.
//! Then the rings go to a [`Carrier`], which is the kernel's vhost-net, and this code sees no packet, no
//! notification and no interrupt until the driver takes the device back.
//!
//! The kernel takes a ring as an address in Takt's own memory, and does not ask whose memory that is. So what
//! stands between a guest and the memory of Takt is one check here: there is a [`Ring`] only if each of its
//! parts lies in one region of the guest's RAM. What descriptors point at, the carrier checks itself, by the table of
//! the guest's RAM that it has.
//!
//! There is no queue for orders, so a driver cannot ask for other addresses or for several pairs of queues;
//! and no state of the link: it is always up.

#[cfg(test)]
mod tests;

use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use virtio_bindings::virtio_config::{VIRTIO_F_ANY_LAYOUT, VIRTIO_F_VERSION_1};
use virtio_bindings::virtio_ids::VIRTIO_ID_NET;
use virtio_bindings::virtio_mmio::{VIRTIO_MMIO_INT_CONFIG, VIRTIO_MMIO_INT_VRING};
use virtio_bindings::virtio_net::{
    VIRTIO_NET_F_CSUM, VIRTIO_NET_F_GUEST_CSUM, VIRTIO_NET_F_GUEST_ECN, VIRTIO_NET_F_GUEST_TSO4,
    VIRTIO_NET_F_GUEST_TSO6, VIRTIO_NET_F_HOST_ECN, VIRTIO_NET_F_HOST_TSO4, VIRTIO_NET_F_HOST_TSO6,
    VIRTIO_NET_F_MAC, VIRTIO_NET_F_MRG_RXBUF,
};
use virtio_bindings::virtio_ring::{VIRTIO_RING_F_EVENT_IDX, VIRTIO_RING_F_INDIRECT_DESC};
use virtio_queue::{Queue, QueueT};
use vm_memory::{GuestAddress, GuestMemoryBackend, GuestMemoryMmap};

use crate::virtio::{Description, Device, bits};

/// Queues: packets to the guest, and from it.
pub const QUEUES: usize = 2;
/// Entries of each: what QEMU and the kernel's own test take.
pub const QUEUE_SIZE: u16 = 256;
/// An Ethernet address.
pub type Mac = [u8; 6];

/// What a carrier has to be able to do, and may, of the rings themselves.
const RINGS: [u32; 5] = [
    VIRTIO_F_VERSION_1,
    VIRTIO_F_ANY_LAYOUT,
    VIRTIO_RING_F_INDIRECT_DESC,
    VIRTIO_RING_F_EVENT_IDX,
    VIRTIO_NET_F_MRG_RXBUF,
];
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

/// A queue that can be worked on: each of its parts lies in one region of the guest's RAM.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ring {
    size: u16,
    descriptors: u64,
    available: u64,
    used: u64,
}

impl Ring {
    /// The queue, if it is in the guest's memory.
    fn of(queue: &Queue, memory: &GuestMemoryMmap) -> Option<Self> {
        let place =
            |address, bytes| memory.get_slice(GuestAddress(address), bytes).ok().map(|_| address);
        let entries = usize::from(queue.size());
        Some(Self {
            size: queue.size(),
            descriptors: place(queue.desc_table(), 16 * entries)?,
            // Flags, index, entries, and the index at which to notify.
            available: place(queue.avail_ring(), 6 + 2 * entries)?,
            used: place(queue.used_ring(), 6 + 8 * entries)?,
        })
    }

    /// Entries, a power of two up to [`QUEUE_SIZE`].
    #[must_use]
    pub const fn size(&self) -> u16 {
        self.size
    }

    /// Guest-physical address of the descriptors.
    #[must_use]
    pub const fn descriptors(&self) -> u64 {
        self.descriptors
    }

    /// That of the ring that the driver writes.
    #[must_use]
    pub const fn available(&self) -> u64 {
        self.available
    }

    /// That of the ring that the carrier writes.
    #[must_use]
    pub const fn used(&self) -> u64 {
        self.used
    }
}

/// What the driver has agreed to, for who moves the packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Agreed {
    /// All features.
    pub features: u64,
    /// The guest takes packets whose checksum is not made yet.
    pub checksum: bool,
    /// It takes longer ones than the network has, over IPv4, over IPv6, and with congestion notification.
    pub segments: [bool; 3],
}

impl Agreed {
    fn of(features: u64) -> Self {
        let [checksum, segments @ ..] = TO_GUEST.map(|number| features & bits(&[number]) != 0);
        // A segment has no checksum yet, so one goes with the other.
        Self { features, checksum, segments: segments.map(|takes| takes && checksum) }
    }
}

/// What moves the packets.
pub trait Carrier: Send {
    /// The features of rings that it knows.
    fn features(&self) -> u64;

    /// Takes the rings, that to the guest first.
    ///
    /// # Errors
    /// If it does not. Then it has none of them.
    fn start(&mut self, agreed: Agreed, rings: [Ring; QUEUES]) -> io::Result<()>;

    /// Gives them back. When this returns nothing of the guest's memory is touched any more. It may not have
    /// had any.
    fn stop(&mut self);
}

/// What outlives the machines that a guest has one after the other.
pub struct Link {
    carrier: Mutex<Box<dyn Carrier>>,
    running: AtomicBool,
    broken: AtomicBool,
    refusals: AtomicU64,
}

impl Link {
    /// With what moves its packets.
    #[must_use]
    pub fn new(carrier: impl Carrier + 'static) -> Self {
        Self {
            carrier: Mutex::new(Box::new(carrier)),
            running: AtomicBool::new(false),
            broken: AtomicBool::new(false),
            refusals: AtomicU64::new(0),
        }
    }

    /// Takes the guest's memory away from the carrier, and forgets what the guest has done.
    pub fn reset(&self) {
        self.stop();
        self.broken.store(false, Ordering::SeqCst);
    }

    /// How often a driver has handed over queues that could not be used.
    #[must_use]
    pub fn refusals(&self) -> u64 {
        self.refusals.load(Ordering::SeqCst)
    }

    fn start(&self, agreed: Agreed, rings: Option<[Ring; QUEUES]>) {
        let mut carrier = self.carrier.lock().unwrap_or_else(PoisonError::into_inner);
        let started = rings.is_some_and(|rings| carrier.start(agreed, rings).is_ok());
        self.running.store(started, Ordering::SeqCst);
        if !started {
            self.refusals.fetch_add(1, Ordering::SeqCst);
            self.broken.store(true, Ordering::SeqCst);
        }
    }

    fn stop(&self) {
        let mut carrier = self.carrier.lock().unwrap_or_else(PoisonError::into_inner);
        // A guest that resets without end makes no call to the kernel but for what it has started.
        if self.running.swap(false, Ordering::SeqCst) {
            carrier.stop();
        }
    }
}

/// The side of an interface that is the guest's.
pub struct NetDevice {
    description: Description,
    /// Only the guest's RAM, not the rest of what it sees.
    memory: GuestMemoryMmap,
    link: Arc<Link>,
}

impl NetDevice {
    /// An interface with this address for a guest with this RAM.
    #[must_use]
    pub fn new(mac: Mac, memory: GuestMemoryMmap, link: Arc<Link>) -> Self {
        let known = link.carrier.lock().unwrap_or_else(PoisonError::into_inner).features();
        let offered =
            known & bits(&RINGS) | bits(&FROM_GUEST) | bits(&TO_GUEST) | bits(&[VIRTIO_NET_F_MAC]);
        let description = Description {
            id: VIRTIO_ID_NET,
            offered,
            required: bits(&[VIRTIO_F_VERSION_1]),
            queues: QUEUES,
            queue_size: QUEUE_SIZE,
            config: mac.to_vec(),
        };
        Self { description, memory, link }
    }
}

impl Device for NetDevice {
    fn description(&self) -> &Description {
        &self.description
    }

    fn start(&mut self, accepted: u64, queues: Vec<Option<Queue>>) {
        let ring = |queue: Option<Queue>| Ring::of(&queue?, &self.memory);
        let rings: Option<Vec<Ring>> = queues.into_iter().map(ring).collect();
        self.link.start(Agreed::of(accepted), rings.and_then(|rings| rings.try_into().ok()));
    }

    /// One queue alone is of no use: both are given back.
    fn recall(&mut self, _: usize) {
        self.link.stop();
    }

    fn reset(&mut self) {
        self.link.reset();
    }

    fn break_down(&mut self) {
        self.link.broken.store(true, Ordering::SeqCst);
    }

    fn needs_reset(&self) -> bool {
        self.link.broken.load(Ordering::SeqCst)
    }

    /// The carrier interrupts the guest without a word to this code, so its queues are a reason as long
    /// as it has them: the driver looks at both.
    fn interrupts(&self) -> u32 {
        let queues =
            if self.link.running.load(Ordering::SeqCst) { VIRTIO_MMIO_INT_VRING } else { 0 };
        let defect = if self.needs_reset() { VIRTIO_MMIO_INT_CONFIG } else { 0 };
        queues | defect
    }

    fn acknowledge(&self, _: u32) {}
}
