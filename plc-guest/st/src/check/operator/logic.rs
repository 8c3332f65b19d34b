//! AND, OR, XOR and their forms that evaluate the right side only if needed.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::types::is_bit_string;
use super::Written;
use crate::hir::{Arithmetic, Elementary, ExprKind};
use crate::source::Span;
use crate::syntax::ast::BinaryOperator;

pub(super) fn is_logic(operator: BinaryOperator) -> bool {
    use BinaryOperator::{And, AndThen, Or, OrElse, Xor};
    matches!(operator, And | Or | Xor | AndThen | OrElse)
}

impl<'a> Body<'_, 'a> {
    pub(super) fn logic(
        &mut self,
        written: Written,
        left: (Operand, Span),
        right: (Operand, Span),
    ) -> Option<Operand> {
        let Written { operator, span, .. } = written;
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let short = matches!(operator, BinaryOperator::AndThen | BinaryOperator::OrElse);
        let bits = |elementary: Option<Elementary>, untyped: bool| {
            elementary.is_some_and(|elementary| is_bit_string(elementary) || untyped)
        };
        let fit = bits(self.plain(a), left.0.untyped) && bits(self.plain(b), right.0.untyped);
        let needed = written.needed.filter(|ty| self.plain(*ty).is_some_and(is_bit_string));
        let joined = match (fit, needed) {
            // Numbers alone: what is needed, if they fit.
            (true, Some(ty))
                if left.0.untyped
                    && right.0.untyped
                    && self.takes(&left.0, ty)
                    && self.takes(&right.0, ty) =>
            {
                let left = self.converted(left.0, ty, left.1)?;
                Some((left, self.converted(right.0, ty, right.1)?, ty, false))
            }
            (true, _) => self.joined(left, right, None),
            (false, _) => None,
        };
        let allowed = if short { "BOOL" } else { "BOOL or bit strings (BYTE, WORD, DWORD, LWORD)" };
        let Some((left, right, ty, _)) = joined else {
            self.mismatch(written, a, b, allowed);
            return None;
        };
        let elementary = self.plain(ty)?;
        if !is_bit_string(elementary) || short && elementary != Elementary::Bool {
            self.mismatch(written, a, b, allowed);
            return None;
        }
        let op = match operator {
            BinaryOperator::And | BinaryOperator::AndThen => Arithmetic::And,
            BinaryOperator::Xor => Arithmetic::Xor,
            _ => Arithmetic::Or,
        };
        if let (true, ExprKind::Constant(a), ExprKind::Constant(b)) =
            (short, &left.kind, &right.kind)
            && let Some(value) = self.fold_arithmetic(op, a, b, ty)
        {
            return Some(Operand::typed(self.expr(ty, ExprKind::Constant(value), span)));
        }
        match operator {
            BinaryOperator::AndThen => {
                let kind = ExprKind::AndThen(Box::new(left), Box::new(right));
                Some(Operand::typed(self.expr(ty, kind, span)))
            }
            BinaryOperator::OrElse => {
                let kind = ExprKind::OrElse(Box::new(left), Box::new(right));
                Some(Operand::typed(self.expr(ty, kind, span)))
            }
            _ => self.combine(op, written, left, right, ty, false),
        }
    }
}
