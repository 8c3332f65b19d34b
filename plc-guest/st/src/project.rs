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
    /// Whether any file has a TEST.
    pub tests: bool,
}

/// Which files of a project count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    /// All but those with a TEST: what becomes an image.
    Program,
    /// All.
    Tests,
}

/// Parses and checks all files but those of tests, and those of the library with them, which are added to `sources`.
/// A file with a TEST is one of tests: what else it declares is for its tests alone. `name` is the program image's.
///
/// # Errors
///
/// If the system has no room for a thread (see [`stack`]).
pub fn check(name: &str, sources: &mut Sources) -> std::io::Result<Checked> {
    stack::with_room(|| check_here(name, sources, Part::Program))
}

/// [`check()`], with the files of tests. The program's last task enters the tests (see [`crate::hir::Tests`]).
///
/// # Errors
///
/// As of [`check()`].
pub fn check_tests(name: &str, sources: &mut Sources) -> std::io::Result<Checked> {
    stack::with_room(|| check_here(name, sources, Part::Tests))
}

/// [`check()`], and if that is good and there are tests, [`check_tests`]: the program must do without what the files of
/// tests declare.
///
/// # Errors
///
/// As of [`check()`].
pub fn check_all(name: &str, sources: &mut Sources) -> std::io::Result<Checked> {
    stack::with_room(|| {
        let own = sources.iter().count();
        library::add(sources);
        let program = check_with_library(name, sources, own, Part::Program);
        match program.program.is_some() && program.tests {
            true => check_with_library(name, sources, own, Part::Tests),
            false => program,
        }
    })
}

fn check_here(name: &str, sources: &mut Sources, part: Part) -> Checked {
    let own = sources.iter().count();
    library::add(sources);
    check_with_library(name, sources, own, part)
}

fn check_with_library(name: &str, sources: &Sources, own: usize, part: Part) -> Checked {
    let mut diagnostics = Diagnostics::new();
    sources.refused().iter().for_each(|one| diagnostics.push(one.clone()));
    let trees: Vec<File> = sources
        .iter()
        .take(own)
        .map(|(file, source)| match source.is_read() {
            true => parser::parse(file, sources, &mut diagnostics),
            false => File::default(),
        })
        .collect();
    let tests = trees.iter().any(File::has_tests);
    // Files keep their numbers.
    let empty = File::default();
    let own_inputs = trees.iter().map(|tree| {
        let left_out = part == Part::Program && tree.has_tests();
        Input { tree: if left_out { &empty } else { tree }, library: false }
    });
    let library = library::trees(sources, own);
    let inputs: Vec<Input<'_>> =
        own_inputs.chain(library.iter().map(|tree| Input { tree, library: true })).collect();
    let program = check::check(name, sources, &inputs, &mut diagnostics);
    let program = (!diagnostics.has_errors()).then_some(program);
    let mut diagnostics = diagnostics.sorted();
    // A project can do nothing about what the compiler would advise the library.
    diagnostics.retain(|one| one.is_error() || one.span.file.index() < own);
    Checked { program, diagnostics, tests }
}
