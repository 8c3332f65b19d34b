//! Variables and points: what can be watched, forced, kept over a restart and mapped to I/O.

use crate::bytes::Record;
use crate::code::codes;
use crate::elementary::Elementary;
use crate::error::{ImageError, Where};
use crate::image::Image;
use crate::layout::{NO_BIT, NO_TASK, variable};
use crate::name::order;
use crate::section::SectionKind;
use crate::source::Place;
use crate::types::TypeKind;
use crate::units::{TaskId, TypeId};

codes! {
    /// Where a variable lies.
    pub enum Area: u8 {
        /// The program's state.
        State = 1,
        /// The input image `%I`.
        Input = 2,
        /// The output image `%Q`.
        Output = 3,
        /// The markers `%M`.
        Marker = 4,
        /// The constants.
        Constant = 5,
    }
}

/// What may be done with a variable, and what happens to it: a set of bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags(u16);

impl Flags {
    /// None of them.
    pub const NONE: Self = Self(0);
    /// Keeps its value over a warm start.
    pub const RETAIN: Self = Self(1);
    /// Keeps its value over every start and download.
    pub const PERSISTENT: Self = Self(1 << 1);
    /// An input of the program: may be mapped to a source in the partition file.
    pub const INPUT: Self = Self(1 << 2);
    /// An output of the program: may be mapped to a sink in the partition file.
    pub const OUTPUT: Self = Self(1 << 3);
    /// Never written after the start.
    pub const CONSTANT: Self = Self(1 << 4);
    /// May be forced to a value by an operator.
    pub const FORCEABLE: Self = Self(1 << 5);

    /// A part of another variable, in the table for how it is retained alone.
    pub const PART: Self = Self(1 << 6);

    const ALL: u16 = (1 << 7) - 1;

    /// Those of these bits, if there are no others.
    #[must_use]
    pub const fn from_bits(bits: u16) -> Option<Self> {
        if bits & !Self::ALL == 0 { Some(Self(bits)) } else { None }
    }

    /// The bits.
    #[must_use]
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// Whether all of `other` are set.
    #[must_use]
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// These and `other`.
    #[must_use]
    pub const fn with(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// A variable or point.
#[derive(Clone, Copy, Debug)]
pub struct Variable<'a> {
    /// Its place in the table.
    pub index: u32,
    /// Its name with dots, such as `Main.level`.
    pub name: &'a str,
    /// Its type.
    pub ty: TypeId,
    /// Where it lies.
    pub area: Area,
    /// Its place in the area, in bytes.
    pub offset: u32,
    /// The bit in the byte, from 0, of a `BOOL` that is one bit.
    pub bit: Option<u8>,
    /// Its size in bytes.
    pub bytes: u32,
    /// What may be done with it.
    pub flags: Flags,
    /// The only task that writes it, if there is one.
    pub writer: Option<TaskId>,
    /// Where it is declared, if the image says.
    pub declared: Option<Place<'a>>,
}

impl<'a> Variable<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Variables, index);
        let (bit, writer) = (record.u8(variable::BIT), record.u16(variable::WRITER));
        let (file, line) =
            (image.strings().get(record.text(variable::FILE)), record.u32(variable::LINE));
        Self {
            index,
            name: image.strings().get(record.text(variable::NAME)),
            ty: TypeId(record.u32(variable::TYPE)),
            // Only a variable that `check` has let pass is read again.
            area: Area::from_code(record.u8(variable::AREA)).unwrap_or(Area::State),
            offset: record.u32(variable::OFFSET),
            bit: (bit != NO_BIT).then_some(bit),
            bytes: record.u32(variable::SIZE),
            flags: Flags(record.u16(variable::FLAGS)),
            writer: (writer != NO_TASK).then_some(TaskId(writer)),
            declared: (line != 0).then_some(Place { file, line, column: 0 }),
        }
    }

    /// True if its value outlives a start. Only values of the state do: inputs come from the plant, and outputs and
    /// markers begin with what `init` gives them.
    #[must_use]
    pub fn is_retained(&self) -> bool {
        let flags = self.flags.has(Flags::RETAIN) || self.flags.has(Flags::PERSISTENT);
        flags && self.area == Area::State
    }

    /// True if it is a part of another variable.
    #[must_use]
    pub fn is_part(&self) -> bool {
        self.flags.has(Flags::PART)
    }

    /// True if its value outlives a cold start, too.
    #[must_use]
    pub fn is_persistent(&self) -> bool {
        self.flags.has(Flags::PERSISTENT)
    }

    /// The address of its first byte in the program's address space.
    #[must_use]
    pub fn address(&self, image: &Image<'_>) -> u64 {
        image.area_address(self.area) + u64::from(self.offset)
    }
}

pub(crate) fn check(image: &Image<'_>) -> Result<(), ImageError> {
    let mut before = "";
    for index in image.indices(SectionKind::Variables) {
        let record = image.record(SectionKind::Variables, index);
        let whence = Where::new(record.offset, "variable", index);
        let name = image.strings().name(whence, record.text(variable::NAME))?;
        whence.rule(
            order(before, name).is_lt(),
            "name",
            "variables are in the order of their names, and no two have the same (in upper or lower case)",
        )?;
        before = name;
        check_one(image, whence, record)?;
    }
    Ok(())
}

fn check_one(image: &Image<'_>, whence: Where, record: Record<'_>) -> Result<(), ImageError> {
    let ty = image.type_of(TypeId(record.u32(variable::TYPE)));
    let ty = ty.ok_or_else(|| {
        whence.error("type", crate::Defect::Rule("there is no type of this number"))
    })?;
    let area = record.u8(variable::AREA);
    let area = Area::from_code(area).ok_or_else(|| whence.value("area", area.into(), "1 to 5"))?;
    let bytes = record.u32(variable::SIZE);
    whence.rule(bytes == ty.bytes, "size", "it must be the size of the type")?;
    let end = u64::from(record.u32(variable::OFFSET)) + u64::from(bytes);
    whence.at_most("offset", end, image.area_bytes(area).into())?;
    let bit = record.u8(variable::BIT);
    if bit != NO_BIT {
        whence.at_most("bit", bit.into(), 7)?;
        let is_bool = ty.kind == TypeKind::Elementary(Elementary::Bool);
        whence.rule(is_bool, "bit", "only a BOOL can be one bit")?;
    }
    let flags = record.u16(variable::FLAGS);
    let flags = Flags::from_bits(flags).ok_or_else(|| {
        whence.value("flags", flags.into(), "the sum of some of 1, 2, 4, 8, 16, 32, 64")
    })?;
    let constant = area == Area::Constant;
    whence.rule(
        !constant || flags.has(Flags::CONSTANT),
        "flags",
        "what lies in the constants is constant",
    )?;
    let writer = record.u16(variable::WRITER);
    let exists = writer == NO_TASK || image.task(TaskId(writer)).is_some();
    whence.rule(exists, "writer", "there is no task of this number")?;
    let written = writer != NO_TASK && (constant || area == Area::Input);
    whence.rule(!written, "writer", "no task writes an input or a constant")?;
    whence.zero("reserved", record.u16(variable::RESERVED).into())?;
    image.strings().path(whence, record.text(variable::FILE))
}
