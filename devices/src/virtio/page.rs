//! The registers of a device as its guest reads them: a page of memory, which the guest cannot write.
//!
//! A read of such a register is a read of memory and costs no exit. That works since no read changes anything (virtio
//! 1.2, section 4.2.2): each thread that changes a register writes it here. A write by the guest is an exit.

use std::sync::atomic::{AtomicU32, Ordering};

use virtio_bindings::virtio_config::VIRTIO_CONFIG_S_NEEDS_RESET;
use virtio_bindings::virtio_mmio::{
    VIRTIO_MMIO_CONFIG, VIRTIO_MMIO_INT_CONFIG, VIRTIO_MMIO_INTERRUPT_STATUS, VIRTIO_MMIO_STATUS,
};
use vm_memory::{Bytes, GuestAddress, GuestMemoryBackend, GuestMemoryMmap, VolatileMemory};

/// Bytes that the registers take: a page, so that nothing else shares it.
pub const BYTES: u64 = 4096;

/// The page of one device, for the thread of the guest's vCPU and the thread that serves the queues.
#[derive(Clone)]
pub struct RegisterPage {
    memory: GuestMemoryMmap,
    start: GuestAddress,
}

impl RegisterPage {
    /// The page at `start` of this memory, a multiple of [`BYTES`]; `None` if there is none.
    #[must_use]
    pub fn new(memory: &GuestMemoryMmap, start: u64) -> Option<Self> {
        let page = Self { memory: memory.clone(), start: GuestAddress(start) };
        let is_there = start.is_multiple_of(BYTES)
            && page.memory.get_slice(page.start, BYTES as usize).is_ok();
        is_there.then_some(page)
    }

    /// Stops the device until its driver resets it, and says so to the driver (virtio 1.2, section 2.1.2).
    pub fn break_down(&self) {
        self.add(VIRTIO_MMIO_STATUS, VIRTIO_CONFIG_S_NEEDS_RESET);
        self.add(VIRTIO_MMIO_INTERRUPT_STATUS, VIRTIO_MMIO_INT_CONFIG);
    }

    /// A register.
    #[must_use]
    pub fn get(&self, register: u32) -> u32 {
        self.with(register, |word| u32::from_le(word.load(Ordering::SeqCst))).unwrap_or(0)
    }

    pub(super) fn set(&self, register: u32, value: u32) {
        self.with(register, |word| word.store(value.to_le(), Ordering::SeqCst));
    }

    /// Sets these bits of a register and leaves the others as they are.
    pub(super) fn add(&self, register: u32, bits: u32) {
        self.with(register, |word| word.fetch_or(bits.to_le(), Ordering::SeqCst));
    }

    /// The device's configuration, of which the driver may read any part.
    pub(super) fn set_config(&self, config: &[u8]) {
        let start = self.start.0 + u64::from(VIRTIO_MMIO_CONFIG);
        // Cannot fail: no device has more than the page, which is there.
        let _ = self.memory.write_slice(config, GuestAddress(start));
    }

    /// `None` cannot be: a register lies within the page, and the page is there.
    fn with<T>(&self, register: u32, access: impl FnOnce(&AtomicU32) -> T) -> Option<T> {
        let at = GuestAddress(self.start.0 + u64::from(register));
        let slice = self.memory.get_slice(at, size_of::<u32>()).ok()?;
        slice.get_atomic_ref(0).ok().map(access)
    }
}
