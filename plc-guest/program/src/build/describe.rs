//! What the builder is told: the records of an image with strings of their own.

use alloc::string::String;
use alloc::vec::Vec;

use crate::units::{CodeOffset, Nanoseconds, TaskId, TypeId};
use crate::{Area, Direction, Elementary, Flags, ObjectKind, TrapKind, address};

/// A type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Type {
    /// Its name, or an empty string.
    pub name: String,
    /// Size of a value in bytes.
    pub bytes: u32,
    /// What it is.
    pub kind: Kind,
}

/// What a type is; see [`TypeKind`](crate::TypeKind).
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the same as in TypeKind")]
pub enum Kind {
    Elementary(Elementary),
    String { length: u32 },
    WString { length: u32 },
    Array { element: TypeId, lower: i64, upper: i64 },
    Structure { fields: Vec<Field> },
    FunctionBlock { fields: Vec<Field> },
    Enumeration { base: Elementary, values: Vec<(String, i64)> },
    Subrange { base: Elementary, low: i64, high: i64 },
    Reference { target: TypeId },
}

/// A field of a structure or function block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// Its type, added before the structure.
    pub ty: TypeId,
    /// Its place in the structure, in bytes.
    pub offset: u32,
}

impl Type {
    /// An elementary type.
    #[must_use]
    pub const fn elementary(elementary: Elementary) -> Self {
        let kind = Kind::Elementary(elementary);
        Self { name: String::new(), bytes: elementary.bytes(), kind }
    }

    /// A type of this size and without a name.
    #[must_use]
    pub const fn new(bytes: u32, kind: Kind) -> Self {
        Self { name: String::new(), bytes, kind }
    }

    /// The same with a name.
    #[must_use]
    pub fn named(self, name: &str) -> Self {
        Self { name: name.into(), ..self }
    }
}

/// A place in a source file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file's path.
    pub file: String,
    /// The line, from 1.
    pub line: u32,
    /// The column, from 1; 0 if it is not known.
    pub column: u32,
}

/// A variable or point.
#[derive(Clone, Debug)]
pub struct Variable {
    /// Its name with dots.
    pub name: String,
    /// Its type.
    pub ty: TypeId,
    /// Where it lies.
    pub area: Area,
    /// Its place in the area, in bytes.
    pub offset: u32,
    /// The bit in the byte, of a `BOOL` that is one bit.
    pub bit: Option<u8>,
    /// What may be done with it.
    pub flags: Flags,
    /// The only task that writes it.
    pub writer: Option<TaskId>,
    /// Where it is declared.
    pub declared: Option<Place>,
}

impl Variable {
    /// A variable without flags. In the constants it has the flag `CONSTANT`.
    #[must_use]
    pub fn new(name: &str, ty: TypeId, area: Area, offset: u32) -> Self {
        let flags = if area == Area::Constant { Flags::CONSTANT } else { Flags::NONE };
        let name = name.into();
        Self { name, ty, area, offset, bit: None, flags, writer: None, declared: None }
    }

    /// The same with more flags.
    #[must_use]
    pub fn with(self, flags: Flags) -> Self {
        Self { flags: self.flags.with(flags), ..self }
    }
}

/// A task.
#[derive(Clone, Debug)]
pub struct Task {
    /// Its name.
    pub name: String,
    /// When it is released.
    pub when: When,
    /// 0 is the most urgent.
    pub priority: u8,
    /// The execution time that one job may take.
    pub budget: Option<Nanoseconds>,
    /// How long after its release a job must be done, if not by the next release.
    pub deadline: Option<Nanoseconds>,
    /// Size of its stack in bytes; rounded up to pages.
    pub stack_bytes: u32,
    /// Its function.
    pub entry: CodeOffset,
    /// Overruns in a row that are tolerated.
    pub sensitivity: u16,
}

/// When a task is released.
#[derive(Clone, Debug)]
pub enum When {
    /// At fixed times.
    Cyclic {
        /// The time between two releases.
        period: Nanoseconds,
        /// The first release.
        offset: Nanoseconds,
    },
    /// When something happens.
    Event {
        /// What.
        source: Event,
        /// The least time between two releases.
        minimum: Nanoseconds,
    },
    /// Whenever no other task has work.
    Freewheeling,
}

/// What releases an event task; see [`EventSource`](crate::EventSource).
#[derive(Clone, Debug)]
#[allow(missing_docs, reason = "the same as in EventSource")]
pub enum Event {
    Channel(String),
    Doorbell(String),
    Interrupt(String),
    Rise(String),
}

impl Task {
    /// A task of priority 0 with 16 KiB of stack and default values otherwise.
    #[must_use]
    pub fn new(name: &str, when: When, entry: CodeOffset) -> Self {
        Self {
            name: name.into(),
            when,
            priority: 0,
            budget: None,
            deadline: None,
            stack_bytes: 4 * address::PAGE as u32,
            entry,
            sensitivity: 0,
        }
    }

    /// As [`Task::new`], cyclic from the partition's start on.
    #[must_use]
    pub fn cyclic(name: &str, period: Nanoseconds, entry: CodeOffset) -> Self {
        Self::new(name, When::Cyclic { period, offset: Nanoseconds(0) }, entry)
    }
}

/// A kernel object.
#[derive(Clone, Debug)]
pub struct Object {
    /// Its name.
    pub name: String,
    /// What it is.
    pub kind: ObjectKind,
}

/// A channel port.
#[derive(Clone, Debug)]
pub struct Port {
    /// Its name.
    pub name: String,
    /// Which way messages go.
    pub direction: Direction,
    /// Size of the longest message, in bytes.
    pub message_bytes: u32,
}

/// An entry of the trap map.
#[derive(Clone, Debug)]
pub struct Trap {
    /// The instruction.
    pub at: CodeOffset,
    /// What a fault there means.
    pub kind: TrapKind,
    /// Where it is in the source.
    pub place: Option<Place>,
}

/// An entry of the line map.
#[derive(Clone, Debug)]
pub struct Line {
    /// The first instruction.
    pub at: CodeOffset,
    /// The file's path; empty: from here on no line is known.
    pub file: String,
    /// The line, from 1; 0: from here on no line is known.
    pub line: u32,
}
