//! The I/O table: what the inputs of programs are read from, and where their outputs are written to.
//!
//! The partition file maps points of the programs' process images to places: fields of messages, registers,
//! CAN objects, outputs of programs, simulated values. Takt checks the mapping and resolves all names, so that the guest finds
//! numbers only. The interrupts that release event tasks stand here too. The pages are there if the partition has
//! programs, and only then.

use crate::can::{CONTROLLERS_MAX, Controller, OBJECTS_MAX, Object};
use crate::{MAGIC, VERSION, memory};

/// Most mappings of a partition.
pub const MAPPINGS_MAX: usize = 255;

/// All mappings of a partition. It lies at [`memory::IO_TABLE`], read-only.
///
/// They are ordered by program, inputs before outputs and these before events, and those of one place one after the other: a register is
/// read or written once for all of its bits, and a message once for all of its fields.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct IoTable {
    /// [`MAGIC`].
    pub magic: u32,
    /// [`VERSION`].
    pub version: u32,
    /// How many of [`mappings`](Self::mappings) there are.
    pub count: u32,
    /// Zero.
    pub reserved: u32,
    /// The mappings; the rest is zero.
    pub mappings: [Mapping; MAPPINGS_MAX],
    /// The CAN controllers that the kernel drives; the rest is zero.
    pub controllers: [Controller; CONTROLLERS_MAX],
    /// What is sent and received by them; the rest is zero.
    pub objects: [Object; OBJECTS_MAX],
}

impl IoTable {
    /// No mappings.
    pub const EMPTY: IoTable = IoTable {
        magic: MAGIC,
        version: VERSION,
        count: 0,
        reserved: 0,
        mappings: [Mapping::NONE; MAPPINGS_MAX],
        controllers: [Controller::NONE; CONTROLLERS_MAX],
        objects: [Object::NONE; OBJECTS_MAX],
    };
}

/// One point of a process image, and its place outside of it.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mapping {
    /// The program, by its place in the program table.
    pub program: u8,
    /// [`INPUT`], [`OUTPUT`] or [`EVENT`].
    pub direction: u8,
    /// What is at the place: one of [`kind`].
    pub kind: u8,
    /// Of an output the task that writes it; of an input the task whose jobs read the place, or [`ANY_TASK`]; of an
    /// event the task that it releases.
    pub task: u8,
    /// The point is this bit of its byte, or [`WHOLE`].
    pub bit: u8,
    /// At the place it is this bit of the message or register, counted from bit 0 of byte
    /// [`field`](Self::field), or [`WHOLE`].
    pub place_bit: u8,
    /// Bytes of an access to a register; else 0.
    pub width: u8,
    /// A sum of [`flag`].
    pub flags: u8,
    /// First byte of the point in its image.
    pub offset: u32,
    /// Length of the point in bytes; 1 for a bit.
    pub bytes: u32,
    /// The elementary type of the point, as in program images; 0 if it has none. 1 is BOOL.
    pub ty: u32,
    /// First byte in the message, register or image at the place.
    pub field: u32,
    /// Place of the port in the port table, number of the I/O port, address of the register, or place of the program
    /// whose output it is, vector of the interrupt, or number of the [CAN object](IoTable::objects). Of a simulated value its lowest, as the bits of a binary64 number.
    pub place: u64,
    /// Of a simulated value its highest, as [`place`](Self::place); else 0.
    pub high: u64,
    /// Of a simulated value the time after which it repeats, in nanoseconds; else 0.
    pub period_ns: u64,
}

impl Mapping {
    /// No mapping.
    pub const NONE: Mapping = Mapping {
        program: 0,
        direction: 0,
        kind: 0,
        task: 0,
        bit: 0,
        place_bit: 0,
        width: 0,
        flags: 0,
        offset: 0,
        bytes: 0,
        ty: 0,
        field: 0,
        place: 0,
        high: 0,
        period_ns: 0,
    };
}

/// A [`Mapping::direction`]: from the place into the input image.
pub const INPUT: u8 = 1;
/// A [`Mapping::direction`]: from the output image to the place.
pub const OUTPUT: u8 = 2;
/// A [`Mapping::direction`]: no point at all; what is at the place releases an event task of the program.
pub const EVENT: u8 = 3;
/// A [`Mapping::task`]: the jobs of all tasks read the place.
pub const ANY_TASK: u8 = 255;
/// A [`Mapping::bit`] or [`Mapping::place_bit`]: not a bit, but whole bytes.
pub const WHOLE: u8 = 255;

/// Values of [`Mapping::kind`].
pub mod kind {
    /// A field of the newest message of a sampling channel.
    pub const FIELD: u8 = 1;
    /// Whether that message is valid; inputs only.
    pub const VALID: u8 = 2;
    /// The age of that message in nanoseconds, 64 bits; inputs only.
    pub const AGE: u8 = 3;
    /// An I/O port of a device.
    pub const PORT: u8 = 4;
    /// A register in the memory of a device.
    pub const REGISTER: u8 = 5;
    /// An output of a program; inputs only.
    pub const PROGRAM: u8 = 6;
    /// Simulated: always the lowest value.
    pub const CONSTANT: u8 = 7;
    /// Simulated: from the lowest value to the highest, and from the lowest again.
    pub const RAMP: u8 = 8;
    /// Simulated: a sine between the two, which begins in the middle and rises.
    pub const SINE: u8 = 9;
    /// Simulated: the lowest value for one half of the period, the highest for the other.
    pub const SQUARE: u8 = 10;
    /// The interrupt of a device; events only.
    pub const INTERRUPT: u8 = 11;
    /// A field of the data of a CAN object.
    pub const CAN: u8 = 12;
    /// The time since a CAN object was received, in nanoseconds, 64 bits; inputs only.
    pub const CAN_AGE: u8 = 13;
    /// How often a CAN object was received, modulo 2^32; inputs only.
    pub const CAN_COUNT: u8 = 14;
}

/// Bits of [`Mapping::flags`].
pub mod flag {
    /// An output is 0 when its program has stopped; an input of a channel is 0 while there is no valid message.
    /// Without it, both stay as they are.
    pub const ZERO: u8 = 1;
}

const _: () = {
    assert!(size_of::<Mapping>() == 48);
    assert!(
        size_of::<IoTable>() == 16 + MAPPINGS_MAX * 48 + CONTROLLERS_MAX * 48 + OBJECTS_MAX * 8
    );
    assert!(size_of::<IoTable>() as u64 <= memory::IO_TABLE_PAGES * memory::PAGE);
    assert!(memory::PROGRAM_TABLE + memory::PAGE <= memory::IO_TABLE);
    assert!(memory::IO_TABLE + memory::IO_TABLE_PAGES * memory::PAGE <= memory::CHANNELS);
};
