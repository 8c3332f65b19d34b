//! From bytes to a checked image.
//!
//! The order is from the outside in: header, section table, then each table with the tables that it
//! refers to already checked. Nothing is allocated, and the time is linear in the file's size but for
//! one bisection for each event task.

use crate::error::{Defect, ImageError, Where};
use crate::image::Image;
use crate::layout::{
    ABI_VERSION, FORMAT_VERSION, HEADER_BYTES, MAGIC, NO_OFFSET, SECTION_ALIGNMENT, header,
    requirements, section,
};
use crate::section::{self as sections, KINDS, Section, SectionKind};
use crate::{bytes::Record, check_types, limit, object, port, source, task, variable};

impl<'a> Image<'a> {
    /// Checks `file` and gives what is in it. The hash is not compared: see [`Image::verify`].
    ///
    /// # Errors
    /// The first defect that is found.
    pub fn parse(file: &'a [u8]) -> Result<Self, ImageError> {
        let whence = Where::new(0, "header", 0);
        let found = file.len() as u64;
        if file.len() < HEADER_BYTES {
            let needed = HEADER_BYTES as u64;
            return Err(whence.error("size", Defect::Truncated { needed, found }));
        }
        let image = Self { file, sections: [Section::default(); KINDS] };
        check_header(&image, whence)?;
        let count = image.header().u32(header::SECTION_COUNT);
        let image = Self { sections: sections::read(file, HEADER_BYTES, count)?, ..image };
        check_content(&image, whence)?;
        Ok(image)
    }
}

impl<'a> Image<'a> {
    /// Reads the header and the section table of an image that has passed [`Image::verify`] elsewhere. What is in the
    /// sections is not checked, so the time does not grow with the image. Reading a section that is not valid
    /// gives values that are wrong, never a panic.
    ///
    /// # Errors
    /// The first defect that is found.
    pub fn open(file: &'a [u8]) -> Result<Self, ImageError> {
        let image = Self { file, sections: [Section::default(); KINDS] };
        let whence = Where::new(0, "header", 0);
        check_header(&image, whence)?;
        let count = image.header().u32(header::SECTION_COUNT);
        Ok(Self { sections: sections::read(file, HEADER_BYTES, count)?, ..image })
    }
}

fn check_header(image: &Image<'_>, whence: Where) -> Result<(), ImageError> {
    let header = image.header();
    whence.rule(
        image.file.starts_with(&MAGIC),
        "magic",
        "a program image begins with TAKTPLC and a zero",
    )?;
    let format = header.u16(header::FORMAT);
    if format != FORMAT_VERSION {
        return Err(whence.value("format version", format.into(), "1"));
    }
    let abi = header.u16(header::ABI);
    if abi != ABI_VERSION {
        return Err(whence.value("ABI version", abi.into(), "1"));
    }
    let size = header.u32(header::SIZE);
    if size as usize != HEADER_BYTES {
        return Err(whence.value("header size", size.into(), "256"));
    }
    let (needed, found) = (header.u64(header::TOTAL), image.file.len() as u64);
    if needed > found {
        return Err(whence.error("total size", Defect::Truncated { needed, found }));
    }
    whence.rule(needed == found, "total size", "the file is longer than the image in it")?;
    whence.zero("reserved", header.u16(header::RESERVED_16).into())?;
    whence.zero("reserved", header.u32(header::RESERVED_32).into())?;
    let reserved = image.array::<32>(header::RESERVED_END);
    whence.rule(reserved == [0; 32], "reserved", "reserved bytes must be zero")?;
    let key = image.array::<32>(header::KEY) != [0; 32];
    let signature = image.array::<64>(header::SIGNATURE) != [0; 64];
    whence.rule(key == signature, "signature", "key and signature are both there or both zero")?;
    let table = header.u64(header::SECTION_TABLE);
    if table != HEADER_BYTES as u64 {
        return Err(whence.value("section table", table, "256"));
    }
    let count = header.u32(header::SECTION_COUNT);
    whence.at_most("section count", count.into(), KINDS as u64)?;
    let (needed, found) =
        (table + u64::from(count) * section::BYTES as u64, image.file.len() as u64);
    if needed > found {
        return Err(whence.error("section table", Defect::Truncated { needed, found }));
    }
    debug_assert!(needed.is_multiple_of(SECTION_ALIGNMENT));
    Ok(())
}

fn check_content(image: &Image<'_>, whence: Where) -> Result<(), ImageError> {
    let header = image.header();
    image.strings().name(whence, header.text(header::NAME))?;
    let size = |kind: SectionKind| image.sections[kind.index()].size as u64;
    whence.rule(size(SectionKind::Code) > 0, "code", "a program has code")?;
    whence.rule(size(SectionKind::Tasks) > 0, "tasks", "a program has at least one task")?;
    let init = header.u32(header::INIT);
    whence.rule(
        init == NO_OFFSET || is_code(image, init),
        "init",
        "it must be inside of the code",
    )?;
    check_requirements(image)?;
    check_types::check(image)?;
    variable::check(image)?;
    task::check(image)?;
    object::check(image)?;
    port::check(image)?;
    source::check_traps(image)?;
    source::check_lines(image)
}

fn check_requirements(image: &Image<'_>) -> Result<(), ImageError> {
    let record: Record<'_> = image.record(SectionKind::Requirements, 0);
    let whence = Where::new(record.offset, "requirements", 0);
    let limit = limit::PROCESS_IMAGE_BYTES.into();
    whence.at_most("input bytes", record.u32(requirements::INPUT).into(), limit)?;
    whence.at_most("output bytes", record.u32(requirements::OUTPUT).into(), limit)?;
    whence.at_most("marker bytes", record.u32(requirements::MARKER).into(), limit)?;
    whence.zero("reserved", record.u32(requirements::RESERVED).into())
}

/// Whether this is a place in the code.
pub(crate) fn is_code(image: &Image<'_>, offset: u32) -> bool {
    (offset as usize) < image.sections[SectionKind::Code.index()].size
}
