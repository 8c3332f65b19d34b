//! Arithmetic of numbers.

use super::super::body::Body;
use super::super::convert::widens;
use super::super::expression::Operand;
use super::super::fold;
use super::super::types::{is_integer, is_real};
use super::Written;
use crate::diagnostic::Code;
use crate::hir::{Arithmetic, Constant, Conversion, Elementary, Expr, ExprKind, Intrinsic, TypeId};
use crate::source::Span;
use crate::syntax::ast::BinaryOperator;

impl<'a> Body<'_, 'a> {
    pub(super) fn arithmetic(
        &mut self,
        written: Written,
        left: (Operand, Span),
        right: (Operand, Span),
    ) -> Option<Operand> {
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let (op, allowed) = match written.operator {
            BinaryOperator::Add => (Arithmetic::Add, "numbers or durations"),
            BinaryOperator::Subtract => (Arithmetic::Subtract, "numbers, durations or dates"),
            BinaryOperator::Multiply => {
                (Arithmetic::Multiply, "numbers, or a duration and a number")
            }
            BinaryOperator::Divide => (Arithmetic::Divide, "numbers, or a duration and a number"),
            _ => (Arithmetic::Modulo, "integers"),
        };
        let number = |elementary: Option<Elementary>| {
            elementary.is_some_and(|elementary| {
                is_integer(elementary) || is_real(elementary) && op != Arithmetic::Modulo
            })
        };
        if !(number(self.plain(a)) && number(self.plain(b))) {
            self.mismatch(written, a, b, allowed);
            return None;
        }
        let Some((left, right, ty, untyped)) = self.joined(left, right, written.needed) else {
            let allowed = "types of which one holds all values of the other";
            self.mismatch(written, a, b, allowed);
            return None;
        };
        self.combine(op, written, left, right, ty, untyped)
    }

    /// An arithmetic node, or its value if both sides are constants.
    pub(super) fn combine(
        &mut self,
        operator: Arithmetic,
        written: Written,
        left: Expr,
        right: Expr,
        ty: TypeId,
        untyped: bool,
    ) -> Option<Operand> {
        let Written { place, span, .. } = written;
        let divides = matches!(operator, Arithmetic::Divide | Arithmetic::Modulo);
        let zero = ExprKind::Constant(Constant::Integer(0));
        if divides && right.kind == zero {
            self.error(Code::DivisionByZero, place, "a division by zero");
            return None;
        }
        if let (ExprKind::Constant(a), ExprKind::Constant(b)) = (&left.kind, &right.kind) {
            if let (true, Constant::Integer(a), Constant::Integer(b)) = (untyped, a, b) {
                let value = fold::integers(operator, *a, *b).filter(|value| {
                    *value >= i128::from(i64::MIN) && *value <= i128::from(u64::MAX)
                });
                let Some(value) = value else {
                    self.error(Code::OutOfRange, span, "a number of more than 64 bits");
                    return None;
                };
                return Some(self.number(value, span));
            }
            if let Some(value) = self.fold_arithmetic(operator, a, b, ty) {
                let expr = self.expr(ty, ExprKind::Constant(value), span);
                return Some(Operand { untyped, ..Operand::typed(expr) });
            }
        }
        let kind = ExprKind::Arithmetic(operator, Box::new(left), Box::new(right));
        Some(Operand::typed(self.expr(ty, kind, span)))
    }

    pub(super) fn power(
        &mut self,
        written: Written,
        left: (Operand, Span),
        right: (Operand, Span),
    ) -> Option<Operand> {
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let (base, exponent) = (self.plain(a), self.plain(b));
        let number = |elementary: Option<Elementary>| {
            elementary.is_some_and(|elementary| is_integer(elementary) || is_real(elementary))
        };
        if !(number(base) && number(exponent)) {
            self.mismatch(written, a, b, "numbers");
            return None;
        }
        // In REAL if a side is one or one is needed, and the base fits; else in LREAL.
        let typed = |elementary: Option<Elementary>, untyped: bool| elementary.filter(|_| !untyped);
        let sides = [typed(base, left.0.untyped), typed(exponent, right.0.untyped)];
        let needed = written.needed.is_some_and(|ty| self.plain(ty) == Some(Elementary::Real));
        let fits =
            sides[0].is_none_or(|base| base == Elementary::Real || widens(base, Elementary::Real));
        let in_real = (needed || sides.contains(&Some(Elementary::Real)))
            && fits
            && sides[1] != Some(Elementary::Lreal);
        let result = self.elementary(if in_real { Elementary::Real } else { Elementary::Lreal });
        // An odd exponent that REAL does not hold would become an even one, and the power lose its sign.
        let exact = exponent
            .is_none_or(|exponent| !is_integer(exponent) || widens(exponent, Elementary::Real));
        let ty = if exact { result } else { self.elementary(Elementary::Lreal) };
        let as_number = |body: &mut Self, operand: (Operand, Span)| match operand.0.untyped {
            true => body.converted(operand.0, ty, operand.1),
            false if operand.0.expr.ty == ty => Some(operand.0.expr),
            false => Some(body.convert(Conversion::Value, operand.0.expr, ty, operand.1)),
        };
        let left = as_number(self, left)?;
        let right = as_number(self, right)?;
        let kind = ExprKind::Intrinsic(Intrinsic::Power, vec![left, right]);
        let power = self.expr(ty, kind, written.span);
        Some(Operand::typed(match ty == result {
            true => power,
            false => self.convert(Conversion::Value, power, result, written.span),
        }))
    }
}
