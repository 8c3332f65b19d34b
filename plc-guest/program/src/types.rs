//! The types of variables, so that tools can show and set values.
//!
//! A type refers only to types before it in the table (a reference may refer to any), and says how
//! deep it is nested, so a reader can recurse over it: at most [`limit::TYPE_DEPTH`] deep, and never more parts
//! than the type has bytes, because every part has at least one byte of its own.

use crate::bytes::Record;
use crate::code::codes;
use crate::error::{Defect, ImageError, Where};
use crate::image::{Image, IndexRange};
use crate::layout::{enumerator, field, ty};
use crate::limit;
use crate::section::SectionKind;
use crate::units::TypeId;

codes! {
    /// An elementary type of IEC 61131-3 (edition 3, table 10).
    pub enum Elementary: u8 {
        /// One byte that is 0 or 1, or one bit of the process image.
        Bool = 1,
        /// Signed, 8 bits.
        Sint = 2,
        /// Signed, 16 bits.
        Int = 3,
        /// Signed, 32 bits.
        Dint = 4,
        /// Signed, 64 bits.
        Lint = 5,
        /// Unsigned, 8 bits.
        Usint = 6,
        /// Unsigned, 16 bits.
        Uint = 7,
        /// Unsigned, 32 bits.
        Udint = 8,
        /// Unsigned, 64 bits.
        Ulint = 9,
        /// Bit string, 8 bits.
        Byte = 10,
        /// Bit string, 16 bits.
        Word = 11,
        /// Bit string, 32 bits.
        Dword = 12,
        /// Bit string, 64 bits.
        Lword = 13,
        /// IEEE 754 binary32.
        Real = 14,
        /// IEEE 754 binary64.
        Lreal = 15,
        /// Signed nanoseconds, 64 bits.
        Time = 16,
        /// Signed nanoseconds, 64 bits.
        Ltime = 17,
        /// Nanoseconds since 1970-01-01, signed, 64 bits; a whole day.
        Date = 18,
        /// As `DATE`.
        Ldate = 19,
        /// Nanoseconds since midnight, 64 bits.
        Tod = 20,
        /// As `TOD`.
        Ltod = 21,
        /// Nanoseconds since 1970-01-01, signed, 64 bits.
        Dt = 22,
        /// As `DT`.
        Ldt = 23,
        /// A character, 8 bits.
        Char = 24,
        /// A character, 16 bits (UTF-16).
        Wchar = 25,
    }
}

impl Elementary {
    /// Size in bytes.
    #[must_use]
    pub const fn bytes(self) -> u32 {
        match self {
            Self::Bool | Self::Sint | Self::Usint | Self::Byte | Self::Char => 1,
            Self::Int | Self::Uint | Self::Word | Self::Wchar => 2,
            Self::Dint | Self::Udint | Self::Dword | Self::Real => 4,
            Self::Lint | Self::Ulint | Self::Lword | Self::Lreal | Self::Time | Self::Ltime => 8,
            Self::Date | Self::Ldate | Self::Tod | Self::Ltod | Self::Dt | Self::Ldt => 8,
        }
    }

    /// The type's keyword in IEC 61131-3.
    #[must_use]
    pub const fn keyword(self) -> &'static str {
        const KEYWORDS: [&str; 25] = [
            "BOOL", "SINT", "INT", "DINT", "LINT", "USINT", "UINT", "UDINT", "ULINT", "BYTE",
            "WORD", "DWORD", "LWORD", "REAL", "LREAL", "TIME", "LTIME", "DATE", "LDATE", "TOD",
            "LTOD", "DT", "LDT", "CHAR", "WCHAR",
        ];
        KEYWORDS[self as usize - 1]
    }

    /// Whether it is one of the integer types or bit strings, which an enumeration or a subrange can have as base.
    #[must_use]
    pub const fn is_integer(self) -> bool {
        (self as u8) >= Self::Sint as u8 && (self as u8) <= Self::Lword as u8
    }
}

/// A type.
#[derive(Clone, Debug)]
pub struct Type<'a> {
    /// Its number.
    pub id: TypeId,
    /// Its name; empty if it has none.
    pub name: &'a str,
    /// Size of a value in bytes.
    pub bytes: u32,
    /// Nesting: 1 for a type without parts.
    pub depth: u16,
    /// What it is.
    pub kind: TypeKind,
    parts: IndexRange,
}

