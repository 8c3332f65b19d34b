//! Warnings of variables that nothing uses.

use std::collections::{BTreeSet, HashMap};

use super::body::Body;
use super::unit::Storage;
use super::{Checker, Input};
use crate::diagnostic::{Code, Diagnostic, Diagnostics};
use crate::hir::{Area, StructureKind};
use crate::source::Span;
use crate::syntax::ast::{self, Declaration, SectionKind};

/// Which warnings of unused variables may be wrong, since something that has errors may use the variable.
///
/// A variable of a unit is in doubt if its unit has an error, and all of a file are if its text could not be read as
/// units. A global variable is in doubt with any error.
pub(super) struct Doubts {
    /// The units of each file that has any, and whether they have errors.
    units: HashMap<usize, Vec<(Span, bool)>>,
    /// Files with units that may not be whole.
    files: Vec<usize>,
    errors: bool,
}

impl Doubts {
    pub(super) fn of(files: &[Input<'_>], diagnostics: &Diagnostics) -> Self {
        let mut units: HashMap<usize, Vec<(Span, bool)>> = HashMap::new();
        for declaration in files.iter().flat_map(|file| &file.tree.declarations) {
            if let Declaration::Unit(unit) = declaration {
                units.entry(unit.span.file.index()).or_default().push((unit.span, false));
            }
        }
        let mut doubts = Self { units, files: Vec::new(), errors: diagnostics.has_errors() };
        let mut told = BTreeSet::new();
        for one in diagnostics.iter().filter(|one| one.is_error()) {
            let file = one.span.file.index();
            match doubts.units.get_mut(&file).and_then(|units| around(units, one.span)) {
                Some((_, errors)) => *errors = true,
                None if is_of_text(one.code) => doubts.files.push(file),
                None => {}
            }
            told.insert(one.span.file);
        }
        // Errors that were not kept may be anywhere in their file.
        let full = told.into_iter().filter(|file| diagnostics.left_out(*file) > 0);
        doubts.files.extend(full.map(|file| file.index()));
        doubts.files.sort_unstable();
        doubts.files.dedup();
        doubts
    }

    /// Whether a message is such a warning.
    pub(super) fn concern(&self, one: &Diagnostic) -> bool {
        if !matches!(one.code, Code::Unused | Code::NeverAssigned | Code::MissingResult) {
            return false;
        }
        let file = one.span.file.index();
        let units = self.units.get(&file).map_or(&[][..], |units| units);
        match units.iter().find(|(unit, _)| contains(*unit, one.span)) {
            Some((_, errors)) => *errors || self.files.binary_search(&file).is_ok(),
            None => self.errors,
        }
    }
}

fn around(units: &mut [(Span, bool)], span: Span) -> Option<&mut (Span, bool)> {
    units.iter_mut().find(|(unit, _)| contains(*unit, span))
}

fn contains(unit: Span, span: Span) -> bool {
    (unit.start..=unit.end).contains(&span.start)
}

/// Whether an error may hide which unit a word belongs to.
fn is_of_text(code: Code) -> bool {
    use Code::*;
    matches!(code, InvalidCharacter | Unterminated | Syntax | TooDeep | NotSupported | ReservedName)
}

impl Body<'_, '_> {
    pub(super) fn warn_of_variables(&mut self, ast: &ast::Unit) {
        let Some(unit) = self.unit else { return };
        if self.checker.units[unit].library {
            return;
        }
        if self.checker.units[unit].result.is_some() && !self.result_assigned {
            let found = format!("`{}` never assigns its result", ast.name.text);
            let one = Diagnostic::new(Code::MissingResult, ast.name.span, found);
            self.tell(one.hint(format!("write `{} := value;`", ast.name.text)));
        }
        for index in 0..self.variables.len() {
            let variable = &self.variables[index];
            let (read, written) = (variable.read, variable.written);
            let name = variable.name;
            let found = match variable.kind {
                SectionKind::Local | SectionKind::Temporary | SectionKind::External
                    if !read && !written =>
                {
                    Some((Code::Unused, format!("`{}` is never used", name.text)))
                }
                SectionKind::Local | SectionKind::Temporary
                    if !written && !variable.initialised && !self.comes_from_outside(index) =>
                {
                    let found = format!("`{}` is read and never assigned", name.text);
                    Some((Code::NeverAssigned, found))
                }
                SectionKind::Output if !written && !variable.initialised => {
                    let found = format!("the output `{}` is never assigned", name.text);
                    Some((Code::NeverAssigned, found))
                }
                SectionKind::Input | SectionKind::InOut if !read && !written => {
                    Some((Code::Unused, format!("`{}` is never used", name.text)))
                }
                _ => None,
            };
            if let Some((code, found)) = found {
                self.tell(Diagnostic::new(code, name.span, found));
            }
        }
    }

    /// Whether a variable has a value that no statement gives it: an image, a constant, an instance.
    fn comes_from_outside(&self, index: usize) -> bool {
        let variable = &self.variables[index];
        let located = match variable.storage {
            Storage::Global(id) => self.checker.program.global(id).storage.area != Area::State,
            Storage::Constant(..) | Storage::Nowhere => true,
            Storage::Field(_) => variable.address.is_some(),
            _ => false,
        };
        let instance = variable
            .ty
            .and_then(|ty| self.checker.program.types.structure(ty))
            .is_some_and(|structure| structure.kind != StructureKind::Struct);
        located || instance
    }
}

impl Checker<'_> {
    pub(super) fn warn_of_globals(&mut self) {
        for index in 0..self.globals.len() {
            let entry = &self.globals[index];
            let located = entry.variables.address.is_some();
            let name = entry.name;
            if entry.library || entry.ty.is_none() || entry.read && entry.written {
                continue;
            }
            let known = located || entry.variables.initial.is_some() || entry.constant.is_some();
            if !entry.read && !entry.written && !located {
                let found = format!("`{}` is never used", name.text);
                self.tell(Diagnostic::new(Code::Unused, name.span, found));
            } else if !entry.written && !known {
                let found = format!("`{}` is read and never assigned", name.text);
                self.tell(Diagnostic::new(Code::NeverAssigned, name.span, found));
            }
        }
    }
}
