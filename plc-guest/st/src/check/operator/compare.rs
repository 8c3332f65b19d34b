//! Comparisons.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::fold;
use super::super::types::is_real;
use super::{Written, sign};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Comparison, Elementary, ExprKind, Type};
use crate::source::Span;
use crate::syntax::ast::BinaryOperator;

impl<'a> Body<'_, 'a> {
    pub(super) fn compare(
        &mut self,
        comparison: Comparison,
        written: Written,
        left: (Operand, Span),
        right: (Operand, Span),
    ) -> Option<Operand> {
        let Written { operator, place, span, .. } = written;
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let equality = matches!(comparison, Comparison::Equal | Comparison::NotEqual);
        let types = &self.checker.program.types;
        let strings = types.is_string(a) || types.is_string(b);
        let reference = |ty| matches!(types.get(ty), Type::Reference { .. });
        let (left, right) = if strings || reference(a) || reference(b) {
            let char_or_text = |operand: &Operand| operand.untyped;
            if reference(a) && !equality {
                self.mismatch(written, a, b, "references only with `=` and `<>`");
                return None;
            }
            let target = if char_or_text(&left.0) { b } else { a };
            if self.both_strings(a, b) {
                self.used_as_string(&left.0.expr, left.1)?;
                self.used_as_string(&right.0.expr, right.1)?;
                (left.0.expr, right.0.expr)
            } else {
                (self.converted(left.0, target, left.1)?, self.converted(right.0, target, right.1)?)
            }
        } else if a == b && self.is_enumeration(a) {
            if !equality {
                self.mismatch(written, a, b, "enumerations only with `=` and `<>`");
                return None;
            }
            (left.0.expr, right.0.expr)
        } else {
            let Some((left, right, _, _)) = self.joined(left, right, None) else {
                self.mismatch(written, a, b, "two values of one elementary type or string");
                return None;
            };
            (left, right)
        };
        if equality && self.plain(left.ty).is_some_and(is_real) {
            self.tell(
                Diagnostic::new(
                    Code::RealEquality,
                    place,
                    format!("{} compared with `{}`", self.type_name(left.ty), sign(operator)),
                )
                .hint("compare the difference with a tolerance: `ABS(a - b) < 0.001`"),
            );
        }
        let bool_type = self.elementary(Elementary::Bool);
        if let (ExprKind::Constant(a), ExprKind::Constant(b)) = (&left.kind, &right.kind)
            && let Some(value) = fold::compare(comparison, a, b)
        {
            return Some(Operand::typed(self.integer(bool_type, value.into(), span)));
        }
        let kind = ExprKind::Compare(comparison, Box::new(left), Box::new(right));
        Some(Operand::typed(self.expr(bool_type, kind, span)))
    }
}

pub(super) fn comparison(operator: BinaryOperator) -> Option<Comparison> {
    Some(match operator {
        BinaryOperator::Equal => Comparison::Equal,
        BinaryOperator::NotEqual => Comparison::NotEqual,
        BinaryOperator::Less => Comparison::Less,
        BinaryOperator::LessEqual => Comparison::LessEqual,
        BinaryOperator::Greater => Comparison::Greater,
        BinaryOperator::GreaterEqual => Comparison::GreaterEqual,
        _ => return None,
    })
}
