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
mod tests {
    use super::*;

    const WINDOW: RangeInclusive<u32> = 0xd000_0000..=0xd00f_ffff;

    fn places<const N: usize>(bytes: [u64; N]) -> Result<[(u32, u32); N], WindowFull> {
        let bars = assign(&WINDOW, bytes)?;
        Ok(bars.map(|bar| (bar.address & 0xf_ffff, bar.size)))
    }

    #[test]
    fn the_largest_lies_first_and_each_is_as_aligned_as_it_is_long() {
        assert_eq!(places([1, 1]), Ok([(0, 0x1000), (0x1000, 0x1000)]));
        assert_eq!(
            places([1, 0x3000, 0x4000]),
            Ok([(0x8000, 0x1000), (0, 0x4000), (0x4000, 0x4000)])
        );
        assert_eq!(
            places([1, 0x1000, 0x1001]),
            Ok([(0x2000, 0x1000), (0x3000, 0x1000), (0, 0x2000)])
        );
        let odd = assign(&(0xd000_3000..=0xd00f_ffff), [0x3000]);
        assert_eq!(odd.unwrap()[0].address, 0xd000_4000);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        for bytes in [0x10_0001, 1 << 31, (1 << 31) + 1, 1 << 32, u64::MAX] {
            assert_eq!(places([bytes]), Err(WindowFull { bytes, window: WINDOW }));
        }
        assert!(places([0x8_0000, 0x8_0000]).is_ok());
        let full = places([0x8_0000, 1, 0x8_0000]).unwrap_err();
        assert_eq!(
            full.to_string(),
            "no room for 0x1 bytes of PCI memory in 0xd0000000 to 0xd00fffff"
        );
        let top = 0xffff_f000..=u32::MAX;
        assert!(assign(&top, [1]).is_ok());
        assert!(assign(&top, [1, 1]).is_err());
    }

    #[test]
    fn a_guest_learns_the_size_and_finds_the_address_again() {
        let [_, mut bar] = assign(&WINDOW, [0x3000, 0x4000]).unwrap();
        let original = bar.read();
        assert_eq!(original, 0xd000_4008);
        bar.write(u32::MAX, u32::MAX);
        assert_eq!(bar.read(), 0xffff_c008);
        bar.write(original, u32::MAX);
        assert_eq!(bar.read(), original);
    }

    #[test]
    fn a_guest_cannot_move_the_memory() {
        let [mut bar] = assign(&WINDOW, [1]).unwrap();
        for (value, bytes) in [(0, u32::MAX), (0xe000_0000, u32::MAX), (0x12, 0xff), (!0, 0xff00)] {
            bar.write(value, bytes);
            assert_eq!(bar.read(), 0xd000_0008, "{value:#x} {bytes:#x}");
        }
    }
}
