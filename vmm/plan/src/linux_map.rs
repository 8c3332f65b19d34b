//! Where RAM ends and devices begin in the address space of a Linux guest.

/// End of the RAM below 4 GiB: from here to [`HOLE_END`] lie devices.
pub const HOLE_START: u64 = 0xc000_0000;
/// Where RAM goes on, above the devices.
pub const HOLE_END: u64 = 1 << 32;
