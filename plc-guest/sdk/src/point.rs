//! Points: values that are mapped to I/O, watched and forced.

use core::cell::UnsafeCell;
use core::marker::PhantomData;
use core::ptr::{read_volatile, write_volatile};

use crate::{Text, Time};

/// Where the input image `%I` lies.
pub const INPUT: usize = 0x6800_0000;
/// Where the output image `%Q` lies.
pub const OUTPUT: usize = 0x6810_0000;
/// Where the markers `%M` lie.
pub const MARKER: usize = 0x6820_0000;

/// A type that a point can have.
///
/// # Safety
/// [`Value::Stored`] has the same size, and every pattern of bits is a value of it: an operator may force any.
pub unsafe trait Value: Copy + Send {
    /// The keyword of IEC 61131-3 for it, or for an element of it.
    const KEYWORD: &'static str;
    /// Elements of an array; 0 for a single value.
    const ELEMENTS: u64 = 0;
    /// Characters of a STRING, or of one that is an element.
    const CHARACTERS: u64 = 0;
    /// As it lies in memory.
    type Stored: Copy;
    /// The value of what lies in memory.
    fn load(stored: Self::Stored) -> Self;
}

macro_rules! values {
    ($($ty:ty => $keyword:literal),+ $(,)?) => {
        $(
            // SAFETY: a plain number.
            unsafe impl Value for $ty {
                const KEYWORD: &'static str = $keyword;
                type Stored = Self;
                fn load(stored: Self) -> Self {
                    stored
                }
            }
        )+
    };
}

values! {
    i8 => "SINT", i16 => "INT", i32 => "DINT", i64 => "LINT",
    u8 => "USINT", u16 => "UINT", u32 => "UDINT", u64 => "ULINT",
    f32 => "REAL", f64 => "LREAL", Time => "TIME",
}

// SAFETY: a byte of the same size. What is not 0 is true, as for the kernel.
unsafe impl Value for bool {
    const KEYWORD: &'static str = "BOOL";
    type Stored = u8;
    fn load(stored: u8) -> Self {
        stored != 0
    }
}

// SAFETY: plain bytes; a text ends with them if none is 0.
unsafe impl<const N: usize> Value for Text<N> {
    const KEYWORD: &'static str = "STRING";
    const CHARACTERS: u64 = N as u64;
    type Stored = Self;
    fn load(stored: Self) -> Self {
        stored.ended()
    }
}

// SAFETY: as its elements.
unsafe impl<T: Value, const N: usize> Value for [T; N] {
    const KEYWORD: &'static str = T::KEYWORD;
    // Of nested arrays all elements, one row behind the other.
    const ELEMENTS: u64 = {
        assert!(N > 0, "a point has one element at least");
        N as u64 * if T::ELEMENTS == 0 { 1 } else { T::ELEMENTS }
    };
    const CHARACTERS: u64 = T::CHARACTERS;
    type Stored = [T::Stored; N];
    fn load(stored: Self::Stored) -> Self {
        stored.map(T::load)
    }
}

/// A value in the input image.
pub struct Input<T>(usize, PhantomData<T>);

/// A value in the output image.
pub struct Output<T>(usize, PhantomData<T>);

/// A value among the markers.
pub struct Marker<T>(usize, PhantomData<T>);

/// One bit of the input image.
pub struct InputBit(usize, u8);

/// One bit of the output image.
pub struct OutputBit(usize, u8);

/// A variable of the program that is seen from outside.
///
/// Tasks may share it if it has 1, 2, 4 or 8 bytes: such a value is read and written whole. One of another size takes
/// several accesses, and a task that comes in between sees a part of each.
#[repr(transparent)]
pub struct Point<T>(UnsafeCell<T>);

// SAFETY: values are copied in and out by volatile accesses; see `Point`.
unsafe impl<T: Value> Sync for Point<T> {}

impl<T: Value> Input<T> {
    /// At this byte of `%I`. Made by [`input!`](crate::input), which also declares it.
    ///
    /// # Safety
    /// It is declared there: `takt plc build` then checks that all of it is inside of the image.
    #[doc(hidden)]
    #[must_use]
    pub const unsafe fn at(byte: usize) -> Self {
        Self(INPUT + byte, PhantomData)
    }

    /// The value in this cycle.
    #[must_use]
    pub fn get(&self) -> T {
        // SAFETY: the tool has checked that it is inside of the input image, which is mapped while the
        // program runs. Any bits are a value.
        T::load(unsafe { read_volatile(self.0 as *const Anywhere<T::Stored>) }.0)
    }
}

/// A value at a byte that need not be a multiple of its size: an input or output lies where its device has it.
#[repr(C, packed)]
#[derive(Clone, Copy)]
struct Anywhere<T: Copy>(T);

impl<T: Value> Output<T> {
    /// At this byte of `%Q`. Made by [`output!`](crate::output), which also declares it.
    ///
    /// # Safety
    /// As for [`Input::at`].
    #[doc(hidden)]
    #[must_use]
    pub const unsafe fn at(byte: usize) -> Self {
        Self(OUTPUT + byte, PhantomData)
    }

