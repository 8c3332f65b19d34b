//! The names at the top of all files.

use std::collections::HashMap;

use super::globals::GlobalEntry;
use super::standard::known;
use super::types::TypeEntry;
use super::unit::UnitEntry;
use super::{Checker, Entry, Input};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::Elementary;
use crate::source::Span;
use crate::syntax::ast::{self, Declaration, Name, UnitKind};

/// The names at the top: those of the project, and behind them those of the library.
///
/// A project may declare a name that the library has; the library itself goes on with its own.
#[derive(Debug, Default)]
pub(super) struct Names<'a> {
    own: HashMap<&'a str, Entry>,
    library: HashMap<&'a str, Entry>,
    /// Whether a declaration of the library is being checked.
    pub(super) within_library: bool,
}

impl<'a> Names<'a> {
    /// What a key means where it is used now.
    pub(super) fn get(&self, key: &str) -> Option<&Entry> {
        let own = if self.within_library { None } else { self.own.get(key) };
        own.or_else(|| self.library.get(key))
    }

    pub(super) fn contains_key(&self, key: &str) -> bool {
        self.get(key).is_some()
    }

    pub(super) fn keys(&self) -> impl Iterator<Item = &'a str> {
        self.own.keys().chain(self.library.keys()).copied()
    }

    fn of(&mut self, library: bool) -> &mut HashMap<&'a str, Entry> {
        if library { &mut self.library } else { &mut self.own }
    }
}

impl<'a> Checker<'a> {
    /// Runs `inner` with the names that a declaration of the project or of the library sees.
    pub(super) fn seen_from<T>(&mut self, library: bool, inner: impl FnOnce(&mut Self) -> T) -> T {
        let outer = std::mem::replace(&mut self.names.within_library, library);
        let result = inner(self);
        self.names.within_library = outer;
        result
    }

