//! From syntax trees to the typed tree: what every name means, what type every expression has, and
//! whether the program may be as it is written.
//!
//! Names of types, units and global variables are known before anything is resolved, so that the
//! order of declarations and files does not count. What a declaration needs of another is resolved on
//! demand. Within a unit a variable is declared before it is used.
//!
//! An error leaves a hole (`None`) that later steps pass on without a further message. A statement or an
//! initial value with a hole that no error explains is refused as a mistake of the compiler's own.

mod apart;
mod body;
mod call;
mod configuration;
mod convert;
mod declare;
mod expression;
mod fixed;
mod fold;
mod globals;
mod initial;
mod literal;
mod loops;
mod names;
mod operator;
mod place;
mod placement;
mod recursion;
mod reference;
mod standard;
mod statement;
mod task;
mod test;
mod type_spec;
mod types;
mod unit;
mod usage;

use std::collections::HashMap;

pub use standard::known;

use crate::diagnostic::{Code, Diagnostic, Diagnostics};
use crate::hir::{Elementary, Location, Program, TypeId};
use crate::limits;
use crate::source::{Sources, Span};
use crate::syntax::ast;

/// A file to check.
#[derive(Debug)]
pub struct Input<'a> {
    /// Its tree.
    pub tree: &'a ast::File,
    /// Whether it is of a library: what is not used of it is neither told of nor compiled.
    pub library: bool,
}

/// Checks all files of a project, in the order of their numbers in `sources`, and makes the typed tree.
/// It is complete only if no error was added to `diagnostics`.
#[must_use]
pub fn check(
    name: &str,
    sources: &Sources,
    files: &[Input<'_>],
    diagnostics: &mut Diagnostics,
) -> Program {
    let mut checker = Checker::new(name, sources, diagnostics);
    checker.collect(files);
    checker.all_types();
    checker.all_globals();
    checker.all_units();
    checker.refuse_global_leaves();
    checker.configurations();
    checker.tests();
    checker.refuse_unused_ports();
    checker.place_floating();
    checker.refuse_shared_outputs();
    checker.refuse_recursion();
    checker.warn_of_globals();
    let program = checker.program;
    // What has errors uses more than was understood, and a library is not the reader's.
    let doubts = usage::Doubts::of(files, diagnostics);
    diagnostics.keep_warnings(|one| {
        let library = files.get(one.span.file.index()).is_some_and(|file| file.library)
            || sources.is_of_library(one.span.file);
        !library && !doubts.concern(one)
    });
    program
}

/// How far something that is resolved on demand is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Progress {
    /// Not begun.
    Waiting,
    /// Begun: a declaration that needs it now is a part of it.
    Begun,
    /// Done, perhaps with errors.
    Done,
}

/// What a name at the top means.
#[derive(Clone, Debug)]
enum Entry {
    /// A type, by its index in [`Checker::types`].
    Type(usize),
    /// A program, function block or function, by its index in [`Checker::units`]. Only functions of
    /// libraries may be several, of which a call takes the first that its arguments fit.
    Units(Vec<usize>),
    /// A global variable, by its index in [`Checker::globals`].
    Global(usize),
}

/// A port of the program.
struct PortEntry {
    /// Where it is used first.
    span: Span,
    /// Whether the program uses it, and not tests alone.
    used: bool,
}

/// All that is known while a project is checked.
struct Checker<'a> {
    sources: &'a Sources,
    diagnostics: &'a mut Diagnostics,
    program: Program,
    names: names::Names<'a>,
    types: Vec<types::TypeEntry<'a>>,
    units: Vec<unit::UnitEntry<'a>>,
    globals: Vec<globals::GlobalEntry<'a>>,
    /// What declarations of global variables say, by the place of their type.
    global_types: HashMap<Span, Option<types::Resolved>>,
    configurations: Vec<&'a ast::Configuration>,
    /// Which enumerations have a value of this key.
    enumeration_values: HashMap<String, Vec<(TypeId, i128)>>,
    /// Variables at direct addresses that are only used as such.
    addresses: HashMap<(ast::Area, ast::Place), crate::hir::GlobalId>,
    /// The function blocks and programs by the type of their instances.
    blocks: HashMap<TypeId, usize>,
    /// Where the variables in the state end, in bytes.
    state_end: u32,
    /// Variables at `%I*` and the like, which get their place last.
    floating: Vec<(crate::hir::GlobalId, Span)>,
    /// The type of the indices that the compiler writes itself: LINT.
    index_type: TypeId,
    /// Variables declared at outputs.
    outputs: Vec<(crate::hir::GlobalId, Span)>,
    /// Units whose bodies are still to be checked.
    waiting: Vec<usize>,
    /// Which unit calls which, by their indices, with one place of a call.
    calls: Vec<(usize, usize, Span)>,
    /// The ports of the program, with what its own table does not say.
    ports: Vec<PortEntry>,
    /// The variables that keep the two sides of a test's comparisons, by their types.
    kept: HashMap<(&'static str, TypeId), crate::hir::GlobalId>,
    /// How many values were copied: repeated ones, and those of types to where an initial value leaves them out.
    copied: u64,
    /// How many resolutions on demand are within each other.
    depth: u32,
}

impl<'a> Checker<'a> {
    fn new(name: &str, sources: &'a Sources, diagnostics: &'a mut Diagnostics) -> Self {
        let mut program = Program::new(name);
        let index_type = program.types.elementary(Elementary::Lint);
        program.files = sources.iter().map(|(_, source)| source.name().to_owned()).collect();
        Self {
            sources,
            diagnostics,
            program,
            names: names::Names::default(),
            types: Vec::new(),
            units: Vec::new(),
            globals: Vec::new(),
            global_types: HashMap::new(),
            configurations: Vec::new(),
            enumeration_values: HashMap::new(),
            addresses: HashMap::new(),
            blocks: HashMap::new(),
            state_end: 0,
            floating: Vec::new(),
            index_type,
            outputs: Vec::new(),
            waiting: Vec::new(),
            calls: Vec::new(),
            ports: Vec::new(),
            kept: HashMap::new(),
            copied: 0,
            depth: 0,
        }
    }

    fn tell(&mut self, one: Diagnostic) {
        self.diagnostics.push(one);
    }

    fn error(&mut self, code: Code, span: Span, found: impl Into<String>) {
        self.tell(Diagnostic::new(code, span, found));
    }

    /// A hole that no error explains would be missing in the program.
    fn refuse_gap(&mut self, span: Span) {
        if !self.diagnostics.has_errors() {
            let found = "a part of the program that the compiler left out without a reason";
            self.error(Code::Internal, span, found);
        }
    }

    fn elementary(&mut self, elementary: Elementary) -> TypeId {
        self.program.types.elementary(elementary)
    }

    /// A type's name in messages.
    fn type_name(&self, ty: TypeId) -> String {
        self.program.types.name(ty)
    }

    fn location(&self, span: Span) -> Location {
        let position = self.sources.position(span);
        let file = span.file.index() as u16;
        Location { file, line: position.line, column: position.column }
    }

    /// Resolves something on demand, unless that goes too deep.
    fn deeper<T>(&mut self, span: Span, inner: impl FnOnce(&mut Self) -> Option<T>) -> Option<T> {
        if self.depth >= limits::DEPTH {
            let found = "declarations that need each other too deep";
            let allowed = format!("at most {} levels", limits::DEPTH);
            self.tell(Diagnostic::new(Code::TooDeep, span, found).allowed(allowed));
            return None;
        }
        self.depth += 1;
        let result = inner(self);
        self.depth -= 1;
        result
    }
}
