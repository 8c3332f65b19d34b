//! Literals and their types.
//!
//! A number without a type takes the type that is needed where it stands, if its value fits; until
//! then it has the smallest of INT, DINT, LINT and ULINT, or LREAL.

use super::body::Body;
use super::expression::Operand;
use super::names::elementary;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Class, Constant, Elementary, Expr, ExprKind, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Literal, LiteralValue};

impl Body<'_, '_> {
    pub(super) fn literal(&mut self, literal: &Literal, span: Span) -> Option<Operand> {
        if let Some(prefix) = &literal.prefix {
            return self.typed_literal(prefix, &literal.value, false, span);
        }
        let (elementary, constant) = match &literal.value {
            LiteralValue::Bool(value) => (Elementary::Bool, Constant::Integer((*value).into())),
            LiteralValue::Integer(value) => {
                return Some(self.number((*value).into(), span));
            }
            LiteralValue::Real { long, short } => {
                let ty = self.elementary(Elementary::Lreal);
                let kind = ExprKind::Constant(Constant::Real(*long));
                let operand = Operand::untyped(self.expr(ty, kind, span));
                return Some(Operand { short: Some(*short), ..operand });
            }
            LiteralValue::Duration { nanoseconds, long } => (
                if *long { Elementary::Ltime } else { Elementary::Time },
                Constant::Integer((*nanoseconds).into()),
            ),
            LiteralValue::Date { nanoseconds, long } => (
                if *long { Elementary::Ldate } else { Elementary::Date },
                Constant::Integer((*nanoseconds).into()),
            ),
            LiteralValue::TimeOfDay { nanoseconds, long } => (
                if *long { Elementary::Ltod } else { Elementary::Tod },
                Constant::Integer((*nanoseconds).into()),
            ),
            LiteralValue::DateAndTime { nanoseconds, long } => (
                if *long { Elementary::Ldt } else { Elementary::Dt },
                Constant::Integer((*nanoseconds).into()),
            ),
            LiteralValue::String(bytes) => return self.text(bytes.clone(), span),
            LiteralValue::WideString(units) => return self.wide_text(units.clone(), span),
            LiteralValue::Null => {
                let bytes = self.elementary(Elementary::Byte);
                let ty = self.checker.program.types.reference(bytes);
                return Some(Operand::untyped(self.integer(ty, 0, span)));
            }
        };
        let ty = self.elementary(elementary);
        Some(Operand::typed(self.expr(ty, ExprKind::Constant(constant), span)))
    }

    /// A number without a type.
    pub(super) fn number(&mut self, value: i128, span: Span) -> Operand {
        let fitting = [Elementary::Int, Elementary::Dint, Elementary::Lint, Elementary::Ulint]
            .into_iter()
            .find(|elementary| fits(*elementary, value));
        let ty = self.elementary(fitting.unwrap_or(Elementary::Ulint));
        Operand::untyped(self.integer(ty, value, span))
    }

    fn text(&mut self, bytes: Vec<u8>, span: Span) -> Option<Operand> {
        self.without_zero(bytes.len() > 1 && bytes.contains(&0), span)?;
        let Ok(length) = u16::try_from(bytes.len()) else {
            self.too_long(bytes.len(), span);
            return None;
        };
        let ty = self.checker.program.types.string(length.max(1));
        let kind = ExprKind::Constant(Constant::String(bytes));
        Some(Operand::untyped(self.expr(ty, kind, span)))
    }

    fn wide_text(&mut self, units: Vec<u16>, span: Span) -> Option<Operand> {
        self.without_zero(units.len() > 1 && units.contains(&0), span)?;
        let Ok(length) = u16::try_from(units.len()) else {
            self.too_long(units.len(), span);
            return None;
        };
        let ty = self.checker.program.types.wstring(length.max(1));
        let kind = ExprKind::Constant(Constant::WString(units));
        Some(Operand::untyped(self.expr(ty, kind, span)))
    }

    /// Refuses a constant with the character 0 where it is a string: alone it may have been one of CHAR.
    pub(super) fn used_as_string(&mut self, expr: &Expr, span: Span) -> Option<()> {
        let has_zero = match &expr.kind {
            ExprKind::Constant(Constant::String(bytes)) => bytes.contains(&0),
            ExprKind::Constant(Constant::WString(units)) => units.contains(&0),
            _ => false,
        };
        self.without_zero(has_zero, span)
    }

    /// Character 0 ends a text in memory: what stands behind it would be lost.
    fn without_zero(&mut self, has_zero: bool, span: Span) -> Option<()> {
        if has_zero {
            let one = Diagnostic::new(Code::InvalidLiteral, span, "character 0 in a string");
            self.tell(one.allowed("characters from `$01` on; `CHAR#'$00'` and `WCHAR#\"$0000\"`"));
            return None;
        }
        Some(())
    }

