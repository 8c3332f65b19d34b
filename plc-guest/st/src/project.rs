//! All files of a project, from text to the typed tree.

use crate::check::{self, Input};
use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::hir::Program;
use crate::library;
use crate::source::Sources;
use crate::stack;
use crate::syntax::ast::File;
use crate::syntax::parser;

/// What became of a project.
#[derive(Debug)]
pub struct Checked {
    /// The typed tree; none if there was an error.
    pub program: Option<Program>,
    /// All messages, by file and place.
    pub diagnostics: Vec<Diagnostic>,
}

/// Parses and checks all files, and those of the library with them, which are added to `sources`.
/// `name` is the program image's.
///
/// # Errors
///
/// If the system has no room for a thread (see [`stack`]).
pub fn check(name: &str, sources: &mut Sources) -> std::io::Result<Checked> {
    stack::with_room(|| check_here(name, sources))
}

fn check_here(name: &str, sources: &mut Sources) -> Checked {
    let own = sources.iter().count();
    library::add(sources);
    let mut diagnostics = Diagnostics::new();
    let trees: Vec<File> =
        sources.iter().map(|(file, _)| parser::parse(file, sources, &mut diagnostics)).collect();
    let inputs: Vec<Input<'_>> = trees
        .iter()
        .enumerate()
        .map(|(index, tree)| Input { tree, library: index >= own })
        .collect();
    let program = check::check(name, sources, &inputs, &mut diagnostics);
    let program = (!diagnostics.has_errors()).then_some(program);
    let mut diagnostics = diagnostics.sorted();
    // A project can do nothing about what the compiler would advise the library.
    diagnostics.retain(|one| one.is_error() || one.span.file.index() < own);
    Checked { program, diagnostics }
}
