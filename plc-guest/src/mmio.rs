//! The registers of devices whose memory the partition file gives to this guest.
//!
//! They lie between [`memory::DEVICES`] and [`memory::DEVICES_END`], at the addresses of the file.
//! An access reaches the device itself, without an exit. Where the file has put nothing, the host
//! answers instead: a read gives all ones, a write has no effect, and both are counted.

use core::marker::PhantomData;
use core::ptr;
use takt_abi::memory;

/// What a register can hold: a number that the processor reads or writes with one access.
pub trait Word: Copy + sealed::Sealed {}

mod sealed {
    pub trait Sealed {}
}

macro_rules! words {
    ($($word:ty),*) => {$(
        impl sealed::Sealed for $word {}
        impl Word for $word {}
    )*};
}
words!(u8, u16, u32, u64);

/// A register of a device.
///
/// Each [`read`](Self::read) and [`write`](Self::write) is one access to the device, in the order
/// of the program.
#[derive(Debug)]
pub struct Register<T> {
    address: u64,
    _word: PhantomData<T>,
}

impl<T: Word> Register<T> {
    /// The register at a guest-physical address; `None` unless it lies wholly in the area of
    /// devices and at a multiple of its own size.
    #[must_use]
    pub const fn at(address: u64) -> Option<Self> {
        let size = size_of::<T>() as u64;
        let inside = memory::DEVICES <= address && address <= memory::DEVICES_END - size;
        if inside && address.is_multiple_of(size) {
            Some(Self { address, _word: PhantomData })
        } else {
            None
        }
    }

    /// Reads it.
    #[must_use]
    pub fn read(&self) -> T {
        // SAFETY: `at` has checked the place, and `boot` maps all of that area; there is no memory
        // of this guest in it. Any bit pattern is a number.
        unsafe { ptr::read_volatile(self.address as *const T) }
    }

    /// Writes it.
    pub fn write(&self, value: T) {
        // SAFETY: as for `read`.
        unsafe { ptr::write_volatile(self.address as *mut T, value) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_register_lies_in_the_area_of_devices_at_a_multiple_of_its_size() {
        assert!(Register::<u32>::at(memory::DEVICES).is_some());
        assert!(Register::<u32>::at(memory::DEVICES_END - 4).is_some());
        assert!(Register::<u8>::at(memory::DEVICES_END - 1).is_some());
        let outside = [0, memory::INFORMATION, memory::DEVICES - 4, memory::DEVICES_END, u64::MAX];
        for address in outside {
            assert!(Register::<u32>::at(address).is_none(), "{address:#x}");
        }
        for off in 1..4 {
            assert!(Register::<u32>::at(memory::DEVICES + off).is_none());
        }
        assert!(Register::<u64>::at(memory::DEVICES_END - 4).is_none());
    }
}
