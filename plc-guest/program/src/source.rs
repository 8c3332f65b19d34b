//! From places in the code to places in the source.
//!
//! The trap map has the instructions that fault on purpose, or that fault when the program is wrong, and what
//! the fault means. The line map says which line any instruction was made from. With
//! both, a fault is told with file and line.

use crate::code::codes;
use crate::error::{ImageError, Where};
use crate::image::Image;
use crate::layout::{line, trap};
use crate::parse::is_code;
use crate::section::SectionKind;
use crate::units::CodeOffset;

codes! {
    /// What a fault at an instruction means.
    pub enum TrapKind: u8 {
        /// An index outside of an array.
        Bounds = 1,
        /// A division by zero, or a quotient that does not fit.
        ZeroDivide = 2,
        /// A null reference.
        Null = 3,
        /// A loop made more rounds than it may.
        LoopBudget = 4,
        /// A place that the compiler proved to be never reached.
        Unreachable = 5,
        /// A value outside of its subrange.
        Subrange = 6,
        /// The program gave up: a failed assertion, or a panic.
        User = 7,
    }
}

impl TrapKind {
    /// What the fault means, in words.
    #[must_use]
    pub const fn words(self) -> &'static str {
        match self {
            Self::Bounds => "index out of bounds",
            Self::ZeroDivide => "division by zero",
            Self::Null => "null reference",
            Self::LoopBudget => "a loop made too many rounds",
            Self::Unreachable => "code that must never be reached",
            Self::Subrange => "value out of its subrange",
            Self::User => "the program gave up",
        }
    }
}

/// A place in a source file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place<'a> {
    /// The file's path, as the compiler was given it.
    pub file: &'a str,
    /// The line, from 1.
    pub line: u32,
    /// The column, from 1; 0 if it is not known.
    pub column: u32,
}

/// An entry of the trap map.
#[derive(Clone, Copy, Debug)]
pub struct Trap<'a> {
    /// The instruction.
    pub at: CodeOffset,
    /// What a fault there means.
    pub kind: TrapKind,
    /// Where it is in the source, if the image says.
    pub place: Option<Place<'a>>,
}

/// An entry of the line map. It holds from its place up to the next entry's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line<'a> {
    /// The first instruction.
    pub at: CodeOffset,
    /// The file's path, as the compiler was given it.
    pub file: &'a str,
    /// The line, from 1; 0: none is known from here on.
    pub line: u32,
}

impl<'a> Trap<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Traps, index);
        let file = image.strings().get(record.text(trap::FILE));
        let (line, column) = (record.u32(trap::LINE), record.u32(trap::COLUMN));
        Self {
            at: CodeOffset(record.u32(trap::OFFSET)),
            // Only a trap that the check has let pass is read again.
            kind: TrapKind::from_code(record.u8(trap::KIND)).unwrap_or(TrapKind::User),
            place: (line != 0).then_some(Place { file, line, column }),
        }
    }
}

impl<'a> Line<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Lines, index);
        Self {
            at: CodeOffset(record.u32(line::OFFSET)),
            file: image.strings().get(record.text(line::FILE)),
            line: record.u32(line::LINE),
        }
    }
}

const ORDER: &str = "entries are in the order of the code, one for each place";
const INSIDE: &str = "it must be inside of the code";

pub(crate) fn check_traps(image: &Image<'_>) -> Result<(), ImageError> {
    let mut before = None;
    for index in image.indices(SectionKind::Traps) {
        let record = image.record(SectionKind::Traps, index);
        let whence = Where::new(record.offset, "trap", index);
        let at = record.u32(trap::OFFSET);
        whence.rule(is_code(image, at), "offset", INSIDE)?;
        whence.rule(before < Some(at), "offset", ORDER)?;
        before = Some(at);
        let kind = record.u8(trap::KIND);
        if TrapKind::from_code(kind).is_none() {
            return Err(whence.value("kind", kind.into(), "1 to 7"));
        }
        for at in 1..4 {
            whence.zero("reserved", record.u8(trap::KIND + at).into())?;
        }
        image.strings().path(whence, record.text(trap::FILE))?;
    }
    Ok(())
}

pub(crate) fn check_lines(image: &Image<'_>) -> Result<(), ImageError> {
    let mut before = None;
    for index in image.indices(SectionKind::Lines) {
        let record = image.record(SectionKind::Lines, index);
        let whence = Where::new(record.offset, "line", index);
        let at = record.u32(line::OFFSET);
        whence.rule(is_code(image, at), "offset", INSIDE)?;
        whence.rule(before < Some(at), "offset", ORDER)?;
        before = Some(at);
        image.strings().path(whence, record.text(line::FILE))?;
    }
    Ok(())
}
