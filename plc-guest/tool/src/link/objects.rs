//! What a linker would take, and make something wrong of: refused before it runs.

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

/// Checks one object file, or a member of a library.
pub fn check(input: &Path, file: &File<'_>) -> Result<(), LinkError> {
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
