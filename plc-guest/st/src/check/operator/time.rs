//! Arithmetic of durations and dates.

use super::super::body::Body;
use super::super::convert::common;
use super::super::expression::Operand;
use super::super::types::{is_date, is_duration, is_integer, is_real};
use super::Written;
use crate::hir::{Arithmetic, Constant, Conversion, Elementary, Intrinsic};
use crate::source::Span;
use crate::syntax::ast::BinaryOperator;

/// The nanoseconds of a day.
const DAY: i128 = 86_400_000_000_000;

impl<'a> Body<'_, 'a> {
    /// Arithmetic of durations and dates (IEC 61131-3:2013, table 30). None if neither side is one.
    #[allow(clippy::option_option)]
    pub(super) fn time_arithmetic(
        &mut self,
        written: Written,
        left: &(Operand, Span),
        right: &(Operand, Span),
    ) -> Option<Option<Operand>> {
        use BinaryOperator as Op;
        let Written { operator, span, .. } = written;
        // What is wrong here is the value of the whole.
        let whole = Written { place: span, ..written };
        let (a, b) = (self.plain(left.0.expr.ty)?, self.plain(right.0.expr.ty)?);
        let number = |elementary| is_integer(elementary) || is_real(elementary);
        let (op, ty) = match operator {
            Op::Add if is_duration(a) && is_duration(b) => (Arithmetic::Add, common(a, b)?),
            Op::Subtract if is_duration(a) && is_duration(b) => {
                (Arithmetic::Subtract, common(a, b)?)
            }
            Op::Add if is_date(a) && is_duration(b) && has_time(a) => (Arithmetic::Add, a),
            Op::Subtract if is_date(a) && is_duration(b) && has_time(a) => {
                (Arithmetic::Subtract, a)
            }
            Op::Subtract if is_date(a) && is_date(b) => {
                let joined = self.elementary(common(a, b)?);
                let long =
                    a != b || matches!(a, Elementary::Ldate | Elementary::Ltod | Elementary::Ldt);
                let duration = if long { Elementary::Ltime } else { Elementary::Time };
                let ty = self.elementary(duration);
                let left = self.converted(left.0.clone(), joined, left.1)?;
                let right = self.converted(right.0.clone(), joined, right.1)?;
                let difference =
                    self.combine(Arithmetic::Subtract, whole, left, right, joined, false)?;
                let expr = self.convert(Conversion::Value, difference.expr, ty, span);
                return Some(Some(Operand::typed(expr)));
            }
            Op::Multiply if is_duration(a) && number(b) => (Arithmetic::Multiply, a),
            Op::Multiply if number(a) && is_duration(b) => (Arithmetic::Multiply, b),
            Op::Divide if is_duration(a) && number(b) => (Arithmetic::Divide, a),
            _ => return None,
        };
        let wraps = matches!(ty, Elementary::Tod | Elementary::Ltod);
        let ty = self.elementary(ty);
        // By a number with a point: in LREAL, then rounded to nanoseconds.
        let scaled = is_real(a) || is_real(b);
        let within = if scaled { self.elementary(Elementary::Lreal) } else { ty };
        let mut part = |operand: &(Operand, Span)| {
            let mut expr = operand.0.expr.clone();
            // A divisor that LINT does not have is greater than every duration, and so is the greatest LINT.
            let small = |one: &Constant| matches!(one, Constant::Integer(one) if i64::try_from(*one).is_ok());
            if op == Arithmetic::Divide
                && self.plain(expr.ty) == Some(Elementary::Ulint)
                && !operand.0.constant().is_some_and(small)
            {
                let most = self.integer(expr.ty, i64::MAX.into(), operand.1);
                let ty = expr.ty;
                expr = self.intrinsic(Intrinsic::Min, vec![expr, most], ty, operand.1).expr;
            }
            match expr.ty == within {
                true => expr,
                false => self.convert(Conversion::Value, expr, within, operand.1),
            }
        };
        let (left, mut right) = (part(left), part(right));
        // There is no time of day before 0:00 or behind 23:59:59.
        let day = wraps.then(|| self.integer(ty, DAY, span));
        if let Some(day) = &day {
            right = self.combine(Arithmetic::Modulo, whole, right, day.clone(), ty, false)?.expr;
        }
        let mut result = self.combine(op, whole, left, right, within, false);
        if let Some(day) = day {
            for operator in [Arithmetic::Add, Arithmetic::Modulo] {
                let (before, day) = (result?.expr, day.clone());
                result = self.combine(operator, whole, before, day, ty, false);
            }
        }
        Some(result.map(|result| match scaled {
            true => Operand::typed(self.convert(Conversion::Value, result.expr, ty, span)),
            false => result,
        }))
    }
}

/// Whether a duration can be added to it.
fn has_time(elementary: Elementary) -> bool {
    use Elementary::*;
    matches!(elementary, Tod | Ltod | Dt | Ldt)
}
