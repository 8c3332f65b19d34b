//! The registers by which a driver finds a device and hands it its queues (virtio 1.2, section
//! 4.2.2), and the device's configuration behind them.
//!
//! The driver reads them from a [page](super::page) of memory; what comes here is a write. Two registers are not here
//! either. The VMM lets KVM turn the write to [`NOTIFY`] into an event for the one who serves the queue, and that to
//! [`ACKNOWLEDGE`] into nothing, both without an exit to the vCPU's thread.
//!
//! So the reason of an interrupt stays: as long as a device has queues they are one, and a driver looks at its queues at
//! each interrupt.

use virtio_bindings::virtio_config::{
    VIRTIO_CONFIG_S_DRIVER_OK, VIRTIO_CONFIG_S_FEATURES_OK, VIRTIO_CONFIG_S_NEEDS_RESET,
};
use virtio_bindings::virtio_mmio::*;
use virtio_queue::{Queue, QueueT};
use vm_memory::GuestAddress;

use super::page::RegisterPage;
use super::{Description, Device};

/// Where a driver writes the number of a queue that has something new.
pub const NOTIFY: u64 = VIRTIO_MMIO_QUEUE_NOTIFY as u64;
/// Where a driver writes which reasons of an interrupt it has seen.
pub const ACKNOWLEDGE: u64 = VIRTIO_MMIO_INTERRUPT_ACK as u64;

/// "virt", little-endian.
const MAGIC: u32 = 0x7472_6976;
/// Version of the registers: that of virtio 1.
const VERSION: u32 = 2;
/// Red Hat's PCI vendor number, which virtual devices share.
const VENDOR: u32 = 0x1af4;

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
    const fn empty(size: u16) -> Self {
        Self { size: size as u32, ready: false, descriptors: 0, available: 0, used: 0 }
    }

    /// The queue, if the setting obeys the rules. Whether there is memory, the device sees.
    fn queue(&self, most: u16) -> Option<Queue> {
        let mut queue = Queue::new(most).ok()?;
        queue.try_set_size(u16::try_from(self.size).ok()?).ok()?;
        queue.try_set_desc_table_address(GuestAddress(self.descriptors)).ok()?;
        queue.try_set_avail_ring_address(GuestAddress(self.available)).ok()?;
        queue.try_set_used_ring_address(GuestAddress(self.used)).ok()?;
        queue.set_ready(self.ready);
        self.ready.then_some(queue)
    }
}

/// The registers of one device, for the thread of the guest's vCPU.
pub struct Registers {
    device: Box<dyn Device>,
    /// As the driver reads them. The status is kept there, since two threads change it.
    page: RegisterPage,
    accepted: u64,
    offered_select: u32,
    accepted_select: u32,
    queue_select: u32,
    queues: Vec<QueueSetting>,
}

impl Registers {
    /// A device as it is when the machine is switched on, and the page on which the guest sees its registers.
    #[must_use]
    pub fn new(device: impl Device + 'static, page: RegisterPage) -> Self {
        let Description { queues, queue_size, .. } = *device.description();
        let registers = Self {
            queues: vec![QueueSetting::empty(queue_size); queues],
            device: Box::new(device),
            page,
            accepted: 0,
            offered_select: 0,
            accepted_select: 0,
            queue_select: 0,
        };
        registers.show_what_never_changes();
        registers.clear_status();
        registers.show();
        registers
    }

    /// What the guest reads.
    #[cfg(test)]
    pub(crate) fn page(&self) -> &RegisterPage {
        &self.page
    }

