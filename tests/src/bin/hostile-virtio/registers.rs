//! The registers that a driver of any virtio device writes: virtio 1.2, section 4.2.2.

pub const ACCEPTED: u64 = 0x20;
pub const ACCEPTED_SELECT: u64 = 0x24;
pub const QUEUE_SELECT: u64 = 0x30;
pub const QUEUE_SIZE: u64 = 0x38;
pub const QUEUE_READY: u64 = 0x44;
pub const NOTIFY: u64 = 0x50;
pub const STATUS: u64 = 0x70;
pub const DESCRIPTORS: u64 = 0x80;
pub const AVAILABLE: u64 = 0x90;
pub const USED: u64 = 0xa0;
