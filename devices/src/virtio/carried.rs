//! A virtio device whose queues another one works on: the host's kernel.
//!
//! What is here is what a driver sees of such a device before its first packet: features, configuration, and
//! queues. Then two rings go to a [`Carrier`], and this code sees no packet, no notification and no interrupt until
//! the driver takes the device back.
//!
//! The kernel takes a ring as an address in Takt's own memory, and does not ask whose memory that is. So what
//! stands between a guest and the memory of Takt is one check here: there is a [`Ring`] only if each of its
//! parts lies in one region of the guest's RAM. What descriptors point at, the carrier checks itself, by the table of
//! the guest's RAM that it has.

#[cfg(test)]
#[path = "carried_tests.rs"]
pub(crate) mod tests;

use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use virtio_bindings::virtio_config::VIRTIO_F_VERSION_1;
use virtio_bindings::virtio_ring::{VIRTIO_RING_F_EVENT_IDX, VIRTIO_RING_F_INDIRECT_DESC};
use virtio_queue::{Queue, QueueT};
use vm_memory::{GuestAddress, GuestMemoryBackend, GuestMemoryMmap};

use super::{BadQueues, Description, Device};

/// Queues that are carried, the first ones of a device: to the guest, and from it.
pub const QUEUES: usize = 2;
/// Entries of each: what QEMU and the kernel's own test take.
pub const QUEUE_SIZE: u16 = 256;

/// What a carrier has to be able to do, and may, of rings of any kind.
///
/// Not `VIRTIO_F_ANY_LAYOUT`: its bit means something else to vhost-net (`VHOST_NET_F_VIRTIO_NET_HDR`), and
/// a driver of version 1 has it anyway.
pub(crate) const RINGS: [u32; 3] =
    [VIRTIO_F_VERSION_1, VIRTIO_RING_F_INDIRECT_DESC, VIRTIO_RING_F_EVENT_IDX];

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

/// What works on the rings.
pub trait Carrier: Send {
    /// The features of rings that it knows.
    fn features(&self) -> u64;

    /// Takes the rings, that to the guest first, with all features that the driver has agreed to.
    ///
    /// # Errors
    /// If it does not. Then it has none of them.
    fn start(&mut self, agreed: u64, rings: [Ring; QUEUES]) -> io::Result<()>;

    /// Gives them back. When this returns nothing of the guest's memory is touched any more. It may not have
    /// had any.
    fn stop(&mut self);
}

/// What outlives the machines that a guest has one after the other.
pub struct Link {
    /// `None` at the end of the run.
    carrier: Mutex<Option<Box<dyn Carrier>>>,
    running: AtomicBool,
    refusals: AtomicU64,
    error: OnceLock<io::Error>,
}

impl Link {
    /// With what works on its rings.
    #[must_use]
    pub fn new(carrier: impl Carrier + 'static) -> Self {
        Self {
            carrier: Mutex::new(Some(Box::new(carrier))),
            running: AtomicBool::new(false),
            refusals: AtomicU64::new(0),
            error: OnceLock::new(),
        }
    }

    /// Takes the guest's memory away from the carrier.
    pub fn reset(&self) {
        let mut carrier = self.carrier();
        // A guest that resets without end makes no call to the kernel but for what it has started.
        if self.running.swap(false, Ordering::SeqCst)
            && let Some(carrier) = carrier.as_mut()
        {
            carrier.stop();
        }
    }

    /// Drops the carrier. The guest gets and sends nothing any more.
    pub fn end(&self) {
        drop(self.carrier().take());
    }

    /// How often a driver has handed over queues that are not in its guest's RAM.
    #[must_use]
    pub fn refusals(&self) -> u64 {
        self.refusals.load(Ordering::SeqCst)
    }

    /// The first error of the carrier when it was given queues that are.
    #[must_use]
    pub fn error(&self) -> Option<&io::Error> {
        self.error.get()
    }

    /// The features of rings that the carrier knows.
    pub(crate) fn features(&self) -> u64 {
        self.carrier().as_ref().map_or(0, |carrier| carrier.features())
    }

    fn carrier(&self) -> MutexGuard<'_, Option<Box<dyn Carrier>>> {
        self.carrier.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn start(&self, agreed: u64, rings: Option<[Ring; QUEUES]>) -> Result<(), BadQueues> {
        let mut carrier = self.carrier();
        let Some(rings) = rings else {
            self.refusals.fetch_add(1, Ordering::SeqCst);
            return Err(BadQueues);
        };
        let carrier = carrier.as_mut().ok_or(BadQueues)?;
        if let Err(error) = carrier.start(agreed, rings) {
            // Of those that follow none is kept: a guest may try without end.
            let _ = self.error.set(error);
            return Err(BadQueues);
        }
        self.running.store(true, Ordering::SeqCst);
        Ok(())
    }
}

/// The side of such a device that is the guest's.
pub struct CarriedDevice {
    description: Description,
    /// Only the guest's RAM, not the rest of what it sees.
    memory: GuestMemoryMmap,
    link: Arc<Link>,
}

impl CarriedDevice {
    /// A device for a guest with this RAM.
    pub(crate) fn new(description: Description, memory: GuestMemoryMmap, link: Arc<Link>) -> Self {
        Self { description, memory, link }
    }
}

impl Device for CarriedDevice {
    fn description(&self) -> &Description {
        &self.description
    }

    fn start(&mut self, accepted: u64, queues: Vec<Option<Queue>>) -> Result<(), BadQueues> {
        let ring = |queue: Option<Queue>| Ring::of(&queue?, &self.memory);
        let rings: Option<Vec<Ring>> = queues.into_iter().take(QUEUES).map(ring).collect();
        self.link.start(accepted, rings.and_then(|rings| rings.try_into().ok()))
    }

    /// One queue alone is of no use: all are given back.
    fn recall(&mut self, _: usize) {
        self.link.reset();
    }

    fn reset(&mut self) {
        self.link.reset();
    }
}