    /// The value that was set last.
    #[must_use]
    pub fn get(&self) -> T {
        // SAFETY: as for `Input::get`, of the output image.
        T::load(unsafe { read_volatile(self.0 as *const Anywhere<T::Stored>) }.0)
    }

    /// Sets it. It goes out when the task is done.
    pub fn set(&self, value: T) {
        // SAFETY: as for `get`; the output image is writable.
        unsafe { write_volatile(self.0 as *mut Anywhere<T>, Anywhere(value)) }
    }
}

impl<T: Value> Marker<T> {
    /// At this byte of `%M`. Made by [`marker!`](crate::marker), which also declares it.
    ///
    /// # Safety
    /// As for [`Input::at`].
    #[doc(hidden)]
    #[must_use]
    pub const unsafe fn at(byte: usize) -> Self {
        Self(MARKER + byte, PhantomData)
    }

    /// The value.
    #[must_use]
    pub fn get(&self) -> T {
        // SAFETY: as for `Input::get`, of the markers.
        T::load(unsafe { read_volatile(self.0 as *const Anywhere<T::Stored>) }.0)
    }

    /// Sets it. Other tasks see it at once.
    pub fn set(&self, value: T) {
        // SAFETY: as for `get`; the markers are writable.
        unsafe { write_volatile(self.0 as *mut Anywhere<T>, Anywhere(value)) }
    }
}

impl InputBit {
    /// Bit `bit` of this byte of `%I`. Made by [`input_bit!`](crate::input_bit).
    ///
    /// # Safety
    /// As for [`Input::at`].
    #[doc(hidden)]
    #[must_use]
    pub const unsafe fn at(byte: usize, bit: u8) -> Self {
        Self(byte, bit)
    }

    /// The value in this cycle.
    #[must_use]
    pub fn get(&self) -> bool {
        // SAFETY: it was promised when this was made.
        unsafe { Input::<u8>::at(self.0) }.get() >> self.1 & 1 == 1
    }
}

impl OutputBit {
    /// Bit `bit` of this byte of `%Q`. Made by [`output_bit!`](crate::output_bit).
    ///
    /// # Safety
    /// As for [`Input::at`].
    #[doc(hidden)]
    #[must_use]
    pub const unsafe fn at(byte: usize, bit: u8) -> Self {
        Self(byte, bit)
    }

    /// The value that was set last.
    #[must_use]
    pub fn get(&self) -> bool {
        // SAFETY: as for `InputBit::get`.
        unsafe { Output::<u8>::at(self.0) }.get() >> self.1 & 1 == 1
    }

    /// Sets it. The bits beside it are those of their own tasks.
    pub fn set(&self, value: bool) {
        // SAFETY: as for `InputBit::get`.
        let byte = unsafe { Output::<u8>::at(self.0) };
        byte.set(byte.get() & !(1 << self.1) | u8::from(value) << self.1);
    }
}

impl<T: Value> Point<T> {
    /// With this initial value. Made by [`point!`](crate::point), which also declares it.
    pub const fn new(value: T) -> Self {
        Self(UnsafeCell::new(value))
    }

    /// The value.
    #[must_use]
    pub fn get(&self) -> T {
        // SAFETY: the cell is valid, and any bits are a value of what is stored.
        T::load(unsafe { read_volatile(self.0.get().cast::<T::Stored>()) })
    }

    /// Sets it.
    pub fn set(&self, value: T) {
        // SAFETY: as for `get`. A task that interrupts this sees the old value or the new one if it has 1, 2, 4 or
        // 8 bytes.
        unsafe { write_volatile(self.0.get(), value) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pattern_of_bits_is_a_value() {
        static ON: Point<bool> = Point::new(true);
        assert!(ON.get());
        // As a device or an operator may have it.
        // SAFETY: this test is the only one that uses the point.
        unsafe { ON.0.get().cast::<u8>().write(0x80) };
        assert!(ON.get());
        ON.set(false);
        assert!(!ON.get());
        static ROW: Point<[[bool; 2]; 2]> = Point::new([[true, false]; 2]);
        // SAFETY: as above.
        unsafe { ROW.0.get().cast::<[u8; 4]>().write([0, 7, 1, 0]) };
        assert_eq!(ROW.get(), [[false, true], [true, false]]);
        assert_eq!(<[[Text<9>; 2]; 3] as Value>::ELEMENTS, 6);
        assert_eq!(<[[Text<9>; 2]; 3] as Value>::CHARACTERS, 9);
    }

    #[test]
    fn texts_and_times_are_read_as_they_were_set() {
        static NAME: Point<Text<4>> = Point::new(Text::new("a"));
        NAME.set(Text::new("four"));
        assert_eq!(NAME.get().as_str(), Ok("four"));
        static LEFT: Point<Time> = Point::new(Time::ZERO);
        LEFT.set(Time::from_millis(-3));
        assert_eq!(LEFT.get().as_nanos(), -3_000_000);
    }
}
