//! Base addresses: where a function's memory lies, and how a guest asks for its size.
//!
//! On a PC a guest may move a function's memory by writing another base address. Here it may not:
//! memory slots are made once, before the first instruction, and a guest that could have them
//! moved could have them moved over its own RAM, at a time of its choosing. So Takt assigns the
//! addresses, and a base address register answers what was assigned whatever has been written to
//! it. Linux keeps what it finds if that is sound, and reports a register that does not take its
//! value if not.
//!
//! The exception is the question for the size (PCI 3.0, section 6.2.5.1): after all ones have been
//! written, the register shows which address bits can change.

use std::cmp::Reverse;
use std::ops::RangeInclusive;

use thiserror::Error;

/// Smallest memory of a base address register here, so that each can be mapped by itself.
const PAGE: u32 = 4096;
/// Bits of a base address register that tell of its kind.
const KIND: u32 = 0xf;
const PREFETCHABLE: u32 = 1 << 3;

/// The addresses that there are for a function's memory do not suffice.
#[derive(Debug, Error, PartialEq, Eq)]
#[error(
    "no room for {bytes:#x} bytes of PCI memory in {:#x} to {:#x}",
    .window.start(), .window.end()
)]
pub struct WindowFull {
    /// What was asked for.
    pub bytes: u64,
    /// All addresses of the bus.
    pub window: RangeInclusive<u32>,
}

/// Gives all memory of a function its place in `window`, in the order of its registers. What is
/// given for so many bytes is the next power of two, and at least a page.
///
/// The largest lie first, which is how Linux hands addresses out itself (`pdev_sort_resources` in
/// `drivers/pci/setup-bus.c`). It keeps those that it finds when it starts; but told to remove a
/// function and to look for it again it chooses anew, and what it chooses has to be what is
/// assigned already.
///
/// # Errors
/// [`WindowFull`].
pub fn assign<const N: usize>(
    window: &RangeInclusive<u32>,
    bytes: [u64; N],
) -> Result<[Bar; N], WindowFull> {
    let mut order: Vec<usize> = (0..N).collect();
    // A stable sort: of the same size, the lower register comes first.
    order.sort_by_key(|&n| Reverse(size(bytes[n])));
    let mut bars = bytes.map(|_| Bar::NOWHERE);
    let mut next = u64::from(*window.start());
    for n in order {
        let bytes = bytes[n];
        let full = || WindowFull { bytes, window: window.clone() };
        let size = size(bytes).ok_or_else(full)?;
        let start = next.next_multiple_of(size.into());
        next = start + u64::from(size);
        if next - 1 > u64::from(*window.end()) {
            return Err(full());
        }
        let address = u32::try_from(start).map_err(|_| full())?;
        bars[n] = Bar { address, size, asked_for_size: false };
    }
    Ok(bars)
}

/// The smallest size of memory that holds `bytes`, if it can lie below 4 GiB at all.
fn size(bytes: u64) -> Option<u32> {
    bytes.max(PAGE.into()).checked_next_power_of_two()?.try_into().ok()
}

/// A 32-bit base address register of memory that can be prefetched.
#[derive(Clone, Debug)]
pub struct Bar {
    address: u32,
    /// A power of two, at least a page.
    size: u32,
    asked_for_size: bool,
}

impl Bar {
    const NOWHERE: Self = Self { address: 0, size: PAGE, asked_for_size: false };

    /// Where the memory begins.
    #[must_use]
    pub const fn address(&self) -> u32 {
        self.address
    }

    pub(super) fn read(&self) -> u32 {
        // The bits that differ between two places where the memory could lie.
        let address = if self.asked_for_size { !(self.size - 1) } else { self.address };
        address | PREFETCHABLE
    }

    pub(super) fn write(&mut self, value: u32, bytes: u32) {
        let value = self.read() & !bytes | value & bytes;
        self.asked_for_size = value & !KIND == !KIND;
    }
}

#[cfg(test)]
#[path = "bar_tests.rs"]
mod tests;
