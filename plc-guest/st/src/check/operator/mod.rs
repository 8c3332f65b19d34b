//! Operators: the types that they take, and what they become.

mod arithmetic;
mod compare;
mod joined;
mod logic;
mod time;
mod unary;

use super::body::Body;
use super::convert::widens;
use super::expression::Operand;
use super::types::is_bit_string;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{BinaryOperator, Expression, ExpressionKind, UnaryOperator};

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
        let of_bits = logic::is_logic(operator) || compare::comparison(operator).is_some();
        // Numbers joined with bits, or compared with them, are bits: those on the left need what is on the right.
        let (a, b) = if of_bits && needs(left) > needs(right) {
            let b = self.operand(right, hint);
            let near = self.near(b.as_ref(), of_bits, hint);
            (self.operand(left, near), b)
        } else {
            let a = self.operand(left, hint);
            let near = self.near(a.as_ref(), of_bits, hint);
            let b = self.operand(right, near);
            (a, b)
        };
        let (a, b) = (a?, b?);
        if of_bits && needs(right) != Needs::Nothing && makes_bits(left) {
            self.refuse_narrow(&a, &b, left.span)?;
        }
        let span = left.span.to(right.span);
        let written = Written { operator, place, span, needed: hint };
        self.binary_operands(written, (a, left.span), (b, right.span))
    }

    /// The type that is needed beside an operand: its own, if it is an enumeration or a bit string that is joined with
    /// what stands there. What is needed of both may be wider: then the bits above count too.
    fn near(
        &self,
        beside: Option<&Operand>,
        of_bits: bool,
        hint: Option<TypeId>,
    ) -> Option<TypeId> {
        let Some(ty) = beside.filter(|one| !one.untyped).map(|one| one.expr.ty) else {
            return hint;
        };
        if self.is_enumeration(ty) {
            return Some(ty);
        }
        let bits = |ty: TypeId| self.plain(ty).filter(|ty| of_bits && is_bit_string(*ty));
        match (bits(ty), hint.and_then(bits)) {
            (Some(own), Some(needed)) if widens(own, needed) => hint,
            (Some(_), _) => Some(ty),
            (None, _) => hint,
        }
    }

    /// Refuses numbers on the left that would be other ones in the type on the right. Both sides have numbers, and one
    /// had to be read first.
    fn refuse_narrow(&mut self, left: &Operand, right: &Operand, span: Span) -> Option<()> {
        let bits = |operand: &Operand| {
            let ty = self.plain(operand.expr.ty).filter(|ty| is_bit_string(*ty));
            ty.filter(|_| !operand.untyped)
        };
        match (bits(left), bits(right)) {
            (Some(a), Some(b)) if widens(a, b) => {
                let found = format!("numbers in {} beside a {}", a.name(), b.name());
                let one = Diagnostic::new(Code::TypeMismatch, span, found);
                self.tell(one.hint(format!("write their type, such as `{}#16#FF`", b.name())));
                None
            }
            _ => Some(()),
        }
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

/// How much the value of an expression may depend on the type that is needed where it stands.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Needs {
    /// It has no numbers without a type.
    Nothing,
    /// It has some beside others.
    Some,
    /// It has nothing else, or calls a function with one.
    All,
}

fn needs(expression: &Expression) -> Needs {
    match &expression.kind {
        ExpressionKind::Literal(literal) if literal.prefix.is_none() => Needs::All,
        ExpressionKind::Parenthesised(inner) | ExpressionKind::Unary(_, inner) => needs(inner),
        ExpressionKind::Binary(_, _, left, right) => match (needs(left), needs(right)) {
            (a, b) if a == b => a,
            _ => Needs::Some,
        },
        ExpressionKind::Call(_, arguments) => {
            let values = arguments.iter().filter_map(|argument| argument.value.as_ref());
            match values.map(needs).max() {
                Some(Needs::Some | Needs::All) => Needs::All,
                _ => Needs::Nothing,
            }
        }
        _ => Needs::Nothing,
    }
}

/// Whether an expression has numbers that become others in a wider type: behind NOT, or in a call such as of ROL.
fn makes_bits(expression: &Expression) -> bool {
    match &expression.kind {
        ExpressionKind::Unary(UnaryOperator::Not, inner) => needs(inner) != Needs::Nothing,
        ExpressionKind::Call(..) => needs(expression) == Needs::All,
        ExpressionKind::Parenthesised(inner) | ExpressionKind::Unary(_, inner) => makes_bits(inner),
        ExpressionKind::Binary(_, _, left, right) => makes_bits(left) || makes_bits(right),
        _ => false,
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
