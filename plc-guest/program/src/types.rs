//! The types of variables, so that tools can show and set values.
//!
//! A type refers only to types before it in the table (a reference may refer to any), and says how deep it is nested,
//! so a reader can recurse over it: at most [`limit::TYPE_DEPTH`](crate::limit::TYPE_DEPTH) deep, and never more parts
//! than the type has bytes, because every part has at least one byte of its own.

use crate::bytes::Record;
use crate::elementary::Elementary;
use crate::image::{Image, IndexRange};
use crate::layout::{enumerator, field, ty};
use crate::section::SectionKind;
use crate::units::TypeId;

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
        /// Type of what it refers to. A reference to its own number does not tell.
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

pub(crate) fn kind_of(record: Record<'_>) -> Option<TypeKind> {
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
