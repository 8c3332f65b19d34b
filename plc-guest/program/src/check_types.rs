//! The rules for types.

use core::ops::Range;

use crate::bytes::Record;
use crate::error::{Defect, ImageError, Where};
use crate::image::Image;
use crate::layout::{enumerator, field, ty};
use crate::limit;
use crate::section::SectionKind;
use crate::types::{Type, TypeKind, kind_of};
use crate::units::TypeId;

pub(crate) fn check(image: &Image<'_>) -> Result<(), ImageError> {
    let mut next = Next { field: 0, enumerator: 0 };
    for index in image.indices(SectionKind::Types) {
        check_type(image, index, &mut next)?;
    }
    Ok(())
}

/// Where the parts of the next type begin. No two types share a part: types that all had the same parts would
/// make the check as long as the product of both tables.
struct Next {
    field: u32,
    enumerator: u32,
}

fn check_type(image: &Image<'_>, index: u32, next: &mut Next) -> Result<(), ImageError> {
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
            check_values(image, whence, record, &mut next.enumerator)?;
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
            check_fields(image, whence, record, index, &mut next.field)?
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
    next: &mut u32,
) -> Result<Range<u32>, ImageError> {
    let (first, count) = (record.u32(ty::FIRST), record.u32(ty::COUNT));
    whence.rule(first == *next, "first", "the parts follow those of the type before")?;
    let end = u64::from(first) + u64::from(count);
    whence.at_most("count", end, image.sections[table.index()].count.into())?;
    *next = first + count;
    Ok(first..*next)
}

fn check_values(
    image: &Image<'_>,
    of: Where,
    record: Record<'_>,
    next: &mut u32,
) -> Result<(), ImageError> {
    for index in range(image, of, record, SectionKind::Enumerators, next)? {
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
    next: &mut u32,
) -> Result<u16, ImageError> {
    let bytes = u64::from(record.u32(ty::SIZE));
    let (mut end, mut deepest) = (0, 0);
    for index in range(image, of, record, SectionKind::Fields, next)? {
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
