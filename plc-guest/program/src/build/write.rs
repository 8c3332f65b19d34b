//! The file: header, section table, sections, hashes.

use alloc::vec::Vec;

use super::{Builder, records};
use crate::layout::{ABI_VERSION, FORMAT_VERSION, HEADER_BYTES, MAGIC, NO_OFFSET, header, section};
use crate::name::order;
use crate::section::SectionKind;
use crate::{Image, address, hash};

/// The image. Whether it keeps the rules is found out by reading it.
pub fn image(builder: &Builder) -> Vec<u8> {
    let mut texts = records::Texts::default();
    let name = texts.add(&builder.name);
    let sections = sections(builder, &mut texts);
    let mut file = alloc::vec![0; HEADER_BYTES + sections.len() * section::BYTES];
    write_header(&mut file, builder, name, sections.len());
    for (index, (kind, bytes)) in sections.iter().enumerate() {
        let offset = file.len().next_multiple_of(kind.alignment() as usize);
        file.resize(offset, 0);
        file.extend_from_slice(bytes);
        let memory = match kind {
            SectionKind::State => bytes.len().max(builder.state_bytes as usize),
            _ => bytes.len(),
        };
        let entry = HEADER_BYTES + index * section::BYTES;
        put(&mut file, entry + section::KIND, kind.code().to_le_bytes());
        let count = (bytes.len() / kind.record_bytes()) as u32;
        put(&mut file, entry + section::COUNT, count.to_le_bytes());
        put(&mut file, entry + section::OFFSET, (offset as u64).to_le_bytes());
        put(&mut file, entry + section::SIZE, (bytes.len() as u64).to_le_bytes());
        put(&mut file, entry + section::MEMORY, (memory as u64).to_le_bytes());
    }
    // The last pages of the segments are whole. There is always code, or the image is refused.
    file.resize(file.len().next_multiple_of(address::PAGE as usize), 0);
    let total = file.len() as u64;
    put(&mut file, header::TOTAL, total.to_le_bytes());
    // An image that breaks a rule needs no hash.
    if let Ok(layout) = Image::parse(&file).map(|image| hash::of_layout(&image)) {
        file[header::LAYOUT_HASH].copy_from_slice(&layout);
        let hash = hash::of_file(&file);
        file[header::HASH].copy_from_slice(&hash);
    }
    file
}

fn write_header(file: &mut [u8], builder: &Builder, name: (u32, u32), sections: usize) {
    file[..MAGIC.len()].copy_from_slice(&MAGIC);
    put(file, header::FORMAT, FORMAT_VERSION.to_le_bytes());
    put(file, header::ABI, ABI_VERSION.to_le_bytes());
    put(file, header::SIZE, (HEADER_BYTES as u32).to_le_bytes());
    put(file, header::CATEGORY, builder.category.to_le_bytes());
    put(file, header::VERSION, builder.version.major.to_le_bytes());
    put(file, header::VERSION + 2, builder.version.minor.to_le_bytes());
    put(file, header::VERSION + 4, builder.version.patch.to_le_bytes());
    put(file, header::NAME, name.0.to_le_bytes());
    put(file, header::NAME + 4, name.1.to_le_bytes());
    put(file, header::SECTION_COUNT, (sections as u32).to_le_bytes());
    put(file, header::SECTION_TABLE, (HEADER_BYTES as u64).to_le_bytes());
    put(file, header::INIT, builder.init.map_or(NO_OFFSET, |init| init.0).to_le_bytes());
}

fn put<const N: usize>(file: &mut [u8], at: usize, number: [u8; N]) {
    file[at..at + N].copy_from_slice(&number);
}

/// All sections that are not empty, in their order.
fn sections(builder: &Builder, texts: &mut records::Texts) -> Vec<(SectionKind, Vec<u8>)> {
    let mut variables: Vec<_> = builder.variables.iter().collect();
    variables.sort_by(|a, b| order(&a.name, &b.name));
    let mut traps: Vec<_> = builder.traps.iter().collect();
    traps.sort_by_key(|trap| trap.at);
    let mut lines: Vec<_> = builder.lines.iter().collect();
    lines.sort_by_key(|line| line.at);
    // The sort is stable: the last of those at one place is the last that was added.
    lines.reverse();
    lines.dedup_by_key(|line| line.at);
    lines.reverse();

    let types = records::types(&builder.types, texts);
    let variables = records::variables(variables.into_iter(), &builder.types, texts);
    let tasks = records::tasks(&builder.tasks, texts);
    let objects = records::objects(&builder.objects, texts);
    let ports = records::ports(&builder.ports, texts);
    let traps = records::traps(traps.into_iter(), texts);
    let lines = records::lines(lines.into_iter(), texts);
    let requirements =
        records::requirements(builder.input_bytes, builder.output_bytes, builder.marker_bytes);
    let all = [
        (SectionKind::Strings, core::mem::take(&mut texts.bytes)),
        (SectionKind::Requirements, requirements.bytes),
        (SectionKind::Types, types.types.bytes),
        (SectionKind::Fields, types.fields.bytes),
        (SectionKind::Enumerators, types.values.bytes),
        (SectionKind::Variables, variables.bytes),
        (SectionKind::Tasks, tasks.bytes),
        (SectionKind::Objects, objects.bytes),
        (SectionKind::Ports, ports.bytes),
        (SectionKind::Traps, traps.bytes),
        (SectionKind::Lines, lines.bytes),
        (SectionKind::Code, builder.code.clone()),
        (SectionKind::Constants, builder.constants.clone()),
        (SectionKind::State, builder.state.clone()),
    ];
    let needed = |kind, bytes: &Vec<u8>| {
        !bytes.is_empty() || (kind == SectionKind::State && builder.state_bytes > 0)
    };
    all.into_iter().filter(|(kind, bytes)| needed(*kind, bytes)).collect()
}
