//! Expressions: what type each has, and what the typed tree of it is.

use super::body::Body;
use super::place::Access;
use super::types::is_bit_string;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Expr, ExprKind, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Expression, ExpressionKind, Literal, Name, UnaryOperator};

/// A checked expression.
#[derive(Clone, Debug)]
pub(super) struct Operand {
    pub(super) expr: Expr,
    /// Whether it is a constant of literals without a type, which takes the type that is needed.
    pub(super) untyped: bool,
    /// What a literal with a point is as a REAL.
    pub(super) short: Option<f32>,
}

impl Operand {
    pub(super) fn typed(expr: Expr) -> Self {
        Self { expr, untyped: false, short: None }
    }

    pub(super) fn untyped(expr: Expr) -> Self {
        Self { expr, untyped: true, short: None }
    }

    /// The value of a constant.
    pub(super) fn constant(&self) -> Option<&Constant> {
        match &self.expr.kind {
            ExprKind::Constant(constant) => Some(constant),
            _ => None,
        }
    }
}

impl<'a> Body<'_, 'a> {
    /// An expression as a value of a type, by an implicit conversion if there is one.
    pub(super) fn value_of(&mut self, expression: &'a Expression, ty: TypeId) -> Option<Expr> {
        let around = self.whole.replace(without_parentheses(expression).span);
        let operand = self.operand(expression, Some(ty));
        self.whole = around;
        self.converted(operand?, ty, expression.span)
    }

    /// An expression with the type that it has by itself. `hint` is what is needed where it stands,
    /// for functions whose arguments all have no type.
    pub(super) fn operand(
        &mut self,
        expression: &'a Expression,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        let span = expression.span;
        match &expression.kind {
            ExpressionKind::Literal(literal) => self.literal(literal, span),
            ExpressionKind::Parenthesised(inner) => self.operand(inner, hint),
            ExpressionKind::Unary(operator, inner) => self.unary(*operator, inner, span, hint),
            ExpressionKind::Binary(operator, place, left, right) => {
                self.binary(*operator, *place, left, right, hint)
            }
            ExpressionKind::Call(callee, arguments) => self.call(callee, arguments, span, hint),
            ExpressionKind::EnumerationValue(names) => {
                self.enumeration_value(&names.0, &names.1, span)
            }
            ExpressionKind::Name(name) => match self.constant_name(name, hint)? {
                Some(constant) => Some(constant),
                None => self.load(expression),
            },
            ExpressionKind::Error => None,
            ExpressionKind::Address(_)
            | ExpressionKind::Field(..)
            | ExpressionKind::Part(..)
            | ExpressionKind::Index(..)
            | ExpressionKind::Dereference(_) => self.load(expression),
        }
    }

    fn load(&mut self, expression: &'a Expression) -> Option<Operand> {
        let located = self.read_place(expression)?;
        let ty = located.ty;
        if matches!(self.checker.program.types.get(ty), Type::OpenArray { .. }) {
            let found = "an ARRAY[*] as a value";
            let one = Diagnostic::new(Code::TypeMismatch, expression.span, found);
            self.tell(one.hint("copy its elements one by one"));
            return None;
        }
        Some(Operand::typed(self.expr(ty, ExprKind::Load(located), expression.span)))
    }

    /// The constant that a name stands for, if it is one. The outer `None` after an error.
    #[allow(clippy::option_option)]
    fn constant_name(&mut self, name: &Name, hint: Option<TypeId>) -> Option<Option<Operand>> {
        if let Some(variable) = self.variable(name) {
            self.variables[variable].read = true;
            self.mark_external(name, Access::Read);
            let constant = self.constant_of(variable);
            return Some(constant.map(|(ty, value)| self.constant_operand(ty, value, name.span)));
        }
        if let Some(super::Entry::Global(global)) = self.checker.names.get(&name.key) {
            let global = *global;
            self.checker.resolve_global(global, name.span);
            self.checker.globals[global].read = true;
            let constant = self.checker.globals[global].constant.clone();
            return Some(constant.map(|(ty, value)| self.constant_operand(ty, value, name.span)));
        }
        let known = self.checker.names.contains_key(&name.key);
        let values = match self.checker.enumeration_values.get(&*name.key) {
            Some(values) if !known => values.clone(),
            _ => return Some(None),
        };
        // One that is needed here, else the only one.
        let fitting = values.iter().find(|(ty, _)| Some(*ty) == hint);
        match (fitting, &values[..]) {
            (Some((ty, value)), _) | (None, [(ty, value)]) => {
                Some(Some(Operand::typed(self.integer(*ty, *value, name.span))))
            }
            _ => {
                let types: Vec<String> =
                    values.iter().map(|(ty, _)| self.type_name(*ty)).take(4).collect();
                let found = format!("`{}` is a value of {}", name.text, types.join(" and "));
                let hint = format!("write `{}#{}`", types[0], name.text);
                self.tell(Diagnostic::new(Code::UnknownName, name.span, found).hint(hint));
                None
            }
        }
    }

    fn constant_operand(&mut self, ty: TypeId, value: Constant, span: Span) -> Operand {
        Operand::typed(self.expr(ty, ExprKind::Constant(value), span))
    }

    fn enumeration_value(&mut self, ty: &Name, value: &Name, span: Span) -> Option<Operand> {
        let resolved = self.checker.named_type(ty, false)?;
        let Type::Enumeration { values, .. } = self.checker.program.types.get(resolved.ty) else {
            let found = format!("`{}` is no enumeration", ty.text);
            let one = Diagnostic::new(Code::WrongKind, ty.span, found);
            self.tell(one.allowed("`Enumeration#value`, or `TYPE#literal`"));
            return None;
        };
        let found = values.iter().find(|(name, _)| name.eq_ignore_ascii_case(&value.text));
        if let Some((_, number)) = found {
            let number = *number;
            return Some(Operand::typed(self.integer(resolved.ty, number, span)));
        }
        let all: Vec<&str> = values.iter().map(|(name, _)| &**name).collect();
        let found = format!("`{}` has no value `{}`", ty.text, value.text);
        let mut one = Diagnostic::new(Code::UnknownName, value.span, found);
        if let Some(similar) = super::names::similar(&value.key, all.iter().copied()) {
            one = one.hint(format!("did you mean `{similar}`?"));
        }
        let one = one.allowed(all.into_iter().take(12).collect::<Vec<_>>().join(", "));
        self.tell(one);
        None
    }

    fn unary(
        &mut self,
        operator: UnaryOperator,
        inner: &'a Expression,
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        let mut operand = match &inner.kind {
            // A sign behind the prefix, as in `INT#-32768`, belongs to the literal.
            ExpressionKind::Literal(Literal { prefix: Some(prefix), value })
                if operator == UnaryOperator::Negate && inner.span == span =>
            {
                self.typed_literal(prefix, value, true, span)?
            }
            _ => self.operand(inner, hint)?,
        };
        if let (UnaryOperator::Not, Some(ty)) = (operator, hint)
            && operand.untyped
            && self.plain(ty).is_some_and(is_bit_string)
            && self.takes(&operand, ty)
        {
            operand = Operand::typed(self.converted(operand, ty, inner.span)?);
        }
        self.unary_operator(operator, operand, span)
    }
}

pub(super) fn without_parentheses(expression: &Expression) -> &Expression {
    match &expression.kind {
        ExpressionKind::Parenthesised(inner) => without_parentheses(inner),
        _ => expression,
    }
}
