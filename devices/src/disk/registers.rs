//! The registers by which a driver finds the disk and hands it its queue (virtio 1.2, section
//! 4.2.2), and the disk's configuration behind them (section 5.2.4).
//!
//! A notification is no register here: the VMM lets KVM turn the write to [`NOTIFY`] into an event
//! for the disk's thread, without an exit to the vCPU's.

use std::sync::Arc;

use virtio_bindings::virtio_blk::{
    VIRTIO_BLK_F_FLUSH, VIRTIO_BLK_F_RO, VIRTIO_BLK_F_SEG_MAX, VIRTIO_BLK_F_SIZE_MAX,
};
use virtio_bindings::virtio_config::{
    VIRTIO_CONFIG_S_DRIVER_OK, VIRTIO_CONFIG_S_FEATURES_OK, VIRTIO_CONFIG_S_NEEDS_RESET,
    VIRTIO_F_VERSION_1,
};
use virtio_bindings::virtio_ids::VIRTIO_ID_BLOCK;
use virtio_bindings::virtio_mmio::*;
use virtio_bindings::virtio_ring::VIRTIO_RING_F_INDIRECT_DESC;
use virtio_queue::{Queue, QueueT};
use vm_memory::GuestAddress;

use super::handover::Handover;
use super::{QUEUE_SIZE, SEGMENT_BYTES_MAX, SEGMENTS_MAX, Shape};

/// Bytes that the registers take: a page, so that nothing else shares it.
pub const BYTES: u64 = 4096;
/// Where a driver writes the number of a queue that has something new.
pub const NOTIFY: u64 = VIRTIO_MMIO_QUEUE_NOTIFY as u64;

/// "virt", little-endian.
const MAGIC: u32 = 0x7472_6976;
/// Version of the registers: that of virtio 1.
const VERSION: u32 = 2;
/// Red Hat's PCI vendor number, which virtual devices share.
const VENDOR: u32 = 0x1af4;
/// Configuration that has a meaning: capacity, longest segment, most segments.
const CONFIG_BYTES: usize = 16;

/// What a driver says of a queue before it is used.
#[derive(Clone, Copy, Debug)]
struct QueueSetting {
    size: u32,
    ready: bool,
    descriptors: u64,
    available: u64,
    used: u64,
}

impl QueueSetting {
    const EMPTY: Self =
        Self { size: QUEUE_SIZE as u32, ready: false, descriptors: 0, available: 0, used: 0 };

    /// The queue, if the setting obeys the rules. Whether there is memory, the server sees.
    fn queue(&self) -> Option<Queue> {
        let mut queue = Queue::new(QUEUE_SIZE).ok()?;
        queue.try_set_size(u16::try_from(self.size).ok()?).ok()?;
        queue.try_set_desc_table_address(GuestAddress(self.descriptors)).ok()?;
        queue.try_set_avail_ring_address(GuestAddress(self.available)).ok()?;
        queue.try_set_used_ring_address(GuestAddress(self.used)).ok()?;
        queue.set_ready(self.ready);
        self.ready.then_some(queue)
    }
}

/// The registers of one disk, for the thread of the guest's vCPU.
pub struct Registers {
    shared: Arc<Handover>,
    config: [u8; CONFIG_BYTES],
    /// What the disk can do. A driver that would do less might take what it has written for safe
    /// before it is, so it has to accept `required` of it.
    offered: u64,
    required: u64,
    accepted: u64,
    offered_select: u32,
    accepted_select: u32,
    queue_select: u32,
    queue: QueueSetting,
    status: u32,
}

impl Registers {
    /// A disk as it is when the machine is switched on.
    #[must_use]
    pub fn new(shape: Shape, shared: Arc<Handover>) -> Self {
        let mut config = [0; CONFIG_BYTES];
        config[..8].copy_from_slice(&shape.sectors.to_le_bytes());
        config[8..12].copy_from_slice(&SEGMENT_BYTES_MAX.to_le_bytes());
        config[12..].copy_from_slice(&(SEGMENTS_MAX as u32).to_le_bytes());
        let kind = if shape.read_only { VIRTIO_BLK_F_RO } else { VIRTIO_BLK_F_FLUSH };
        let required = bit(VIRTIO_F_VERSION_1) | bit(kind);
        let optional = [VIRTIO_BLK_F_SIZE_MAX, VIRTIO_BLK_F_SEG_MAX, VIRTIO_RING_F_INDIRECT_DESC];
        Self {
            shared,
            config,
            offered: optional.into_iter().fold(required, |all, number| all | bit(number)),
            required,
            accepted: 0,
            offered_select: 0,
            accepted_select: 0,
            queue_select: 0,
            queue: QueueSetting::EMPTY,
            status: 0,
        }
    }

    /// A read by the guest, `offset` bytes behind the first register.
    pub fn read(&self, offset: u64, data: &mut [u8]) {
        data.fill(0);
        let config = offset.checked_sub(VIRTIO_MMIO_CONFIG.into());
        if let Some(offset) = config.and_then(|offset| usize::try_from(offset).ok()) {
            let bytes = self.config.get(offset..).unwrap_or_default();
            data.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        } else if let Ok(data) = <&mut [u8; 4]>::try_from(data) {
            *data = self.register(offset as u32).to_le_bytes();
        }
    }

