//! `REF(variable)`.
//!
//! A reference may be kept, so it refers to nothing that is gone before it. Instances of function blocks live as long as
//! the program: a variable of a function and VAR_TEMP have none, and so all variables of instances may be referred to.
//! What a VAR_IN_OUT stands for may be a variable of a function, wherever the call came from.

use super::body::Body;
use super::expression::Operand;
use super::unit::is_part;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{ExprKind, Place, Root, Section, Step};
use crate::source::Span;
use crate::syntax::ast;

impl<'a> Body<'_, 'a> {
    pub(super) fn reference(
        &mut self,
        arguments: &'a [ast::Argument],
        span: Span,
    ) -> Option<Operand> {
        let [ast::Argument { name: None, value: Some(target), .. }] = arguments else {
            let one = Diagnostic::new(Code::WrongArguments, span, "REF with other arguments");
            self.tell(one.allowed("`REF(variable)`"));
            return None;
        };
        let place = self.write_place(target)?;
        if let Some(found) = self.no_target(&place) {
            let one = Diagnostic::new(Code::WrongArguments, target.span, format!("REF of {found}"));
            self.tell(one.allowed("variables of programs, function blocks and VAR_GLOBAL"));
            return None;
        }
        let ty = self.checker.program.types.reference(place.ty);
        Some(Operand::typed(self.expr(ty, ExprKind::Reference(place), span)))
    }

    /// What a place is that cannot be referred to.
    fn no_target(&self, place: &Place) -> Option<&'static str> {
        let bit = match place.root {
            Root::Global(id) => self.checker.program.global(id).storage.bit.is_some(),
            _ => false,
        };
        if bit || is_part(place) {
            return Some("a bit or a part of a variable, which has no address");
        }
        if self.is_in_out(place) {
            return Some(
                "a VAR_IN_OUT, which may stand for a variable that does not outlive the call",
            );
        }
        matches!(place.root, Root::Local(_)).then_some("a variable that does not outlive the call")
    }

    /// Whether a place is what a VAR_IN_OUT of this function block stands for, or a part of that. What a reference in it
    /// refers to is none: that was made by REF.
    pub(super) fn is_in_out(&self, place: &Place) -> bool {
        let Root::Deref(reference) = &place.root else { return false };
        let ExprKind::Load(Place { root: Root::Instance, path, .. }) = &reference.kind else {
            return false;
        };
        let structure = self.unit.and_then(|unit| self.checker.units[unit].structure);
        let structure = structure.and_then(|ty| self.checker.program.types.structure(ty));
        match (structure, &path[..]) {
            (Some(structure), [Step::Field(field)]) => {
                structure.fields[*field as usize].section == Section::InOut
            }
            _ => false,
        }
    }
}