    fn show_what_never_changes(&self) {
        let Description { id, config, .. } = self.device.description();
        for (register, value) in [
            (VIRTIO_MMIO_MAGIC_VALUE, MAGIC),
            (VIRTIO_MMIO_VERSION, VERSION),
            (VIRTIO_MMIO_DEVICE_ID, *id),
            (VIRTIO_MMIO_VENDOR_ID, VENDOR),
            // There is no shared memory: a length of -1.
            (VIRTIO_MMIO_SHM_LEN_LOW, u32::MAX),
            (VIRTIO_MMIO_SHM_LEN_HIGH, u32::MAX),
            (VIRTIO_MMIO_SHM_BASE_LOW, u32::MAX),
            (VIRTIO_MMIO_SHM_BASE_HIGH, u32::MAX),
        ] {
            self.page.set(register, value);
        }
        self.page.set_config(config);
    }

    fn clear_status(&self) {
        self.page.set(VIRTIO_MMIO_STATUS, 0);
        self.page.set(VIRTIO_MMIO_INTERRUPT_STATUS, 0);
    }

    /// Shows what the driver's last write has changed.
    fn show(&self) {
        let Description { offered, queue_size, .. } = *self.device.description();
        let queue = self.queue();
        for (register, value) in [
            (VIRTIO_MMIO_DEVICE_FEATURES, half(offered, self.offered_select)),
            (VIRTIO_MMIO_QUEUE_NUM_MAX, queue.map_or(0, |_| queue_size.into())),
            (VIRTIO_MMIO_QUEUE_READY, queue.map_or(0, |queue| queue.ready.into())),
        ] {
            self.page.set(register, value);
        }
    }

    fn queue(&self) -> Option<&QueueSetting> {
        self.queues.get(usize::try_from(self.queue_select).ok()?)
    }

    /// A write by the guest, `offset` bytes behind the first register. The device's configuration
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
            VIRTIO_MMIO_STATUS => self.set_status(value),
            _ => self.set_queue(offset, value),
        }
        self.show();
    }

    /// A queue that the device works on does not change.
    fn set_queue(&mut self, offset: u32, value: u32) {
        let Ok(number) = usize::try_from(self.queue_select) else { return };
        let Some(queue) = self.queues.get_mut(number) else { return };
        if queue.ready {
            if offset == VIRTIO_MMIO_QUEUE_READY && value == 0 {
                queue.ready = false;
                self.device.recall(number);
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

    fn has(&self, bit: u32) -> bool {
        self.page.get(VIRTIO_MMIO_STATUS) & bit != 0
    }

    /// Section 3.1.1 tells the order in which a driver sets the bits; none is cleared but by a
    /// reset.
    fn set_status(&mut self, value: u32) {
        let Description { offered, required, queue_size, .. } = *self.device.description();
        if value == 0 {
            // Afterwards no thread works on the queues, and none breaks the device down.
            self.device.reset();
            (self.offered_select, self.accepted_select, self.queue_select) = (0, 0, 0);
            self.accepted = 0;
            self.queues.fill(QueueSetting::empty(queue_size));
            self.clear_status();
            return;
        }
        let acceptable = self.accepted & !offered == 0 && self.accepted & required == required;
        let mut new = value & 0xff & !VIRTIO_CONFIG_S_NEEDS_RESET;
        new &= !self.page.get(VIRTIO_MMIO_STATUS);
        if !acceptable {
            // The driver reads the bit back, and gives up if it is not there.
            new &= !VIRTIO_CONFIG_S_FEATURES_OK;
        }
        self.page.add(VIRTIO_MMIO_STATUS, new);
        if new & VIRTIO_CONFIG_S_DRIVER_OK != 0 {
            self.start(queue_size);
        }
    }

    fn start(&mut self, queue_size: u16) {
        let queues = self.queues.iter().map(|queue| queue.queue(queue_size)).collect();
        // The first interrupt may come before the device says that it has started.
        self.page.set(VIRTIO_MMIO_INTERRUPT_STATUS, VIRTIO_MMIO_INT_VRING);
        let started = self.has(VIRTIO_CONFIG_S_FEATURES_OK)
            && self.device.start(self.accepted, queues).is_ok();
        if !started {
            self.page.set(VIRTIO_MMIO_INTERRUPT_STATUS, 0);
            self.page.break_down();
        }
    }
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