    /// Takes note of every name, so that declarations can use each other in any order.
    pub(super) fn collect(&mut self, files: &[Input<'a>]) {
        for file in files {
            for declaration in &file.tree.declarations {
                match declaration {
                    Declaration::Type(declaration) => {
                        let entry = Entry::Type(self.types.len());
                        // What is wrong in a second one is told too.
                        self.declare_top(&declaration.name, entry, file.library);
                        self.types.push(TypeEntry::new(declaration, file.library));
                    }
                    Declaration::Unit(unit) => self.collect_unit(unit, file.library),
                    Declaration::Globals(section) => self.collect_globals(section, file.library),
                    Declaration::Configuration(configuration) => {
                        self.configurations.push(configuration);
                        for section in &configuration.globals {
                            self.collect_globals(section, false);
                        }
                        for resource in &configuration.resources {
                            for section in &resource.globals {
                                self.collect_globals(section, false);
                            }
                        }
                    }
                }
            }
        }
        for file in files.iter().filter(|file| !file.library && file.tree.has_tests()) {
            self.refuse_names_of_the_library(file.tree);
        }
        if let [_, second, ..] = self.configurations[..] {
            let first = self.configurations[0].name.span;
            self.tell(
                Diagnostic::new(Code::DuplicateName, second.name.span, "a second CONFIGURATION")
                    .allowed("one CONFIGURATION in a project")
                    .related(first, "the first is here"),
            );
        }
    }

    /// Refuses names of the library that a file of tests declares: the tested program would use what is declared
    /// there, and its image what the library has.
    fn refuse_names_of_the_library(&mut self, tree: &'a ast::File) {
        for declaration in &tree.declarations {
            let names: Vec<&Name> = match declaration {
                Declaration::Type(declaration) => vec![&declaration.name],
                Declaration::Unit(unit) if unit.kind != UnitKind::Test => vec![&unit.name],
                Declaration::Globals(section) => {
                    section.variables.iter().flat_map(|variables| &variables.names).collect()
                }
                Declaration::Unit(_) | Declaration::Configuration(_) => Vec::new(),
            };
            let function =
                matches!(declaration, Declaration::Unit(unit) if unit.kind == UnitKind::Function);
            for name in names {
                let taken = self.names.library.contains_key(&*name.key)
                    || function && known::function(&name.key).is_some();
                if taken {
                    let found =
                        format!("`{}`, a name of the library, in a file with a TEST", name.text);
                    let one = Diagnostic::new(Code::DuplicateName, name.span, found);
                    self.tell(one.hint(
                        "the program would be tested with it, and be built with the library's",
                    ));
                }
            }
        }
    }

    fn collect_unit(&mut self, unit: &'a ast::Unit, library: bool) {
        if unit.kind == UnitKind::Test {
            // Nothing can refer to a test.
            self.units.push(UnitEntry::new(unit, library));
            return;
        }
        let index = self.units.len();
        let overload = match self.names.of(library).get(&*unit.name.key) {
            Some(Entry::Units(others)) if library && unit.kind == UnitKind::Function => {
                others.iter().all(|other| {
                    self.units[*other].library && self.units[*other].ast.kind == unit.kind
                })
            }
            _ => false,
        };
        if overload {
            let names = self.names.of(library);
            if let Some(Entry::Units(others)) = names.get_mut(&*unit.name.key) {
                others.push(index);
            }
        } else {
            // What is wrong in the body of one whose name is taken is told too.
            self.declare_top(&unit.name, Entry::Units(vec![index]), library);
        }
        self.units.push(UnitEntry::new(unit, library));
    }

    fn collect_globals(&mut self, section: &'a ast::Section, library: bool) {
        for variables in &section.variables {
            for name in &variables.names {
                let known = self.declare_top(name, Entry::Global(self.globals.len()), library);
                // What is wrong in a second declaration is told too. Its address is that of the first in most cases.
                if known || variables.address.is_none() {
                    self.globals.push(GlobalEntry::new(section, variables, name, library));
                }
            }
        }
    }

    /// Declares a name, unless it is taken.
    fn declare_top(&mut self, name: &'a Name, entry: Entry, library: bool) -> bool {
        if self.refuse_reserved(name) {
            return false;
        }
        let names = self.names.of(library);
        let Some(other) = names.get(&*name.key) else {
            names.insert(&name.key, entry);
            return true;
        };
        let other = match other {
            Entry::Type(index) => self.types[*index].ast.name.span,
            Entry::Units(units) => self.units[units[0]].ast.name.span,
            Entry::Global(index) => self.globals[*index].name.span,
        };
        self.duplicate(name, other);
        false
    }

    /// Whether the name of this declaration of a type means another declaration.
    pub(super) fn is_declared_twice(&self, name: &Name) -> bool {
        match self.names.get(&name.key) {
            Some(Entry::Type(index)) => self.types[*index].ast.name.span != name.span,
            _ => true,
        }
    }

    pub(super) fn duplicate(&mut self, name: &Name, other: Span) {
        self.tell(
            Diagnostic::new(
                Code::DuplicateName,
                name.span,
                format!("`{}` is declared twice", name.text),
            )
            .related(other, "the other declaration is here"),
        );
    }

    /// Refuses the name of an elementary type for something else.
    pub(super) fn refuse_reserved(&mut self, name: &Name) -> bool {
        let reserved = elementary(&name.key).is_some()
            || matches!(&*name.key, "STRING" | "WSTRING" | "EN" | "ENO");
        if reserved {
            let found = format!("`{}` is a name of the standard", name.text);
            self.tell(
                Diagnostic::new(Code::ReservedName, name.span, found)
                    .allowed("a name that is no elementary type and not EN or ENO"),
            );
        }
        reserved
    }
}

/// The elementary type of this key.
pub(super) fn elementary(key: &str) -> Option<Elementary> {
    let long = match key {
        "TIME_OF_DAY" => "TOD",
        "DATE_AND_TIME" => "DT",
        "LTIME_OF_DAY" => "LTOD",
        "LDATE_AND_TIME" => "LDT",
        _ => key,
    };
    Elementary::ALL.into_iter().find(|elementary| elementary.name() == long)
}

/// The candidate that is most like a name that is unknown, if any is close.
pub(super) fn similar<'n>(key: &str, candidates: impl Iterator<Item = &'n str>) -> Option<&'n str> {
    let allowed = key.len().div_ceil(4).min(3);
    candidates
        .filter(|candidate| candidate.len().abs_diff(key.len()) <= allowed)
        .map(|candidate| (distance(key, &candidate.to_ascii_uppercase()), candidate))
        // A name of which nothing is left is not meant.
        .filter(|(distance, _)| *distance <= allowed && *distance < key.len())
        .min()
        .map(|(_, candidate)| candidate)
}

/// How many letters have to be changed, added or removed (Levenshtein's distance). Both are short: the
/// lexer bounds names.
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut before = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.bytes().enumerate() {
            let changed = before + usize::from(x != y);
            before = row[j + 1];
            row[j + 1] = changed.min(before + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}
