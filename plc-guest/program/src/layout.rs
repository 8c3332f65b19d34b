//! The format in numbers: where each field of the header and of the records lies.
//!
//! Reader and builder both take them from here. `docs/program-image.md` has them in tables.

/// The first bytes of each image.
pub const MAGIC: [u8; 8] = *b"TAKTPLC\0";
/// Version of the format that this crate reads and writes.
pub const FORMAT_VERSION: u16 = 1;
/// Version of addresses, calls and [`TaskInformation`](crate::TaskInformation).
pub const ABI_VERSION: u16 = 1;
/// Size of the header, in bytes.
pub const HEADER_BYTES: usize = 256;

/// Stands for "none" where an offset of code may be left out.
pub(crate) const NO_OFFSET: u32 = u32::MAX;
/// Stands for "none" where a task may be left out.
pub(crate) const NO_TASK: u16 = u16::MAX;
/// Stands for "no bit" in a variable that has bytes of its own.
pub(crate) const NO_BIT: u8 = u8::MAX;
/// Every section begins at a multiple of this.
pub(crate) const SECTION_ALIGNMENT: u64 = 8;

/// Fields of the header.
pub(crate) mod header {
    use core::ops::Range;

    pub const FORMAT: usize = 8;
    pub const ABI: usize = 10;
    pub const SIZE: usize = 12;
    pub const TOTAL: usize = 16;
    pub const LAYOUT_HASH: Range<usize> = 24..56;
    pub const CATEGORY: usize = 56;
    pub const VERSION: usize = 60;
    pub const RESERVED_16: usize = 66;
    pub const NAME: usize = 68;
    pub const SECTION_COUNT: usize = 76;
    pub const SECTION_TABLE: usize = 80;
    pub const INIT: usize = 88;
    pub const RESERVED_32: usize = 92;
    pub const HASH: Range<usize> = 96..128;
    pub const KEY: Range<usize> = 128..160;
    pub const SIGNATURE: Range<usize> = 160..224;
    pub const RESERVED_END: Range<usize> = 224..256;
}

/// Fields of an entry of the section table.
pub(crate) mod section {
    pub const KIND: usize = 0;
    pub const COUNT: usize = 4;
    pub const OFFSET: usize = 8;
    pub const SIZE: usize = 16;
    pub const MEMORY: usize = 24;
    pub const BYTES: usize = 32;
}

/// Fields of a type.
pub(crate) mod ty {
    pub const KIND: usize = 0;
    pub const BASE: usize = 1;
    pub const DEPTH: usize = 2;
    pub const SIZE: usize = 4;
    pub const NAME: usize = 8;
    pub const FIRST: usize = 16;
    pub const COUNT: usize = 20;
    pub const LOW: usize = 24;
    pub const HIGH: usize = 32;
    pub const BYTES: usize = 40;
}

/// Fields of a structure's field.
pub(crate) mod field {
    pub const NAME: usize = 0;
    pub const TYPE: usize = 8;
    pub const OFFSET: usize = 12;
    pub const BYTES: usize = 16;
}

/// Fields of a value of an enumeration.
pub(crate) mod enumerator {
    pub const NAME: usize = 0;
    pub const VALUE: usize = 8;
    pub const BYTES: usize = 16;
}

/// Fields of a variable.
pub(crate) mod variable {
    pub const NAME: usize = 0;
    pub const TYPE: usize = 8;
    pub const AREA: usize = 12;
    pub const BIT: usize = 13;
    pub const FLAGS: usize = 14;
    pub const OFFSET: usize = 16;
    pub const SIZE: usize = 20;
    pub const WRITER: usize = 24;
    pub const RESERVED: usize = 26;
    pub const LINE: usize = 28;
    pub const FILE: usize = 32;
    pub const BYTES: usize = 40;
}

/// Fields of a task.
pub(crate) mod task {
    pub const NAME: usize = 0;
    pub const KIND: usize = 8;
    pub const PRIORITY: usize = 9;
    pub const SENSITIVITY: usize = 10;
    pub const STACK: usize = 12;
    pub const PERIOD: usize = 16;
    pub const OFFSET: usize = 24;
    pub const BUDGET: usize = 32;
    pub const DEADLINE: usize = 40;
    pub const ENTRY: usize = 48;
    pub const SOURCE_KIND: usize = 52;
    pub const SOURCE: usize = 56;
    pub const BYTES: usize = 64;
}

/// Fields of a kernel object.
pub(crate) mod object {
    pub const NAME: usize = 0;
    pub const KIND: usize = 8;
    pub const A: usize = 12;
    pub const B: usize = 16;
    pub const RESERVED: usize = 20;
    pub const BYTES: usize = 24;
}

/// Fields of a channel port.
pub(crate) mod port {
    pub const NAME: usize = 0;
    pub const DIRECTION: usize = 8;
    pub const SIZE: usize = 12;
    pub const BYTES: usize = 16;
}

/// Fields of an entry of the trap map.
pub(crate) mod trap {
    pub const OFFSET: usize = 0;
    pub const KIND: usize = 4;
    pub const FILE: usize = 8;
    pub const LINE: usize = 16;
    pub const COLUMN: usize = 20;
    pub const BYTES: usize = 24;
}

/// Fields of an entry of the line map.
pub(crate) mod line {
    pub const OFFSET: usize = 0;
    pub const LINE: usize = 4;
    pub const FILE: usize = 8;
    pub const BYTES: usize = 16;
}

/// Fields of the requirements.
pub(crate) mod requirements {
    pub const INPUT: usize = 0;
    pub const OUTPUT: usize = 4;
    pub const MARKER: usize = 8;
    pub const RESERVED: usize = 12;
    pub const BYTES: usize = 16;
}
