//! Operators: the types that they take, and what they become.

use super::body::Body;
use super::convert::common;
use super::expression::Operand;
use super::fold;
use super::types::{is_bit_string, is_date, is_duration, is_integer, is_real};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    self, Arithmetic, Comparison, Constant, Conversion, Elementary, Expr, ExprKind, Intrinsic,
    Type, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{BinaryOperator, Expression, UnaryOperator};

impl<'a> Body<'_, 'a> {
    pub(super) fn unary_operator(
        &mut self,
        operator: UnaryOperator,
        operand: Operand,
        span: Span,
    ) -> Option<Operand> {
        let operand = self.without_subrange(operand, span);
        let ty = operand.expr.ty;
        let elementary = self.plain(ty);
        let fits = elementary.is_some_and(|elementary| match operator {
            UnaryOperator::Not => is_bit_string(elementary) || operand.untyped,
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
                if !super::literal::fits(elementary, -value) {
                    let found = format!("{} is no {}", -value, elementary.name());
                    let (least, most) = elementary.range()?;
                    let one = Diagnostic::new(Code::OutOfRange, span, found);
                    self.tell(one.allowed(format!("{least}..{most}")));
                    return None;
                }
                Some(Operand::typed(self.integer(ty, -value, span)))
            }
            (Some(Constant::Real(value)), _) => {
                let kind = ExprKind::Constant(Constant::Real(-value));
                Some(Operand { expr: self.expr(ty, kind, span), ..operand })
            }
            (Some(Constant::Integer(value)), hir::UnaryOperator::Not) if !operand.untyped => {
                let value = match elementary {
                    Elementary::Bool => i128::from(value == 0),
                    _ => elementary.wrap(!value),
                };
                Some(Operand::typed(self.integer(ty, value, span)))
            }
            (Some(Constant::Integer(0 | 1)), hir::UnaryOperator::Not) => {
                let bool_type = self.elementary(Elementary::Bool);
                let value = operand.constant() == Some(&Constant::Integer(0));
                Some(Operand::typed(self.integer(bool_type, value.into(), span)))
            }
            (Some(Constant::Integer(_)), hir::UnaryOperator::Not) => {
                let found = "NOT of a number without a type";
                let one = Diagnostic::new(Code::TypeMismatch, span, found);
                self.tell(one.hint("write its type: `NOT WORD#16#00FF`"));
                None
            }
            _ => {
                let kind = ExprKind::Unary(operator, Box::new(operand.expr));
                Some(Operand::typed(self.expr(ty, kind, span)))
            }
        }
    }

    pub(super) fn binary(
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
        self.binary_operands(operator, place, (a, left.span), (b, right.span), span)
    }

    /// An operator on two checked operands, each with its place.
    pub(super) fn binary_operands(
        &mut self,
        operator: BinaryOperator,
        place: Span,
        left: (Operand, Span),
        right: (Operand, Span),
        span: Span,
    ) -> Option<Operand> {
        let left = (self.without_subrange(left.0, left.1), left.1);
        let right = (self.without_subrange(right.0, right.1), right.1);
        if let Some(comparison) = comparison(operator) {
            return self.compare(comparison, operator, place, left, right, span);
        }
        match operator {
            BinaryOperator::And
            | BinaryOperator::Or
            | BinaryOperator::Xor
            | BinaryOperator::AndThen
            | BinaryOperator::OrElse => self.logic(operator, place, left, right, span),
            BinaryOperator::Power => self.power(place, left, right, span),
            _ => match self.time_arithmetic(operator, &left, &right, span) {
                Some(result) => result,
                None => self.arithmetic(operator, place, left, right, span),
            },
        }
    }

    fn is_enumeration(&self, ty: TypeId) -> bool {
        matches!(self.checker.program.types.get(ty), Type::Enumeration { .. })
    }

    /// The elementary type of a value, if it is of one and nothing else.
    pub(super) fn plain(&self, ty: TypeId) -> Option<Elementary> {
        match self.checker.program.types.get(ty) {
            Type::Elementary(elementary) => Some(*elementary),
            _ => None,
        }
    }

    /// Values of a subrange compute as those of its base.
    pub(super) fn without_subrange(&mut self, operand: Operand, span: Span) -> Operand {
        match self.checker.program.types.get(operand.expr.ty) {
            Type::Subrange { base, .. } => {
                let base = *base;
                let ty = self.elementary(base);
                Operand::typed(self.convert(Conversion::Value, operand.expr, ty, span))
            }
            _ => operand,
        }
    }

    /// Both operands in the type that they have in common, if any.
    pub(super) fn joined(
        &mut self,
        left: (Operand, Span),
        right: (Operand, Span),
    ) -> Option<(Expr, Expr, TypeId, bool)> {
        let (a, b) = (self.plain(left.0.expr.ty), self.plain(right.0.expr.ty));
        let untyped = left.0.untyped && right.0.untyped;
        let ty = match (left.0.untyped, right.0.untyped) {
            // The one without a type takes the other's if it fits.
            (true, false) if self.takes(&left.0, right.0.expr.ty) => right.0.expr.ty,
            (false, true) if self.takes(&right.0, left.0.expr.ty) => left.0.expr.ty,
            (true, true) if a.is_some_and(is_real) => left.0.expr.ty,
            (true, true) if b.is_some_and(is_real) => right.0.expr.ty,
            _ => self.elementary(common(a?, b?)?),
        };
        let left = self.converted(left.0, ty, left.1)?;
        let right = self.converted(right.0, ty, right.1)?;
        Some((left, right, ty, untyped))
    }

    /// Whether a constant without a type can be a value of a type.
    fn takes(&mut self, operand: &Operand, ty: TypeId) -> bool {
        let Some(target) = self.plain(ty) else { return false };
        match operand.constant() {
            Some(Constant::Integer(value)) => {
                is_real(target)
                    || (is_integer(target) || is_bit_string(target))
                        && super::literal::fits(target, *value)
            }
            Some(Constant::Real(_)) => is_real(target),
            _ => false,
        }
    }

    fn mismatch(
        &mut self,
        operator: BinaryOperator,
        place: Span,
        a: TypeId,
        b: TypeId,
        allowed: &str,
    ) {
        let found =
            format!("`{}` of {} and {}", sign(operator), self.type_name(a), self.type_name(b));
        self.tell(Diagnostic::new(Code::TypeMismatch, place, found).allowed(allowed));
    }

    fn arithmetic(
        &mut self,
        operator: BinaryOperator,
        place: Span,
        left: (Operand, Span),
        right: (Operand, Span),
        span: Span,
    ) -> Option<Operand> {
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let (op, allowed) = match operator {
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
            self.mismatch(operator, place, a, b, allowed);
            return None;
        }
        let Some((left, right, ty, untyped)) = self.joined(left, right) else {
            self.mismatch(
                operator,
                place,
                a,
                b,
                "types of which one holds all values of the other",
            );
            return None;
        };
        self.combine(op, left, right, ty, untyped, place, span)
    }

    /// An arithmetic node, or its value if both sides are constants.
    #[allow(clippy::too_many_arguments)]
    fn combine(
        &mut self,
        operator: Arithmetic,
        left: Expr,
        right: Expr,
        ty: TypeId,
        untyped: bool,
        place: Span,
        span: Span,
    ) -> Option<Operand> {
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
                return Some(Operand { expr, untyped });
            }
        }
        let kind = ExprKind::Arithmetic(operator, Box::new(left), Box::new(right));
        Some(Operand::typed(self.expr(ty, kind, span)))
    }

    fn logic(
        &mut self,
        operator: BinaryOperator,
        place: Span,
        left: (Operand, Span),
        right: (Operand, Span),
        span: Span,
    ) -> Option<Operand> {
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let short = matches!(operator, BinaryOperator::AndThen | BinaryOperator::OrElse);
        let bits = |elementary: Option<Elementary>, untyped: bool| {
            elementary.is_some_and(|elementary| is_bit_string(elementary) || untyped)
        };
        let fit = bits(self.plain(a), left.0.untyped) && bits(self.plain(b), right.0.untyped);
        let joined = match fit {
            true => self.joined(left, right),
            false => None,
        };
        let allowed = if short { "BOOL" } else { "BOOL or bit strings (BYTE, WORD, DWORD, LWORD)" };
        let Some((left, right, ty, _)) = joined else {
            self.mismatch(operator, place, a, b, allowed);
            return None;
        };
        let elementary = self.plain(ty)?;
        if !is_bit_string(elementary) || short && elementary != Elementary::Bool {
            self.mismatch(operator, place, a, b, allowed);
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
            _ => self.combine(op, left, right, ty, false, place, span),
        }
    }

    fn power(
        &mut self,
        place: Span,
        left: (Operand, Span),
        right: (Operand, Span),
        span: Span,
    ) -> Option<Operand> {
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let (base, exponent) = (self.plain(a), self.plain(b));
        let number = |elementary: Option<Elementary>| {
            elementary.is_some_and(|elementary| is_integer(elementary) || is_real(elementary))
        };
        if !(number(base) && number(exponent)) {
            self.mismatch(BinaryOperator::Power, place, a, b, "numbers");
            return None;
        }
        // In REAL if the base is one or fits one, in LREAL if either side needs it.
        let real = |elementary: Option<Elementary>, untyped: bool| {
            untyped
                || elementary.is_some_and(|elementary| {
                    elementary == Elementary::Real
                        || super::convert::widens(elementary, Elementary::Real)
                })
        };
        let in_real = real(base, left.0.untyped)
            && !(left.0.untyped && right.0.untyped)
            && exponent != Some(Elementary::Lreal).filter(|_| !right.0.untyped);
        let ty = self.elementary(if in_real { Elementary::Real } else { Elementary::Lreal });
        let as_number = |body: &mut Self, operand: (Operand, Span)| match operand.0.untyped {
            true => body.converted(operand.0, ty, operand.1),
            false if operand.0.expr.ty == ty => Some(operand.0.expr),
            false => Some(body.convert(Conversion::Value, operand.0.expr, ty, operand.1)),
        };
        let left = as_number(self, left)?;
        let right = as_number(self, right)?;
        let kind = ExprKind::Intrinsic(Intrinsic::Power, vec![left, right]);
        Some(Operand::typed(self.expr(ty, kind, span)))
    }

    fn compare(
        &mut self,
        comparison: Comparison,
        operator: BinaryOperator,
        place: Span,
        left: (Operand, Span),
        right: (Operand, Span),
        span: Span,
    ) -> Option<Operand> {
        let (a, b) = (left.0.expr.ty, right.0.expr.ty);
        let equality = matches!(comparison, Comparison::Equal | Comparison::NotEqual);
        let types = &self.checker.program.types;
        let strings = types.is_string(a) || types.is_string(b);
        let reference = |ty| matches!(types.get(ty), Type::Reference { .. });
        let (left, right) = if strings || reference(a) || reference(b) {
            let char_or_text = |operand: &Operand| operand.untyped;
            if reference(a) && !equality {
                self.mismatch(operator, place, a, b, "references only with `=` and `<>`");
                return None;
            }
            let target = if char_or_text(&left.0) { b } else { a };
            if self.both_strings(a, b) {
                (left.0.expr, right.0.expr)
            } else {
                (self.converted(left.0, target, left.1)?, self.converted(right.0, target, right.1)?)
            }
        } else if a == b && self.is_enumeration(a) {
            if !equality {
                self.mismatch(operator, place, a, b, "enumerations only with `=` and `<>`");
                return None;
            }
            (left.0.expr, right.0.expr)
        } else {
            let Some((left, right, _, _)) = self.joined(left, right) else {
                self.mismatch(operator, place, a, b, "two values of one elementary type or string");
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

    /// Arithmetic of durations and dates (IEC 61131-3:2013, table 30). None if neither side is one.
    #[allow(clippy::option_option)]
    fn time_arithmetic(
        &mut self,
        operator: BinaryOperator,
        left: &(Operand, Span),
        right: &(Operand, Span),
        span: Span,
    ) -> Option<Option<Operand>> {
        use BinaryOperator as Op;
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
                    self.combine(Arithmetic::Subtract, left, right, joined, false, span, span)?;
                let expr = self.convert(Conversion::Value, difference.expr, ty, span);
                return Some(Some(Operand::typed(expr)));
            }
            Op::Multiply if is_duration(a) && number(b) => (Arithmetic::Multiply, a),
            Op::Multiply if number(a) && is_duration(b) => (Arithmetic::Multiply, b),
            Op::Divide if is_duration(a) && number(b) => (Arithmetic::Divide, a),
            _ => return None,
        };
        let ty = self.elementary(ty);
        // By a number with a point: in LREAL, then rounded to nanoseconds.
        let scaled = is_real(a) || is_real(b);
        let within = if scaled { self.elementary(Elementary::Lreal) } else { ty };
        let mut part = |operand: &(Operand, Span)| {
            let expr = operand.0.expr.clone();
            match expr.ty == within {
                true => expr,
                false => self.convert(Conversion::Value, expr, within, operand.1),
            }
        };
        let (left, right) = (part(left), part(right));
        let result = self.combine(op, left, right, within, false, span, span);
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

fn comparison(operator: BinaryOperator) -> Option<Comparison> {
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

/// As it is written.
pub(super) fn sign(operator: BinaryOperator) -> &'static str {
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