    fn too_long(&mut self, length: usize, span: Span) {
        let found = format!("a string of {length} characters");
        let one = Diagnostic::new(Code::OutOfRange, span, found);
        self.tell(one.allowed("at most 65535 characters"));
    }

    /// `INT#5`, `REAL#1`, `BOOL#1`, `STRING#'a'`, `CHAR#'a'`. `negative` if a minus stands behind the prefix, which is
    /// not yet a part of the value.
    pub(super) fn typed_literal(
        &mut self,
        prefix: &str,
        value: &LiteralValue,
        negative: bool,
        span: Span,
    ) -> Option<Operand> {
        let wrong = |body: &mut Self, allowed: &str| {
            let found = format!("`{}`", body.checker.sources.text(span));
            let one = Diagnostic::new(Code::InvalidLiteral, span, found);
            body.tell(one.allowed(allowed));
            None
        };
        match (prefix, value) {
            ("STRING", LiteralValue::String(bytes)) => return self.text(bytes.clone(), span),
            ("WSTRING", LiteralValue::WideString(units)) => {
                return self.wide_text(units.clone(), span);
            }
            _ => {}
        }
        let Some(elementary) = elementary(prefix) else {
            let found = format!("there is no elementary type `{prefix}`");
            self.error(Code::UnknownName, span, found);
            return None;
        };
        let ty = self.elementary(elementary);
        let constant = match (elementary, value) {
            (Elementary::Char, LiteralValue::String(bytes)) if bytes.len() == 1 => {
                Constant::Integer(bytes[0].into())
            }
            (Elementary::Wchar, LiteralValue::WideString(units)) if units.len() == 1 => {
                Constant::Integer(units[0].into())
            }
            (Elementary::Bool, LiteralValue::Bool(value)) => Constant::Integer((*value).into()),
            (Elementary::Real, LiteralValue::Real { short, .. }) => {
                Constant::Real(f64::from(*short))
            }
            (Elementary::Lreal, LiteralValue::Real { long, .. }) => Constant::Real(*long),
            (Elementary::Real | Elementary::Lreal, LiteralValue::Integer(value)) => {
                real_of(elementary, i128::from(*value))
            }
            (Elementary::Char | Elementary::Wchar, _) => {
                return wrong(self, "one character: `CHAR#'a'`, `WCHAR#\"a\"`");
            }
            (_, LiteralValue::Integer(value)) if !has_unit(elementary) => {
                let value = i128::from(*value);
                let (least, most) = elementary.range()?;
                let bound = if negative && least < 0 { -least } else { most };
                if value > bound {
                    let sign = if negative { "-" } else { "" };
                    let found = format!("{sign}{value} is no {}", elementary.name());
                    let allowed = format!("{least}..{most}");
                    let mut one = Diagnostic::new(Code::OutOfRange, span, found).allowed(allowed);
                    if value == -least {
                        one = one
                            .hint(format!("the sign stands behind the type: `{prefix}#-{value}`"));
                    }
                    self.tell(one);
                    return None;
                }
                Constant::Integer(value)
            }
            _ => {
                return wrong(self, &format!("a literal of the type {}", elementary.name()));
            }
        };
        if let Constant::Real(number) = constant
            && number.is_infinite()
        {
            self.error(Code::OutOfRange, span, "a number that is too large for REAL");
            return None;
        }
        Some(Operand::typed(self.expr(ty, ExprKind::Constant(constant), span)))
    }

    /// A constant number as a value of a type, if it fits.
    pub(super) fn fitted(&mut self, value: &Constant, ty: TypeId) -> Option<Constant> {
        let scalar = self.scalar(ty)?;
        match (value, scalar.class()) {
            (Constant::Integer(value), Class::Float) => Some(real_of(scalar, *value)),
            (Constant::Real(value), Class::Float) => Some(real(scalar, *value)),
            (Constant::Integer(value), _) if fits(scalar, *value) => {
                Some(Constant::Integer(*value))
            }
            _ => None,
        }
    }
}

/// A value of REAL is rounded when it is made.
pub(super) fn real(elementary: Elementary, value: f64) -> Constant {
    match elementary {
        Elementary::Real => Constant::Real(f64::from(value as f32)),
        _ => Constant::Real(value),
    }
}

/// An integer as a value of REAL or LREAL. It is rounded once, not to an LREAL before.
pub(super) fn real_of(elementary: Elementary, value: i128) -> Constant {
    match elementary {
        Elementary::Real => Constant::Real(f64::from(value as f32)),
        _ => Constant::Real(value as f64),
    }
}

pub(super) fn fits(elementary: Elementary, value: i128) -> bool {
    elementary.range().is_some_and(|(least, most)| (least..=most).contains(&value))
}

/// Whether the literals of a type have a form of their own.
fn has_unit(elementary: Elementary) -> bool {
    super::types::is_duration(elementary) || super::types::is_date(elementary)
}
