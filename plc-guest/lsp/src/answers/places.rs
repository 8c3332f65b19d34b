//! Where a name is declared and used.

use lsp_types::Location;

use crate::analysis::{Analysis, File};

/// The declaration of the name at a byte; none if that is in the library, which has no file.
pub fn declaration(analysis: &Analysis, file: &File, offset: u32) -> Option<Location> {
    let one = analysis.index.at(file.id, offset)?;
    analysis.location(analysis.index.symbol(one.symbol).span)
}

/// All uses of the name at a byte in the project, with its declaration or without.
pub fn uses(analysis: &Analysis, file: &File, offset: u32, declaration: bool) -> Vec<Location> {
    let index = &analysis.index;
    let Some(one) = index.at(file.id, offset) else { return Vec::new() };
    let declared = index.symbol(one.symbol).span;
    let uses = index.uses_of(one.symbol).filter(|one| declaration || one.span != declared);
    uses.filter_map(|one| analysis.location(one.span)).collect()
}
