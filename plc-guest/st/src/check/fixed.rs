//! Places that stay the same while something else runs: what they compute on the way is kept in variables of the compiler's.
//!
//! A call may change what its instance's index or its output's place is computed of, and computing may call something.

use super::body::Body;
use crate::hir::{Block, Constant, Expr, ExprKind, Place, Root, StatementKind, Step};
use crate::source::Span;

impl Body<'_, '_> {
    /// The place with its indices and references computed once, by statements that are added to `before`.
    pub(super) fn fixed(&mut self, mut place: Place, before: &mut Block, span: Span) -> Place {
        // A VAR_IN_OUT stands for the same variable throughout a call.
        let in_out = self.is_in_out(&place);
        if let Root::Deref(reference) = &mut place.root
            && !in_out
        {
            self.keep(reference, before, span);
        }
        for step in &mut place.path {
            match step {
                Step::Index(index) | Step::Unit(index) => self.keep(index, before, span),
                Step::OpenIndex(list) => {
                    list.iter_mut().for_each(|index| self.keep(index, before, span));
                }
                Step::Field(_) | Step::Bit(_) | Step::Part { .. } => {}
            }
        }
        place
    }

    fn keep(&mut self, value: &mut Expr, before: &mut Block, span: Span) {
        if self.stays(value) {
            return;
        }
        let kept = Place::local(self.temporary("'place", value.ty), value.ty);
        let load = self.expr(value.ty, ExprKind::Load(kept.clone()), span);
        let computed = std::mem::replace(value, Expr { location: value.location, ..load });
        before.push(self.statement(StatementKind::Assign(kept, computed), span));
    }

    /// Whether nothing can change a value: constants, and what FOR loops around count. Those the code generator knows
    /// the ranges of, so that they should stay as they are.
    fn stays(&self, value: &Expr) -> bool {
        match &value.kind {
            ExprKind::Constant(Constant::Integer(_)) => true,
            ExprKind::Load(place) => {
                !matches!(place.root, Root::Global(_)) && self.counting.contains(place)
            }
            ExprKind::Unary(_, part) | ExprKind::Convert(_, part) => self.stays(part),
            ExprKind::Arithmetic(_, left, right) => self.stays(left) && self.stays(right),
            _ => false,
        }
    }
}
