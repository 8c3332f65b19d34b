//! What a linker would take, and make something wrong of: refused before it runs.

use std::collections::BTreeSet;
use std::path::Path;

use object::elf::{
    R_X86_64_GOTPCREL, R_X86_64_GOTPCRELX, R_X86_64_REX_GOTPCRELX, SHF_ALLOC, SHF_EXECINSTR,
    SHF_WRITE,
};
use object::{
    File, Object, ObjectSection, ObjectSymbol, RelocationFlags, RelocationTarget, SectionFlags,
};

use super::LinkError;

/// Constants that are aligned to more than a page cost an image that much.
const ALIGNMENT: u64 = 1 << 20;

/// What object files use if it is there. The linker makes 0 of its address without a word if it is not.
#[derive(Default)]
pub struct Weak(Vec<User>);

/// An object file that uses such symbols.
struct User {
    uses: Vec<String>,
    defines: Vec<String>,
    /// Of a library, so that it is linked only if something uses what it defines.
    member: bool,
}

impl Weak {
    /// Notes what a file uses.
    pub fn add(&mut self, file: &File<'_>, member: bool) {
        let names = |wanted: fn(&object::Symbol<'_, '_>) -> bool| -> Vec<String> {
            let symbols = file.symbols().filter(wanted);
            symbols.filter_map(|symbol| symbol.name().ok().map(str::to_owned)).collect()
        };
        let uses = names(|symbol| symbol.is_undefined() && symbol.is_weak());
        if !uses.is_empty() {
            let defines = names(|symbol| symbol.is_definition() && symbol.is_global());
            self.0.push(User { uses, defines, member });
        }
    }

    /// Refuses what is not in the linked file.
    pub fn check(&self, linked: &[u8]) -> Result<(), LinkError> {
        let linked = File::parse(linked)?;
        let symbols = linked.symbols().filter(|symbol| !symbol.is_undefined());
        let there: BTreeSet<&str> = symbols.filter_map(|symbol| symbol.name().ok()).collect();
        let is_there = |name: &String| there.contains(name.as_str());
        let users = self.0.iter().filter(|user| !user.member || user.defines.iter().any(is_there));
        let missing: BTreeSet<_> =
            users.flat_map(|user| &user.uses).filter(|name| !is_there(name)).cloned().collect();
        if missing.is_empty() {
            return Ok(());
        }
        Err(LinkError::Weak { symbols: missing.into_iter().collect() })
    }
}

/// Checks one object file, or a member of a library.
pub fn check(input: &Path, file: &File<'_>) -> Result<(), LinkError> {
    check_code(input, file)?;
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
        if sh_flags.0 & SHF_ALLOC.0 == 0 {
            continue;
        }
        let name = || section.name().unwrap_or_default().to_owned();
        // The linker would drop the right to write, and the program fault.
        let both = SHF_WRITE.0 | SHF_EXECINSTR.0;
        if sh_flags.0 & both == both {
            return Err(LinkError::WritableCode { path: input.to_owned(), name: name() });
        }
        if section.align() > ALIGNMENT {
            let (found, allowed) = (section.align(), ALIGNMENT);
            return Err(LinkError::Alignment {
                path: input.to_owned(),
                name: name(),
                found,
                allowed,
            });
        }
        check_table(input, file, &section)?;
    }
    Ok(())
}

/// Refuses a file that has only what a compiler needs for compiling it later. The linker would take it for an empty one.
fn check_code(input: &Path, file: &File<'_>) -> Result<(), LinkError> {
    let kept = |name: &str| name.starts_with(".gnu.lto_") || name.starts_with(".llvm.lto");
    let compiled = |section: &object::Section<'_, '_>| {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else { return false };
        let name = section.name().unwrap_or_default();
        sh_flags.0 & SHF_ALLOC.0 != 0 && section.size() > 0 && !name.starts_with(".note")
    };
    let later = file.sections().any(|section| section.name().is_ok_and(kept));
    if later && !file.sections().any(|section| compiled(&section)) {
        return Err(LinkError::Optimisation { path: input.to_owned() });
    }
    Ok(())
}

/// Refuses an offset to an entry of the table of addresses. Compilers make none; an assembler does of a symbol that is
/// another one plus an offset, and the linker takes the offset for one in the table.
fn check_table<'a>(
    input: &Path,
    file: &File<'a>,
    section: &impl ObjectSection<'a>,
) -> Result<(), LinkError> {
    const KINDS: [u32; 3] = [R_X86_64_GOTPCREL.0, R_X86_64_GOTPCRELX.0, R_X86_64_REX_GOTPCRELX.0];
    // From the place of the relocation to the next instruction: 4, and 1 or 4 more with an operand behind it.
    const NEXT: [i64; 4] = [-4, -5, -6, -8];
    for (_, relocation) in section.relocations() {
        let RelocationFlags::Elf { r_type } = relocation.flags() else { continue };
        if !KINDS.contains(&r_type.0) || NEXT.contains(&relocation.addend()) {
            continue;
        }
        let RelocationTarget::Symbol(symbol) = relocation.target() else { continue };
        let symbol = file.symbol_by_index(symbol).ok();
        let symbol = symbol.and_then(|symbol| symbol.name().ok().map(str::to_owned));
        return Err(LinkError::Table {
            path: input.to_owned(),
            function: section.name().unwrap_or_default().to_owned(),
            symbol: symbol.unwrap_or_default(),
        });
    }
    Ok(())
}
