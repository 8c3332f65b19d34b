//! Warnings of variables that nothing uses.

use super::Checker;
use super::body::Body;
use super::unit::Storage;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Area, StructureKind};
use crate::syntax::ast::{self, SectionKind};

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