/// What a type is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TypeKind {
    /// An elementary type.
    Elementary(Elementary),
    /// `STRING[length]`: characters of 8 bits. The text ends at the first zero byte.
    String {
        /// Most characters. The size has at least one byte more.
        length: u32,
    },
    /// `WSTRING[length]`: characters of 16 bits. The text ends at the first zero.
    WString {
        /// Most characters. The size has at least two bytes more.
        length: u32,
    },
    /// `ARRAY[lower..upper] OF element`; more dimensions are arrays of arrays.
    Array {
        /// Type of the elements, which lie without gaps.
        element: TypeId,
        /// Lowest index.
        lower: i64,
        /// Highest index.
        upper: i64,
    },
    /// A structure, see [`Image::fields`].
    Structure,
    /// An instance of a function block, see [`Image::fields`].
    FunctionBlock,
    /// An enumeration, see [`Image::values`].
    Enumeration {
        /// The integer type that it is kept as.
        base: Elementary,
    },
    /// A subrange of an integer type.
    Subrange {
        /// The integer type.
        base: Elementary,
        /// Lowest value (of an unsigned base: its bits).
        low: i64,
        /// Highest value (of an unsigned base: its bits).
        high: i64,
    },
    /// `REF_TO target`: an address of 64 bits.
    Reference {
        /// Type of what it refers to.
        target: TypeId,
    },
}

/// Numbers of the kinds in the file.
pub(crate) mod kind {
    pub const ELEMENTARY: u8 = 1;
    pub const STRING: u8 = 2;
    pub const WSTRING: u8 = 3;
    pub const ARRAY: u8 = 4;
    pub const STRUCTURE: u8 = 5;
    pub const FUNCTION_BLOCK: u8 = 6;
    pub const ENUMERATION: u8 = 7;
    pub const SUBRANGE: u8 = 8;
    pub const REFERENCE: u8 = 9;
}

/// A field of a structure or a function block.
#[derive(Clone, Copy, Debug)]
pub struct Field<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its type.
    pub ty: TypeId,
    /// Its place in the structure, in bytes.
    pub offset: u32,
}

/// A value of an enumeration.
#[derive(Clone, Copy, Debug)]
pub struct Enumerator<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its number.
    pub value: i64,
}

impl<'a> Type<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Types, index);
        let first = record.u32(ty::FIRST);
        Self {
            id: TypeId(index),
            name: image.strings().get(record.text(ty::NAME)),
            bytes: record.u32(ty::SIZE),
            depth: record.u16(ty::DEPTH),
            // Only a type that `check` has let pass is read again.
            kind: kind_of(record).unwrap_or(TypeKind::Structure),
            parts: IndexRange { next: first, end: first.saturating_add(record.u32(ty::COUNT)) },
        }
    }

    pub(crate) fn fields(&self) -> IndexRange {
        let has = matches!(self.kind, TypeKind::Structure | TypeKind::FunctionBlock);
        if has { self.parts.clone() } else { IndexRange { next: 0, end: 0 } }
    }

    pub(crate) fn values(&self) -> IndexRange {
        let has = matches!(self.kind, TypeKind::Enumeration { .. });
        if has { self.parts.clone() } else { IndexRange { next: 0, end: 0 } }
    }
}

impl<'a> Field<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Fields, index);
        Self {
            name: image.strings().get(record.text(field::NAME)),
            ty: TypeId(record.u32(field::TYPE)),
            offset: record.u32(field::OFFSET),
        }
    }
}

impl<'a> Enumerator<'a> {
    pub(crate) fn read(image: &Image<'a>, index: u32) -> Self {
        let record = image.record(SectionKind::Enumerators, index);
        Self {
            name: image.strings().get(record.text(enumerator::NAME)),
            value: record.i64(enumerator::VALUE),
        }
    }
}

fn kind_of(record: Record<'_>) -> Option<TypeKind> {
    let base = Elementary::from_code(record.u8(ty::BASE));
    let integer = base.filter(|base| base.is_integer());
    let (low, high) = (record.i64(ty::LOW), record.i64(ty::HIGH));
    let other = TypeId(record.u32(ty::FIRST));
    let length = record.u32(ty::COUNT);
    match record.u8(ty::KIND) {
        kind::ELEMENTARY => base.map(TypeKind::Elementary),
        kind::STRING => Some(TypeKind::String { length }),
        kind::WSTRING => Some(TypeKind::WString { length }),
        kind::ARRAY => Some(TypeKind::Array { element: other, lower: low, upper: high }),
        kind::STRUCTURE => Some(TypeKind::Structure),
        kind::FUNCTION_BLOCK => Some(TypeKind::FunctionBlock),
        kind::ENUMERATION => integer.map(|base| TypeKind::Enumeration { base }),
        kind::SUBRANGE => integer.map(|base| TypeKind::Subrange { base, low, high }),
        kind::REFERENCE => Some(TypeKind::Reference { target: other }),
        _ => None,
    }
}

pub(crate) fn check(image: &Image<'_>) -> Result<(), ImageError> {
    for index in image.indices(SectionKind::Types) {
        check_type(image, index)?;
    }
    Ok(())
}

