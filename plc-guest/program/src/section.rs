//! The section table: what lies where in the file.

use crate::bytes::Record;
use crate::code::codes;
use crate::error::{Defect, ImageError, Where};
use crate::layout::{
    SECTION_ALIGNMENT, enumerator, field, line, object, port, requirements, section,
};
use crate::layout::{task, trap, ty, variable};
use crate::{address, limit};

codes! {
    /// What a section has. The sections of an image are in the order of these numbers.
    pub enum SectionKind: u32 {
        /// Bytes of names and paths, to which the other sections refer.
        Strings = 1,
        /// The requirements: one record.
        Requirements = 2,
        /// Types.
        Types = 3,
        /// Fields of structures and function blocks.
        Fields = 4,
        /// Values of enumerations.
        Enumerators = 5,
        /// Variables and points.
        Variables = 6,
        /// Tasks.
        Tasks = 7,
        /// Kernel objects.
        Objects = 8,
        /// Channel ports.
        Ports = 9,
        /// Trap map.
        Traps = 10,
        /// Line map.
        Lines = 11,
        /// Code, a segment.
        Code = 12,
        /// Constants, a segment.
        Constants = 13,
        /// Initial state, a segment.
        State = 14,
    }
}

/// How many kinds there are.
pub(crate) const KINDS: usize = SectionKind::ALL.len();

impl SectionKind {
    /// Size of a record, in bytes; 1 for sections that have bytes.
    #[must_use]
    pub(crate) const fn record_bytes(self) -> usize {
        match self {
            Self::Strings | Self::Code | Self::Constants | Self::State => 1,
            Self::Requirements => requirements::BYTES,
            Self::Types => ty::BYTES,
            Self::Fields => field::BYTES,
            Self::Enumerators => enumerator::BYTES,
            Self::Variables => variable::BYTES,
            Self::Tasks => task::BYTES,
            Self::Objects => object::BYTES,
            Self::Ports => port::BYTES,
            Self::Traps => trap::BYTES,
            Self::Lines => line::BYTES,
        }
    }

    /// Most records, or bytes.
    const fn limit(self) -> u32 {
        match self {
            Self::Strings => limit::STRING_BYTES,
            Self::Requirements => 1,
            Self::Types | Self::Fields | Self::Enumerators => limit::TYPES,
            Self::Variables => limit::VARIABLES,
            Self::Tasks => limit::TASKS,
            Self::Objects => limit::OBJECTS,
            Self::Ports => limit::PORTS,
            Self::Traps | Self::Lines => limit::PLACES,
            Self::Code => limit::CODE_BYTES,
            Self::Constants => limit::CONSTANT_BYTES,
            Self::State => limit::STATE_BYTES,
        }
    }

    /// Whether it is mapped into the program's address space.
    #[must_use]
    pub const fn is_segment(self) -> bool {
        matches!(self, Self::Code | Self::Constants | Self::State)
    }

    pub(crate) const fn alignment(self) -> u64 {
        if self.is_segment() { address::PAGE } else { SECTION_ALIGNMENT }
    }

    pub(crate) const fn index(self) -> usize {
        self as usize - 1
    }
}

/// Where one section lies in the file. All of it is inside.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Section {
    pub offset: usize,
    pub size: usize,
    pub count: u32,
    pub memory: u32,
}

/// The sections of an image by kind; one that is absent has size 0.
pub(crate) type Sections = [Section; KINDS];

/// Reads the table of `count` sections at `table`, and checks that they are in order, do not overlap
/// and have only zeros between them.
pub(crate) fn read(file: &[u8], table: usize, count: u32) -> Result<Sections, ImageError> {
    let mut sections = [Section::default(); KINDS];
    let mut last = 0;
    let mut end = table + count as usize * section::BYTES;
    for index in 0..count {
        let at = table + index as usize * section::BYTES;
        let record = Record::new(file.get(at..).unwrap_or_default(), at as u64);
        let whence = Where::new(at as u64, "section", index);
        let code = record.u32(section::KIND);
        let kind = SectionKind::from_code(code)
            .ok_or_else(|| whence.value("kind", code.into(), "1 to 14"))?;
        whence.rule(
            code > last,
            "kind",
            "sections must be in the order of their kinds, each once",
        )?;
        last = code;
        let found = one(file, record, whence, kind, end)?;
        end = found.offset + found.size;
        sections[kind.index()] = found;
    }
    let whence = Where::new(end as u64, "file", 0);
    let ends = sections[SectionKind::State.index()].offset != 0
        || sections[SectionKind::Constants.index()].offset != 0
        || sections[SectionKind::Code.index()].offset != 0;
    let length = if ends { address::pages(end as u64) } else { end as u64 };
    whence.rule(file.len() as u64 == length, "end", "the file must end with its last section")?;
    zeros(file, end, file.len())?;
    Ok(sections)
}

fn one(
    file: &[u8],
    record: Record<'_>,
    whence: Where,
    kind: SectionKind,
    end: usize,
) -> Result<Section, ImageError> {
    let (offset, size) = (record.u64(section::OFFSET), record.u64(section::SIZE));
    let found = file.len() as u64;
    let needed = offset.saturating_add(size);
    if needed > found {
        return Err(whence.error("size", Defect::Truncated { needed, found }));
    }
    let allowed = "the multiple of 8, for segments of 4096, that follows the section before";
    let expected = (end as u64).next_multiple_of(kind.alignment());
    if offset != expected {
        return Err(whence.value("offset", offset, allowed));
    }
    let count = record.u32(section::COUNT);
    whence.at_most("count", count.into(), kind.limit().into())?;
    let bytes = u64::from(count) * kind.record_bytes() as u64;
    whence.rule(size == bytes, "size", "the size must be the count times the record's size")?;
    let memory = record.u64(section::MEMORY);
    if kind == SectionKind::State {
        whence.at_most("memory size", memory, limit::STATE_BYTES.into())?;
        whence.rule(
            memory >= size,
            "memory size",
            "the state must not be smaller than its initial bytes",
        )?;
    } else {
        whence.rule(memory == size, "memory size", "it must be the size, except for the state")?;
    }
    // Both are within the file, whose length is a usize.
    let (offset, size) = (offset as usize, size as usize);
    zeros(file, end, offset)?;
    Ok(Section { offset, size, count, memory: memory as u32 })
}

/// Padding is zero, so that two images with the same content have the same bytes, and a page of a
/// segment shows only that segment.
fn zeros(file: &[u8], from: usize, to: usize) -> Result<(), ImageError> {
    let gap = file.get(from..to).unwrap_or_default();
    match gap.iter().position(|&byte| byte != 0) {
        None => Ok(()),
        Some(at) => {
            Err(Where::new((from + at) as u64, "padding", 0).value("byte", gap[at].into(), "0"))
        }
    }
}
