//! What a program declares about itself, for `takt plc build` to read.
//!
//! Each declaration is a record in the section `takt_declare` of the object files. The tool reads them after
//! linking, when all pointers in them are addresses, and leaves the section out of the image. `takt.h`
//! has the same record for C.

/// The section of the records.
pub const SECTION: &str = "takt_declare";
/// Version of the record.
pub const VERSION: u32 = 1;

/// One record: 112 bytes.
#[repr(C)]
pub struct Declaration {
    /// [`VERSION`].
    pub version: u32,
    /// One of [`kind`].
    pub kind: u32,
    /// The name's first byte.
    pub name: *const u8,
    /// The name's length in bytes.
    pub name_bytes: u64,
    /// The function, the variable, or the number that the tool fills in.
    pub address: *const (),
    /// First byte of a text: the type of a variable, the source of an event.
    pub text: *const u8,
    /// The text's length in bytes.
    pub text_bytes: u64,
    /// Numbers, by kind.
    pub numbers: [u64; 8],
}

// SAFETY: nothing reads the pointers while the program runs.
unsafe impl Sync for Declaration {}

/// What is declared, and what the numbers are then.
pub mod kind {
    /// The program: major, minor, patch, category.
    pub const PROGRAM: u32 = 1;
    /// The function that runs once for each start.
    pub const INIT: u32 = 2;
    /// A cyclic task: period, offset, priority, budget, deadline, stack, sensitivity.
    pub const CYCLIC: u32 = 3;
    /// An event task: as cyclic, with the least time between two events as period. The text is the source:
    /// `channel:`, `doorbell:`, `interrupt:` or `rise:` and a name.
    pub const EVENT: u32 = 4;
    /// A freewheeling task: as cyclic, without period, offset and deadline.
    pub const FREEWHEELING: u32 = 5;
    /// A variable: elements of an array or 0, flags, bit + 1 or 0, characters of a STRING. The text is the type's keyword.
    pub const VARIABLE: u32 = 6;
    /// A semaphore: ceiling.
    pub const SEMAPHORE: u32 = 7;
    /// A queue: bytes of a message, depth.
    pub const QUEUE: u32 = 8;
    /// A mailbox: bytes.
    pub const MAILBOX: u32 = 9;
    /// Event flags.
    pub const FLAGS: u32 = 10;
    /// A channel port that the program reads: bytes of a message.
    pub const PORT_IN: u32 = 11;
    /// A channel port that the program writes: bytes of a message.
    pub const PORT_OUT: u32 = 12;
    /// Which task writes an output: the name is the task's, the text is the point's.
    pub const WRITES: u32 = 13;
}

/// Flags of a variable: the bits of the image.
pub mod flag {
    /// Keeps its value over a warm start.
    pub const RETAIN: u64 = 1;
    /// Keeps its value over every start and download.
    pub const PERSISTENT: u64 = 1 << 1;
    /// An input of the program.
    pub const INPUT: u64 = 1 << 2;
    /// An output of the program.
    pub const OUTPUT: u64 = 1 << 3;
    /// Never written after the start.
    pub const CONSTANT: u64 = 1 << 4;
    /// May be forced to a value by an operator.
    pub const FORCEABLE: u64 = 1 << 5;
}

pub use crate::point::{INPUT, MARKER, OUTPUT};

impl Declaration {
    /// A record of this kind and name.
    #[must_use]
    pub const fn new(kind: u32, name: &'static str) -> Self {
        Self {
            version: VERSION,
            kind,
            name: name.as_ptr(),
            name_bytes: name.len() as u64,
            address: core::ptr::null(),
            text: core::ptr::null(),
            text_bytes: 0,
            numbers: [0; 8],
        }
    }

    /// The same about this address.
    #[must_use]
    pub const fn at(mut self, address: *const ()) -> Self {
        self.address = address;
        self
    }

    /// The same with this text.
    #[must_use]
    pub const fn text(mut self, text: &'static str) -> Self {
        self.text = text.as_ptr();
        self.text_bytes = text.len() as u64;
        self
    }

    /// The same with these numbers.
    #[must_use]
    pub const fn numbers(mut self, numbers: [u64; 8]) -> Self {
        self.numbers = numbers;
        self
    }
}

const _: () = assert!(size_of::<Declaration>() == 112);