    fn register(&self, offset: u32) -> u32 {
        match offset {
            VIRTIO_MMIO_MAGIC_VALUE => MAGIC,
            VIRTIO_MMIO_VERSION => VERSION,
            VIRTIO_MMIO_DEVICE_ID => VIRTIO_ID_BLOCK,
            VIRTIO_MMIO_VENDOR_ID => VENDOR,
            VIRTIO_MMIO_DEVICE_FEATURES => half(self.offered, self.offered_select),
            VIRTIO_MMIO_QUEUE_NUM_MAX if self.queue_select == 0 => QUEUE_SIZE.into(),
            VIRTIO_MMIO_QUEUE_READY if self.queue_select == 0 => self.queue.ready.into(),
            VIRTIO_MMIO_INTERRUPT_STATUS => self.shared.interrupts(),
            VIRTIO_MMIO_STATUS if self.shared.needs_reset() => {
                self.status | VIRTIO_CONFIG_S_NEEDS_RESET
            }
            VIRTIO_MMIO_STATUS => self.status,
            // There is no shared memory: a length of -1.
            VIRTIO_MMIO_SHM_LEN_LOW
            | VIRTIO_MMIO_SHM_LEN_HIGH
            | VIRTIO_MMIO_SHM_BASE_LOW
            | VIRTIO_MMIO_SHM_BASE_HIGH => u32::MAX,
            _ => 0,
        }
    }

    /// A write by the guest, `offset` bytes behind the first register. The disk's configuration
    /// does not change.
    pub fn write(&mut self, offset: u64, data: &[u8]) {
        let (Ok(offset), Ok(data)) = (u32::try_from(offset), <[u8; 4]>::try_from(data)) else {
            return;
        };
        let value = u32::from_le_bytes(data);
        match offset {
            VIRTIO_MMIO_DEVICE_FEATURES_SEL => self.offered_select = value,
            VIRTIO_MMIO_DRIVER_FEATURES_SEL => self.accepted_select = value,
            VIRTIO_MMIO_DRIVER_FEATURES if !self.has(VIRTIO_CONFIG_S_FEATURES_OK) => {
                set_half(&mut self.accepted, self.accepted_select, value);
            }
            VIRTIO_MMIO_QUEUE_SEL => self.queue_select = value,
            VIRTIO_MMIO_INTERRUPT_ACK => self.shared.acknowledge(value),
            VIRTIO_MMIO_STATUS => self.set_status(value),
            _ if self.queue_select == 0 => self.set_queue(offset, value),
            _ => {}
        }
    }

    /// A queue that the disk works on does not change.
    fn set_queue(&mut self, offset: u32, value: u32) {
        let queue = &mut self.queue;
        if queue.ready {
            if offset == VIRTIO_MMIO_QUEUE_READY && value == 0 {
                queue.ready = false;
                self.shared.recall();
            }
            return;
        }
        match offset {
            VIRTIO_MMIO_QUEUE_NUM => queue.size = value,
            VIRTIO_MMIO_QUEUE_READY => queue.ready = value == 1,
            VIRTIO_MMIO_QUEUE_DESC_LOW => set_half(&mut queue.descriptors, 0, value),
            VIRTIO_MMIO_QUEUE_DESC_HIGH => set_half(&mut queue.descriptors, 1, value),
            VIRTIO_MMIO_QUEUE_AVAIL_LOW => set_half(&mut queue.available, 0, value),
            VIRTIO_MMIO_QUEUE_AVAIL_HIGH => set_half(&mut queue.available, 1, value),
            VIRTIO_MMIO_QUEUE_USED_LOW => set_half(&mut queue.used, 0, value),
            VIRTIO_MMIO_QUEUE_USED_HIGH => set_half(&mut queue.used, 1, value),
            _ => {}
        }
    }

    const fn has(&self, bit: u32) -> bool {
        self.status & bit != 0
    }

    /// Section 3.1.1 tells the order in which a driver sets the bits; none is cleared but by a
    /// reset.
    fn set_status(&mut self, value: u32) {
        if value == 0 {
            self.shared.reset();
            (self.offered_select, self.accepted_select, self.queue_select) = (0, 0, 0);
            self.accepted = 0;
            self.queue = QueueSetting::EMPTY;
            self.status = 0;
            return;
        }
        let acceptable =
            self.accepted & !self.offered == 0 && self.accepted & self.required == self.required;
        let mut new = value & 0xff & !self.status & !VIRTIO_CONFIG_S_NEEDS_RESET;
        if !acceptable {
            // The driver reads the bit back, and gives up if it is not there.
            new &= !VIRTIO_CONFIG_S_FEATURES_OK;
        }
        self.status |= new;
        if new & VIRTIO_CONFIG_S_DRIVER_OK != 0 {
            match self.queue.queue() {
                Some(queue) if self.has(VIRTIO_CONFIG_S_FEATURES_OK) => self.shared.enable(queue),
                _ => self.shared.break_down(),
            }
        }
    }
}

const fn bit(number: u32) -> u64 {
    1 << number
}

/// The lower or the upper half of a value of 64 bits; there are no others.
const fn half(value: u64, select: u32) -> u32 {
    match select {
        0 => value as u32,
        1 => (value >> 32) as u32,
        _ => 0,
    }
}

const fn set_half(value: &mut u64, select: u32, half: u32) {
    match select {
        0 => *value = *value & !0xffff_ffff | half as u64,
        1 => *value = *value & 0xffff_ffff | (half as u64) << 32,
        _ => {}
    }
}
