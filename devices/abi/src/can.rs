//! CAN: the controllers that the kernel of a PLC drives for its programs, and what is sent and received by them.
//!
//! Both are parts of the [I/O table](crate::io::IoTable). An object is what CANopen calls a process data object: an
//! identifier on one bus, whose data has places for points of process images.

/// Most controllers of a partition.
pub const CONTROLLERS_MAX: usize = 4;
/// Most objects of a partition.
pub const OBJECTS_MAX: usize = 64;
/// Registers of a controller, of a byte each.
pub const REGISTERS: u64 = 32;
/// Most data bytes of a frame.
pub const DATA_MAX: usize = 8;
/// Rates of a bus, in kbit/s. Not all controllers can do others.
pub const BIT_RATES: [u32; 8] = [10, 20, 50, 100, 125, 250, 500, 1000];

/// An SJA1000 with a crystal of 16 MHz.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Controller {
    /// Its name in the partition file, filled up with zeros.
    pub name: [u8; 32],
    /// Number of the I/O port, or address, of its register 0.
    pub place: u64,
    /// [`PORT`](crate::io::kind::PORT) or [`REGISTER`](crate::io::kind::REGISTER); 0 if there is no controller.
    pub kind: u8,
    /// From one register to the next, in bytes.
    pub stride: u8,
    /// Most frames that are taken from it when a job begins, and handed over to it when one ends.
    pub frames: u8,
    /// Zero.
    pub reserved: u8,
    /// Its bus: one of [`BIT_RATES`].
    pub kbit_per_s: u32,
}

impl Controller {
    /// No controller.
    pub const NONE: Self =
        Self { name: [0; 32], place: 0, kind: 0, stride: 0, frames: 0, reserved: 0, kbit_per_s: 0 };
}

/// What is sent or received by a controller, by its identifier.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Object {
    /// 11 bits, or 29 and [`EXTENDED`].
    pub identifier: u32,
    /// By which [controller](crate::io::IoTable::controllers).
    pub controller: u8,
    /// [`INPUT`](crate::io::INPUT) or [`OUTPUT`](crate::io::OUTPUT); 0 if there is no object.
    pub direction: u8,
    /// Data bytes of a frame that is sent. One that is received has to have at least as many.
    pub bytes: u8,
    /// [`ON_CHANGE`] or 0.
    pub flags: u8,
}

impl Object {
    /// No object.
    pub const NONE: Self = Self { identifier: 0, controller: 0, direction: 0, bytes: 0, flags: 0 };
}

/// A bit of [`Object::identifier`]: it has 29 bits.
pub const EXTENDED: u32 = 1 << 31;
/// A bit of [`Object::flags`]: it is sent when its data has changed, and else at the end of each job that writes it.
pub const ON_CHANGE: u8 = 1;

const _: () = {
    assert!(size_of::<Controller>() == 48);
    assert!(size_of::<Object>() == 8);
};
