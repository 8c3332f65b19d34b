//! virtio devices behind memory-mapped registers (virtio 1.2, section 4.2), whatever they are.
//!
//! [`registers`] is the driver's side of each of them: how it finds a device, agrees on features and
//! hands over its queues. It reads them from a [`page`] of memory. What a device does with them is a [`Device`];
//! [`carried`] has those that give them to the host's kernel.

pub mod carried;
#[cfg(test)]
#[path = "driver_tests.rs"]
pub(crate) mod driver;
pub mod page;
pub mod registers;

use virtio_queue::Queue;

/// What a driver is told of a device, which does not change.
#[derive(Clone, Debug)]
pub struct Description {
    /// Its kind (section 5).
    pub id: u32,
    /// All features that it has, as bits.
    pub offered: u64,
    /// Those of them without which it does not work.
    pub required: u64,
    /// How many queues it has.
    pub queues: usize,
    /// Most entries of a queue.
    pub queue_size: u16,
    /// Its configuration, which a driver can only read.
    pub config: Vec<u8>,
}

/// A device cannot go on with the queues that its driver has handed over.
#[derive(Debug, PartialEq, Eq)]
pub struct BadQueues;

/// What is behind the registers. Each call is made on the thread of the guest's vCPU.
pub trait Device: Send {
    /// What it is.
    fn description(&self) -> &Description;

    /// The driver is ready: it has accepted these features, and this is what it made of each queue. The
    /// addresses are the guest's, and not checked. `None` is a queue that breaks the rules or was never
    /// made ready.
    ///
    /// # Errors
    /// If it cannot go on with that. Then it has none of them, and waits for a reset.
    fn start(&mut self, accepted: u64, queues: Vec<Option<Queue>>) -> Result<(), BadQueues>;

    /// The driver takes a single queue away. When this returns nothing of its memory is touched.
    fn recall(&mut self, queue: usize);

    /// The driver takes all away, and defects are forgotten. When this returns nothing of its memory is touched.
    fn reset(&mut self);
}

/// Features by their numbers, as bits.
pub(crate) fn bits(numbers: &[u32]) -> u64 {
    numbers.iter().fold(0, |all, number| all | 1 << number)
}
