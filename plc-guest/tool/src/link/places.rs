//! Where the program declares what it has, from the debug information of the compiler.

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::Path;

use addr2line::gimli::{
    self, AttributeValue, DW_AT_decl_file, DW_AT_decl_line, DW_AT_location, DW_TAG_variable, Dwarf,
    EndianSlice, LittleEndian, Operation,
};

use super::elf::Program;
use super::lines::of_library;

type Reader<'a> = EndianSlice<'a, LittleEndian>;

/// File and line of the declarations whose records are at these addresses, as far as debug information tells. Paths inside of `here`
/// are made relative to it.
pub fn of(program: &Program, records: Range<u64>, here: &Path) -> BTreeMap<u64, String> {
    let mut places = BTreeMap::new();
    // What was found before a defect is as good.
    let _ = find(program, records, here, &mut places);
    places
}

fn find(
    program: &Program,
    records: Range<u64>,
    here: &Path,
    places: &mut BTreeMap<u64, String>,
) -> Result<(), gimli::Error> {
    let section = |id: gimli::SectionId| -> Result<_, gimli::Error> {
        let bytes = program.debug.get(id.name()).map_or(&[][..], Vec::as_slice);
        Ok(EndianSlice::new(bytes, LittleEndian))
    };
    let dwarf: Dwarf<Reader<'_>> = Dwarf::load(section)?;
    let mut headers = dwarf.units();
    while let Some(header) = headers.next()? {
        let unit = dwarf.unit(header)?;
        let mut entries = unit.entries();
        while let Some(entry) = entries.next_dfs()? {
            if entry.tag() != DW_TAG_variable {
                continue;
            }
            let Some(AttributeValue::Exprloc(expression)) = entry.attr_value(DW_AT_location) else {
                continue;
            };
            let first = expression.operations(unit.encoding()).next()?;
            let Some(Operation::Address { address }) = first else { continue };
            let file = entry.attr_value(DW_AT_decl_file);
            let line = entry.attr_value(DW_AT_decl_line).and_then(|line| line.udata_value());
            if let (Some(AttributeValue::FileIndex(file)), Some(line)) = (file, line)
                && records.contains(&address)
                && let Some(file) = path(&dwarf, &unit, file)
                && !of_library(&file)
            {
                let file = Path::new(&file);
                let file = file.strip_prefix(here).unwrap_or(file).display();
                places.insert(address, format!("{file}:{line}"));
            }
        }
    }
    Ok(())
}

/// The path of a file of a compilation unit.
fn path(dwarf: &Dwarf<Reader<'_>>, unit: &gimli::Unit<Reader<'_>>, file: u64) -> Option<String> {
    let header = unit.line_program.as_ref()?.header();
    let entry = header.file(file)?;
    let text = |value| Some(dwarf.attr_string(unit, value).ok()?.to_string_lossy().into_owned());
    let name = text(entry.path_name())?;
    // Folder 0 is the one in which the compiler ran.
    match entry.directory(header).filter(|_| entry.directory_index() != 0).and_then(text) {
        Some(folder) => Some(Path::new(&folder).join(name).to_string_lossy().into_owned()),
        None => Some(name),
    }
}
