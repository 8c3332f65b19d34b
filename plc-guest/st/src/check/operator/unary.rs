//! NOT and signs.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::literal;
use super::super::types::{is_bit_string, is_duration, is_integer, is_real};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{self, Constant, Elementary, ExprKind};
use crate::source::Span;
use crate::syntax::ast::UnaryOperator;

impl<'a> Body<'_, 'a> {
    pub(in crate::check) fn unary_operator(
        &mut self,
        operator: UnaryOperator,
        operand: Operand,
        span: Span,
    ) -> Option<Operand> {
        let operand = self.without_subrange(operand, span);
        let ty = operand.expr.ty;
        let elementary = self.plain(ty);
        let fits = elementary.is_some_and(|elementary| match operator {
            UnaryOperator::Not => {
                is_bit_string(elementary) || operand.untyped && !is_real(elementary)
            }
            UnaryOperator::Plus => is_integer(elementary) || is_real(elementary),
            UnaryOperator::Negate => {
                is_real(elementary)
                    || is_duration(elementary)
                    || operand.untyped
                    || operand.constant().is_some()
                    || is_integer(elementary)
                        && elementary.range().is_some_and(|(least, _)| least < 0)
            }
        });
        let Some(elementary) = elementary.filter(|_| fits) else {
            let (sign, allowed) = match operator {
                UnaryOperator::Not => ("NOT", "BOOL or a bit string"),
                UnaryOperator::Plus => ("+", "a number"),
                UnaryOperator::Negate => ("-", "a number with a sign or a duration"),
            };
            let found = format!("`{sign}` of {}", self.type_name(ty));
            self.tell(Diagnostic::new(Code::TypeMismatch, span, found).allowed(allowed));
            return None;
        };
        if operator == UnaryOperator::Plus {
            return Some(operand);
        }
        let constant = operand.constant().cloned();
        let operator = match operator {
            UnaryOperator::Not => hir::UnaryOperator::Not,
            _ => hir::UnaryOperator::Negate,
        };
        match (constant, operator) {
            (Some(Constant::Integer(value)), hir::UnaryOperator::Negate) if operand.untyped => {
                Some(self.number(-value, span))
            }
            (Some(Constant::Integer(value)), hir::UnaryOperator::Negate) => {
                if !literal::fits(elementary, -value) {
                    let found = format!("{} is no {}", -value, elementary.name());
                    let (least, most) = elementary.range()?;
                    let one = Diagnostic::new(Code::OutOfRange, span, found);
                    self.tell(one.allowed(format!("{least}..{most}")));
                    return None;
                }
                Some(Operand::typed(self.integer(ty, -value, span)))
            }
            (Some(Constant::Real(value)), hir::UnaryOperator::Negate) => {
                let kind = ExprKind::Constant(Constant::Real(-value));
                let short = operand.short.map(|short| -short);
                Some(Operand { expr: self.expr(ty, kind, span), short, ..operand })
            }
            (Some(Constant::Integer(value)), hir::UnaryOperator::Not) if !operand.untyped => {
                let value = match elementary {
                    Elementary::Bool => i128::from(value == 0),
                    _ => elementary.wrap(!value),
                };
                Some(Operand::typed(self.integer(ty, value, span)))
            }
            (Some(Constant::Integer(_)), hir::UnaryOperator::Not) => {
                let found = "NOT of a number without a type";
                let one = Diagnostic::new(Code::TypeMismatch, span, found);
                self.tell(one.hint("write its type: `NOT WORD#16#00FF`, `NOT BOOL#1`"));
                None
            }
            _ => {
                let kind = ExprKind::Unary(operator, Box::new(operand.expr));
                Some(Operand::typed(self.expr(ty, kind, span)))
            }
        }
    }
}
