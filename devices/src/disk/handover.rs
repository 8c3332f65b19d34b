//! The queue between the two threads of a disk.
//!
//! ```text
//!            enable                take
//!      Off ---------> Ready <---------------> Taken
//!       ^               |        give back       |
//!       +-- recalled ---+-------- recalled ------+
//! ```
//!
//! Nothing waits for the file. A recall ends the server's lease at once, also while the file is being
//! written back for a minute: the server writes to the guest's memory, and takes what is for the file out of it, only under
//! the lock and with a lease that still holds, so that after a recall it does not. Rings, descriptors and headers it may read
//! behind one; what it makes of them is worth nothing. What it is doing then it does to the end,
//! to the file alone, and gives back a lease that is worth nothing. The next queue is served after that.
//!
//! virtio lets a driver write 0 to the status and read until it is 0 (1.2, section 2.1.1), so a reset
//! might take its time. Linux's driver of these registers does not read (`vm_reset` in
//! `drivers/virtio/virtio_mmio.c`): it frees the memory of its requests right away. So the reset has to
//! be complete when the write is.
//!
//! The lock is held for a few words, or while a piece of at most [`PIECE_BYTES`](super::PIECE_BYTES) is
//! copied, never during a call to the medium.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use virtio_queue::Queue;

use crate::virtio::page::RegisterPage;

enum Slot {
    /// There is no queue.
    Off,
    /// The guest has given one.
    Ready(Queue),
    /// The server has it.
    Taken,
}

/// The server's right to touch the guest's memory, until the queue is recalled.
#[derive(Debug)]
pub(super) struct Lease(u64);

/// The queue has been recalled: nothing of the guest's may be touched any more.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Recalled;

/// What both threads of a disk know.
pub struct Handover {
    slot: Mutex<Slot>,
    /// Number of recalls so far; changes under the lock only.
    recalls: AtomicU64,
    /// Where the guest is told that it has done what no driver does.
    page: RegisterPage,
    /// The first error of the medium.
    error: OnceLock<io::Error>,
    /// The guest has broken a queue.
    broken: AtomicBool,
}

impl Handover {
    /// Without a queue.
    #[must_use]
    pub fn new(page: RegisterPage) -> Self {
        Self {
            slot: Mutex::new(Slot::Off),
            recalls: AtomicU64::new(0),
            page,
            error: OnceLock::new(),
            broken: AtomicBool::new(false),
        }
    }

    /// The first error of the medium since the host opened it.
    pub fn error(&self) -> Option<&io::Error> {
        self.error.get()
    }

    /// Whether a guest has broken a queue since then.
    pub fn was_broken(&self) -> bool {
        self.broken.load(Ordering::SeqCst)
    }

    /// The guest has handed over what is no queue.
    pub(super) fn broke(&self) {
        self.broken.store(true, Ordering::SeqCst);
    }

    /// Takes note of an error of the medium; the first one stays.
    pub fn note(&self, error: io::Error) {
        let _ = self.error.set(error);
    }

    /// Gives the server a queue. There must be none.
    pub(super) fn enable(&self, queue: Queue) {
        *self.lock() = Slot::Ready(queue);
    }

    /// Takes the queue away. After it nothing touches the guest's memory until the guest asks for it
    /// again.
    pub fn recall(&self) {
        let mut slot = self.lock();
        self.recalls.fetch_add(1, Ordering::SeqCst);
        *slot = Slot::Off;
    }

    /// The queue, for the server to serve.
    pub(super) fn take(&self) -> Option<(Queue, Lease)> {
        let mut slot = self.lock();
        match std::mem::replace(&mut *slot, Slot::Off) {
            Slot::Ready(queue) => {
                *slot = Slot::Taken;
                Some((queue, Lease(self.recalls.load(Ordering::SeqCst))))
            }
            other => {
                *slot = other;
                None
            }
        }
    }

    /// Whether the lease still holds. It may end the moment after.
    pub(super) fn holds(&self, lease: &Lease) -> bool {
        self.recalls.load(Ordering::SeqCst) == lease.0
    }

    /// Touches the guest's memory, if the lease still holds; a recall waits for that.
    pub(super) fn touch<T>(&self, lease: &Lease, touch: impl FnOnce() -> T) -> Result<T, Recalled> {
        let _slot = self.lock();
        if self.holds(lease) { Ok(touch()) } else { Err(Recalled) }
    }

    /// Ends what [`take`](Self::take) began: with the queue, and whether requests in it have been
    /// answered; or without one, if the guest broke it. True if the guest is to be interrupted.
    pub(super) fn give_back(&self, lease: &Lease, queue: Option<(Queue, bool)>) -> bool {
        let mut slot = self.lock();
        if !self.holds(lease) {
            return false;
        }
        match queue {
            Some((queue, answered)) => {
                *slot = Slot::Ready(queue);
                answered
            }
            None => {
                *slot = Slot::Off;
                self.page.break_down();
                self.broke();
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
#[path = "handover_tests.rs"]
mod tests;
