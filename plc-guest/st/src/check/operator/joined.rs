//! The type that two operands have in common.

use super::super::body::Body;
use super::super::convert::{common, widens};
use super::super::expression::Operand;
use super::super::literal::fits;
use super::super::types::{is_bit_string, is_integer, is_real};
use crate::hir::{Constant, Conversion, Elementary, Expr, Type, TypeId};
use crate::source::Span;

impl<'a> Body<'_, 'a> {
    /// The elementary type of a value, if it is of exactly one.
    pub(in crate::check) fn plain(&self, ty: TypeId) -> Option<Elementary> {
        match self.checker.program.types.get(ty) {
            Type::Elementary(elementary) => Some(*elementary),
            _ => None,
        }
    }

    /// Values of a subrange compute as those of its base.
    pub(in crate::check) fn without_subrange(&mut self, operand: Operand, span: Span) -> Operand {
        match self.checker.program.types.get(operand.expr.ty) {
            Type::Subrange { base, .. } => {
                let base = *base;
                let ty = self.elementary(base);
                Operand::typed(self.convert(Conversion::Value, operand.expr, ty, span))
            }
            _ => operand,
        }
    }

    /// Both operands in the type that they have in common, if any. `needed` is what is needed where they stand.
    pub(in crate::check) fn joined(
        &mut self,
        left: (Operand, Span),
        right: (Operand, Span),
        needed: Option<TypeId>,
    ) -> Option<(Expr, Expr, TypeId, bool)> {
        let (a, b) = (self.plain(left.0.expr.ty), self.plain(right.0.expr.ty));
        let untyped = left.0.untyped && right.0.untyped;
        let ty = match (left.0.untyped, right.0.untyped) {
            // The one without a type takes the other's if it fits.
            (true, false) if self.takes(&left.0, right.0.expr.ty) => right.0.expr.ty,
            (false, true) if self.takes(&right.0, left.0.expr.ty) => left.0.expr.ty,
            (true, false) if self.real_with(&left.0, right.0.expr.ty, needed) => needed?,
            (false, true) if self.real_with(&right.0, left.0.expr.ty, needed) => needed?,
            (true, true) if a.is_some_and(is_real) => left.0.expr.ty,
            (true, true) if b.is_some_and(is_real) => right.0.expr.ty,
            _ => self.elementary(common(a?, b?)?),
        };
        let left = self.converted(left.0, ty, left.1)?;
        let right = self.converted(right.0, ty, right.1)?;
        Some((left, right, ty, untyped))
    }

    /// Whether a literal with a point, joined with a value of a type that REAL holds, is a REAL: if one is needed.
    pub(in crate::check) fn real_with(
        &self,
        operand: &Operand,
        other: TypeId,
        needed: Option<TypeId>,
    ) -> bool {
        operand.untyped
            && matches!(operand.constant(), Some(Constant::Real(_)))
            && needed.is_some_and(|ty| self.plain(ty) == Some(Elementary::Real))
            && self.plain(other).is_some_and(|ty| widens(ty, Elementary::Real))
    }

    /// Whether a constant without a type can be a value of a type.
    pub(in crate::check) fn takes(&self, operand: &Operand, ty: TypeId) -> bool {
        let Some(target) = self.plain(ty) else { return false };
        match operand.constant() {
            Some(Constant::Integer(value)) => {
                is_real(target)
                    || (is_integer(target) || is_bit_string(target)) && fits(target, *value)
            }
            Some(Constant::Real(_)) => is_real(target),
            Some(Constant::String(bytes)) => target == Elementary::Char && bytes.len() == 1,
            Some(Constant::WString(units)) => target == Elementary::Wchar && units.len() == 1,
            _ => false,
        }
    }
}
