//! Operators: the types that they take, and what they become.

mod arithmetic;
mod compare;
mod joined;
mod logic;
mod time;
mod unary;

use super::body::Body;
use super::expression::Operand;
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
        // An enumeration's value on one side may be of the other side's type.
        let a = self.operand(left, hint);
        let near = a.as_ref().map(|a| a.expr.ty).filter(|ty| self.is_enumeration(*ty)).or(hint);
        let b = self.operand(right, near);
        let (a, b) = (a?, b?);
        let span = left.span.to(right.span);
        self.binary_operands(Written { operator, place, span }, (a, left.span), (b, right.span))
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
            BinaryOperator::And
            | BinaryOperator::Or
            | BinaryOperator::Xor
            | BinaryOperator::AndThen
            | BinaryOperator::OrElse => self.logic(written, left, right),
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
