//! Operators: the types that they take, and what they become.

mod arithmetic;
mod compare;
mod joined;
mod logic;
mod time;
mod unary;

use super::body::Body;
use super::expression::Operand;
use super::types::is_bit_string;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{BinaryOperator, Expression};

/// An operator as it is written.
#[derive(Clone, Copy)]
pub(in crate::check) struct Written {
    pub operator: BinaryOperator,
    /// Where it stands, or the name of the function that it is.
    pub place: Span,
    /// Where it stands with its operands.
    pub span: Span,
    /// The type that is needed there, if any, for literals that take none from the other side.
    pub needed: Option<TypeId>,
}

impl<'a> Body<'_, 'a> {
    pub(in crate::check) fn binary(
        &mut self,
        operator: BinaryOperator,
        place: Span,
        left: &'a Expression,
        right: &'a Expression,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        // What is needed of a comparison is BOOL, which says nothing of its sides.
        let hint = hint.filter(|_| compare::comparison(operator).is_none());
        // An enumeration's value on one side may be of the other side's type, and so may literals joined with bits.
        let a = self.operand(left, hint);
        let near = a.as_ref().filter(|a| !a.untyped).map(|a| a.expr.ty);
        let near = near.filter(|ty| {
            self.is_enumeration(*ty)
                || logic::is_logic(operator) && self.plain(*ty).is_some_and(is_bit_string)
        });
        let near = near.or(hint);
        let b = self.operand(right, near);
        let (a, b) = (a?, b?);
        let span = left.span.to(right.span);
        let written = Written { operator, place, span, needed: hint };
        self.binary_operands(written, (a, left.span), (b, right.span))
    }

    /// An operator on two checked operands, each with its place.
    pub(in crate::check) fn binary_operands(
        &mut self,
        written: Written,
        left: (Operand, Span),
        right: (Operand, Span),
    ) -> Option<Operand> {
        let left = (self.without_subrange(left.0, left.1), left.1);
        let right = (self.without_subrange(right.0, right.1), right.1);
        if let Some(comparison) = compare::comparison(written.operator) {
            return self.compare(comparison, written, left, right);
        }
        match written.operator {
            operator if logic::is_logic(operator) => self.logic(written, left, right),
            BinaryOperator::Power => self.power(written, left, right),
            _ => match self.time_arithmetic(written, &left, &right) {
                Some(result) => result,
                None => self.arithmetic(written, left, right),
            },
        }
    }

    pub(super) fn is_enumeration(&self, ty: TypeId) -> bool {
        matches!(self.checker.program.types.get(ty), Type::Enumeration { .. })
    }

    pub(super) fn mismatch(&mut self, written: Written, a: TypeId, b: TypeId, allowed: &str) {
        let sign = sign(written.operator);
        let found = format!("`{sign}` of {} and {}", self.type_name(a), self.type_name(b));
        self.tell(Diagnostic::new(Code::TypeMismatch, written.place, found).allowed(allowed));
    }
}

/// As it is written.
pub(in crate::check) fn sign(operator: BinaryOperator) -> &'static str {
    match operator {
        BinaryOperator::Power => "**",
        BinaryOperator::Multiply => "*",
        BinaryOperator::Divide => "/",
        BinaryOperator::Modulo => "MOD",
        BinaryOperator::Add => "+",
        BinaryOperator::Subtract => "-",
        BinaryOperator::Less => "<",
        BinaryOperator::Greater => ">",
        BinaryOperator::LessEqual => "<=",
        BinaryOperator::GreaterEqual => ">=",
        BinaryOperator::Equal => "=",
        BinaryOperator::NotEqual => "<>",
        BinaryOperator::And => "AND",
        BinaryOperator::AndThen => "AND_THEN",
        BinaryOperator::Xor => "XOR",
        BinaryOperator::Or => "OR",
        BinaryOperator::OrElse => "OR_ELSE",
    }
}
