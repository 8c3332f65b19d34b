//! The queue between the two threads of a disk.
//!
//! ```text
//!            enable                take
//!      Off ---------> Ready <---------------> Taken
//!       ^  <---------  |        give back       |
//!       |    reset     +-- reset: at once       | reset: Recalled,
//!       +---------------------------------------+ until it is given back
//! ```
//!
//! Only a reset waits, and at most for one request: the server looks between requests whether its
//! queue is recalled. The lock is held for a few words at a time, never during a request, so the
//! guest's registers answer at once while a file is slow.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use virtio_bindings::virtio_mmio::{VIRTIO_MMIO_INT_CONFIG, VIRTIO_MMIO_INT_VRING};
use virtio_queue::Queue;

enum Slot {
    /// There is no queue.
    Off,
    /// The guest has given one.
    Ready(Queue),
    /// The server has it.
    Taken,
    /// The server has it, and somebody waits for it to come back.
    Recalled,
}

/// What both threads of a disk know.
pub struct Handover {
    slot: Mutex<Slot>,
    returned: Condvar,
    /// The slot is `Recalled`; to be seen without the lock.
    recalled: AtomicBool,
    /// Why the guest is interrupted; bits of the register `InterruptStatus`.
    interrupts: AtomicU32,
    /// The guest has done what no driver does.
    needs_reset: AtomicBool,
}

impl Default for Handover {
    fn default() -> Self {
        Self {
            slot: Mutex::new(Slot::Off),
            returned: Condvar::new(),
            recalled: AtomicBool::new(false),
            interrupts: AtomicU32::new(0),
            needs_reset: AtomicBool::new(false),
        }
    }
}

impl Handover {
    /// Gives the server a queue. There must be none.
    pub(super) fn enable(&self, queue: Queue) {
        *self.lock() = Slot::Ready(queue);
    }

    /// Takes the queue away, waiting for the request that is being served. After it nothing touches
    /// the guest's memory until the guest asks for it again.
    pub(super) fn recall(&self) {
        let mut slot = self.lock();
        if matches!(*slot, Slot::Taken) {
            *slot = Slot::Recalled;
            self.recalled.store(true, Ordering::SeqCst);
        }
        while matches!(*slot, Slot::Recalled) {
            slot = self.returned.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
        *slot = Slot::Off;
    }

    /// As [`recall`](Self::recall), and forgets interrupts and what the guest has done.
    pub fn reset(&self) {
        self.recall();
        self.interrupts.store(0, Ordering::SeqCst);
        self.needs_reset.store(false, Ordering::SeqCst);
    }

    /// Why the guest is interrupted.
    pub(super) fn interrupts(&self) -> u32 {
        self.interrupts.load(Ordering::SeqCst)
    }

    /// The guest has seen these reasons.
    pub(super) fn acknowledge(&self, bits: u32) {
        self.interrupts.fetch_and(!bits, Ordering::SeqCst);
    }

    /// Stops the device until the guest resets it.
    pub(super) fn break_down(&self) {
        self.needs_reset.store(true, Ordering::SeqCst);
        self.interrupts.fetch_or(VIRTIO_MMIO_INT_CONFIG, Ordering::SeqCst);
    }

    /// True if the guest has to reset the device.
    pub(super) fn needs_reset(&self) -> bool {
        self.needs_reset.load(Ordering::SeqCst)
    }

    /// The queue, for the server to serve.
    pub(super) fn take(&self) -> Option<Queue> {
        let mut slot = self.lock();
        match std::mem::replace(&mut *slot, Slot::Off) {
            Slot::Ready(queue) => {
                *slot = Slot::Taken;
                Some(queue)
            }
            other => {
                *slot = other;
                None
            }
        }
    }

    /// True if the server is to give its queue back.
    pub(super) fn is_recalled(&self) -> bool {
        self.recalled.load(Ordering::SeqCst)
    }

    /// Ends what [`take`](Self::take) began: with the queue, and whether requests in it have been
    /// answered; or without one, if the guest broke it. True if the guest is to be interrupted.
    pub(super) fn give_back(&self, queue: Option<(Queue, bool)>) -> bool {
        let mut slot = self.lock();
        if matches!(*slot, Slot::Recalled) {
            *slot = Slot::Off;
            self.recalled.store(false, Ordering::SeqCst);
            self.returned.notify_all();
            return false;
        }
        match queue {
            Some((queue, answered)) => {
                *slot = Slot::Ready(queue);
                if answered {
                    self.interrupts.fetch_or(VIRTIO_MMIO_INT_VRING, Ordering::SeqCst);
                }
                answered
            }
            None => {
                *slot = Slot::Off;
                self.break_down();
                true
            }
        }
    }

    /// No panic happens under the lock, and each state is whole.
    fn lock(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use virtio_queue::QueueT;

    fn queue() -> Queue {
        Queue::new(8).unwrap()
    }

    #[test]
    fn a_queue_is_taken_once_and_given_back() {
        let handover = Handover::default();
        assert!(handover.take().is_none());
        handover.enable(queue());
        let taken = handover.take().unwrap();
        assert!(handover.take().is_none());
        assert!(!handover.give_back(Some((taken, false))));
        assert_eq!(handover.interrupts(), 0);
        let taken = handover.take().unwrap();
        assert!(handover.give_back(Some((taken, true))));
        assert_eq!(handover.interrupts(), VIRTIO_MMIO_INT_VRING);
        handover.acknowledge(VIRTIO_MMIO_INT_VRING);
        assert_eq!(handover.interrupts(), 0);
    }

    #[test]
    fn a_reset_waits_for_the_queue_and_leaves_no_interrupt() {
        let handover = Arc::new(Handover::default());
        handover.enable(queue());
        let taken = handover.take().unwrap();
        let other = handover.clone();
        let server = std::thread::spawn(move || {
            while !other.is_recalled() {
                std::thread::yield_now();
            }
            other.give_back(Some((taken, true)))
        });
        handover.reset();
        assert!(!server.join().unwrap(), "the guest would be interrupted");
        assert_eq!(handover.interrupts(), 0);
        assert!(handover.take().is_none());
        assert!(!handover.is_recalled());
    }

    #[test]
    fn a_broken_queue_is_gone_and_the_guest_is_told() {
        let handover = Handover::default();
        handover.enable(queue());
        handover.take().unwrap();
        assert!(handover.give_back(None));
        assert!(handover.needs_reset());
        assert_eq!(handover.interrupts(), VIRTIO_MMIO_INT_CONFIG);
        assert!(handover.take().is_none());
        handover.reset();
        assert!(!handover.needs_reset());
    }
}
