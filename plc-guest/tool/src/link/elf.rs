//! What is in the linked ELF file, and what must not be.

use std::collections::BTreeMap;

use object::elf::{SHF_ALLOC, SHF_TLS, STT_GNU_IFUNC};
use object::read::elf::ElfFile64;
use object::{
    Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags, SymbolFlags, SymbolKind,
};
use takt_program::{address, limit};

use super::LinkError;

/// Fills what is no code.
const BREAKPOINT: u8 = 0xcc;

/// A linked program, with every address final.
pub struct Program {
    pub code: Vec<u8>,
    pub constants: Vec<u8>,
    pub state: Vec<u8>,
    pub state_bytes: u64,
    /// The records of the section `takt_declare`.
    pub declarations: Vec<u8>,
    /// Where the first of them lies.
    pub declared_at: u64,
    /// Where a fault is the program's own decision.
    pub user_traps: Vec<u64>,
    /// The sections with debug information, by name.
    pub debug: BTreeMap<String, Vec<u8>>,
}

impl Program {
    /// Bytes of the program at this address, in constants or state.
    pub fn bytes(&self, at: u64, length: u64) -> Option<&[u8]> {
        [
            (address::constants(self.code.len() as u32), &self.constants),
            (address::STATE, &self.state),
        ]
        .into_iter()
        .find_map(|(base, bytes)| {
            let from = usize::try_from(at.checked_sub(base)?).ok()?;
            bytes.get(from..)?.get(..usize::try_from(length).ok()?)
        })
    }
}

/// Reads the file that the linker wrote.
pub fn read(file: &[u8]) -> Result<Program, LinkError> {
    let elf = ElfFile64::<Endianness>::parse(file)?;
    let section = |name| -> Result<Vec<u8>, LinkError> {
        let found = elf.section_by_name(name);
        Ok(found.map(|section| section.data()).transpose()?.unwrap_or_default().to_vec())
    };
    check_sections(&elf)?;
    let end =
        |name| elf.section_by_name(name).filter(|s| s.size() > 0).map(|s| s.address() + s.size());
    let state_end = end(".bss").or(end(".data")).unwrap_or(address::STATE);
    // One in the SDK for Rust; in C one for each call of takt_fail.
    let traps = elf.symbols().filter(|symbol| {
        symbol.is_definition() && symbol.name().is_ok_and(|name| name.starts_with("takt_trap_user"))
    });
    let mut debug = BTreeMap::new();
    for section in elf.sections() {
        if let Ok(name) = section.name()
            && name.starts_with(".debug_")
        {
            debug.insert(name.to_owned(), section.uncompressed_data()?.into_owned());
        }
    }
    let mut code = section(".text")?;
    // Constants that are aligned to more than a page do not begin on the page after the code. The code fills the gap.
    let constants = elf.section_by_name(".rodata").filter(|section| section.size() > 0);
    if let Some(at) = constants.map(|section| section.address())
        && at > address::constants(code.len() as u32)
        && at - address::CODE <= u64::from(limit::CODE_BYTES)
    {
        code.resize((at - address::CODE) as usize, BREAKPOINT);
    }
    check_addresses(&elf, code.len() as u32)?;
    Ok(Program {
        code,
        constants: section(".rodata")?,
        state: section(".data")?,
        state_bytes: state_end - address::STATE,
        declarations: section(takt_sdk::declaration::SECTION)?,
        declared_at: elf
            .section_by_name(takt_sdk::declaration::SECTION)
            .map_or(0, |section| section.address()),
        user_traps: traps.map(|symbol| symbol.address()).collect(),
        debug,
    })
}

/// Each part lies where the image says that it does.
fn check_addresses(elf: &ElfFile64<'_, Endianness>, code: u32) -> Result<(), LinkError> {
    let parts = [
        (".text", address::CODE),
        (".rodata", address::constants(code)),
        (".data", address::STATE),
    ];
    for (name, expected) in parts {
        let section = elf.section_by_name(name).filter(|section| section.size() > 0);
        if let Some(found) = section.map(|section| section.address()).filter(|at| *at != expected) {
            return Err(LinkError::Address { name, found, expected });
        }
    }
    Ok(())
}

fn check_sections(elf: &ElfFile64<'_, Endianness>) -> Result<(), LinkError> {
    const KNOWN: [&str; 5] = [".text", ".rodata", ".data", ".bss", takt_sdk::declaration::SECTION];
    for section in elf.sections() {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
        if sh_flags.0 & SHF_ALLOC.0 == 0 || section.size() == 0 {
            continue;
        }
        let name = section.name()?.to_owned();
        if name == ".takt.init" {
            return Err(LinkError::Init);
        }
        if name == ".takt.constructors" {
            return Err(LinkError::Constructors { functions: constructors(elf, section.data()?) });
        }
        if sh_flags.0 & SHF_TLS.0 != 0 {
            let names = elf.symbols().filter(|symbol| symbol.kind() == SymbolKind::Tls);
            let variables =
                names.filter_map(|symbol| symbol.name().ok().map(str::to_owned)).collect();
            return Err(LinkError::ThreadLocal { variables });
        }
        if name.starts_with(".iplt") || name.starts_with(".igot") || name.starts_with(".rela") {
            return Err(LinkError::Chosen { functions: chosen(elf) });
        }
        if !KNOWN.contains(&name.as_str()) {
            return Err(LinkError::Section { name });
        }
    }
    Ok(())
}

/// The names of the functions whose code a loader would choose.
fn chosen(elf: &ElfFile64<'_, Endianness>) -> Vec<String> {
    let is = |flags| matches!(flags, SymbolFlags::Elf { st_info, .. } if st_info.0 & 15 == STT_GNU_IFUNC.0);
    let functions = elf.symbols().filter(|symbol| is(symbol.flags()));
    functions.filter_map(|symbol| symbol.name().ok().map(str::to_owned)).collect()
}

/// The names of the functions that the table of constructors has.
fn constructors(elf: &ElfFile64<'_, Endianness>, table: &[u8]) -> Vec<String> {
    let name = |address: u64| {
        let function = elf
            .symbols()
            .find(|symbol| symbol.kind() == SymbolKind::Text && symbol.address() == address);
        function.and_then(|symbol| symbol.name().ok().map(str::to_owned))
    };
    let addresses = table.chunks_exact(8).filter_map(|bytes| bytes.try_into().ok());
    let mut names: Vec<_> = addresses.filter_map(|bytes| name(u64::from_le_bytes(bytes))).collect();
    if names.is_empty() {
        names.push("without names".into());
    }
    names
}