fn check_type(image: &Image<'_>, index: u32) -> Result<(), ImageError> {
    let record = image.record(SectionKind::Types, index);
    let whence = Where::new(record.offset, "type", index);
    image.strings().optional_name(whence, record.text(ty::NAME))?;
    let Some(kind) = kind_of(record) else {
        let code = record.u8(ty::KIND);
        whence.rule(!(1..=9).contains(&code), "base", "there is no such elementary type here")?;
        return Err(whence.value("kind", code.into(), "1 to 9"));
    };
    let bytes = record.u32(ty::SIZE);
    whence.rule(bytes > 0, "size", "a value has at least one byte")?;
    whence.at_most("size", bytes.into(), limit::STATE_BYTES.into())?;
    let (size_is, size_rule) = (|size| bytes == size, "it must be the size of the elementary type");
    let deepest = match kind {
        TypeKind::Elementary(base) => {
            whence.rule(size_is(base.bytes()), "size", size_rule)?;
            0
        }
        TypeKind::Enumeration { base } => {
            whence.rule(size_is(base.bytes()), "size", size_rule)?;
            check_values(image, whence, record)?;
            0
        }
        TypeKind::Subrange { base, .. } => {
            whence.rule(size_is(base.bytes()), "size", size_rule)?;
            0
        }
        TypeKind::String { length } => {
            whence.rule(bytes > length, "size", "a STRING has a byte more than characters")?;
            0
        }
        TypeKind::WString { length } => {
            let least = 2 * (u64::from(length) + 1);
            whence.rule(
                u64::from(bytes) >= least,
                "size",
                "a WSTRING has two bytes for each character, and two more",
            )?;
            0
        }
        TypeKind::Array { element, lower, upper } => {
            let element = earlier(image, whence, "element", index, element)?;
            let count = i128::from(upper) - i128::from(lower) + 1;
            whence.rule(count > 0, "upper", "the upper index is not below the lower")?;
            let size = count.checked_mul(element.bytes.into());
            whence.rule(
                size == Some(bytes.into()),
                "size",
                "it must be the elements' size times their number",
            )?;
            element.depth
        }
        TypeKind::Structure | TypeKind::FunctionBlock => {
            check_fields(image, whence, record, index)?
        }
        TypeKind::Reference { target } => {
            whence.rule(size_is(8), "size", "a reference has 8 bytes")?;
            let exists = image.type_of(target).is_some();
            whence.rule(exists, "target", "there is no type of this number")?;
            0
        }
    };
    let depth = record.u16(ty::DEPTH);
    whence.at_most("depth", depth.into(), limit::TYPE_DEPTH.into())?;
    whence.rule(depth == deepest + 1, "depth", "it must be one more than that of the deepest part")
}

/// A type before the type `index`, which has been checked already.
fn earlier<'a>(
    image: &Image<'a>,
    whence: Where,
    field: &'static str,
    index: u32,
    part: TypeId,
) -> Result<Type<'a>, ImageError> {
    whence.rule(part.0 < index, field, "a type has only types before it as parts")?;
    Ok(Type::read(image, part.0))
}

fn range(
    image: &Image<'_>,
    whence: Where,
    record: Record<'_>,
    table: SectionKind,
) -> Result<core::ops::Range<u32>, ImageError> {
    let (first, count) = (record.u32(ty::FIRST), record.u32(ty::COUNT));
    let end = u64::from(first) + u64::from(count);
    whence.at_most("count", end, image.sections[table.index()].count.into())?;
    Ok(first..first + count)
}

fn check_values(image: &Image<'_>, of: Where, record: Record<'_>) -> Result<(), ImageError> {
    for index in range(image, of, record, SectionKind::Enumerators)? {
        let record = image.record(SectionKind::Enumerators, index);
        let whence = Where::new(record.offset, "enumerator", index);
        image.strings().name(whence, record.text(enumerator::NAME))?;
    }
    Ok(())
}

/// Checks the fields of a structure, and gives the depth of the deepest.
fn check_fields(
    image: &Image<'_>,
    of: Where,
    record: Record<'_>,
    structure: u32,
) -> Result<u16, ImageError> {
    let bytes = u64::from(record.u32(ty::SIZE));
    let (mut end, mut deepest) = (0, 0);
    for index in range(image, of, record, SectionKind::Fields)? {
        let record = image.record(SectionKind::Fields, index);
        let whence = Where::new(record.offset, "field", index);
        image.strings().name(whence, record.text(field::NAME))?;
        let part = earlier(image, whence, "type", structure, TypeId(record.u32(field::TYPE)))?;
        let offset = u64::from(record.u32(field::OFFSET));
        whence.rule(
            offset >= end,
            "offset",
            "fields are in the order of their offsets and do not overlap",
        )?;
        end = offset + u64::from(part.bytes);
        if end > bytes {
            return Err(whence.error("offset", Defect::Above { found: end, limit: bytes }));
        }
        deepest = deepest.max(part.depth);
    }
    Ok(deepest)
}
