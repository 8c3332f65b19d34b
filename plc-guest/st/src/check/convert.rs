//! Implicit conversions (IEC 61131-3:2013, figures 11 and 12).
//!
//! A value is converted without being asked for only where nothing of it can be lost. Everything else
//! has a function, such as REAL_TO_INT, so that one reads in the source where precision goes.

use super::body::Body;
use super::expression::Operand;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Conversion, Elementary, Expr, ExprKind, Intrinsic, Type, TypeId};
use crate::source::Span;

/// Whether every value of `from` is one of `to`, by the standard's table.
pub(super) fn widens(from: Elementary, to: Elementary) -> bool {
    use Elementary::*;
    match from {
        Bool => matches!(to, Byte | Word | Dword | Lword),
        Byte => matches!(to, Word | Dword | Lword),
        Word => matches!(to, Dword | Lword),
        Dword => to == Lword,
        Sint => matches!(to, Int | Dint | Lint | Real | Lreal),
        Int => matches!(to, Dint | Lint | Real | Lreal),
        Dint => matches!(to, Lint | Lreal),
        Usint => matches!(to, Uint | Udint | Ulint | Int | Dint | Lint | Real | Lreal),
        Uint => matches!(to, Udint | Ulint | Dint | Lint | Real | Lreal),
        Udint => matches!(to, Ulint | Lint | Lreal),
        Real => to == Lreal,
        Time => to == Ltime,
        Date => to == Ldate,
        Tod => to == Ltod,
        Dt => to == Ldt,
        Lint | Ulint | Lreal | Lword | Ltime | Ldate | Ltod | Ldt | Char | Wchar => false,
    }
}

/// The type that values of both can be computed in.
pub(super) fn common(a: Elementary, b: Elementary) -> Option<Elementary> {
    if a == b || widens(b, a) {
        return Some(a);
    }
    if widens(a, b) {
        return Some(b);
    }
    // Such as INT and UINT: the smallest that holds both.
    [Elementary::Int, Elementary::Dint, Elementary::Lint, Elementary::Real, Elementary::Lreal]
        .into_iter()
        .find(|wide| widens(a, *wide) && widens(b, *wide))
}

impl Body<'_, '_> {
    /// An operand as a value of `ty`. Tells if there is no implicit conversion.
    pub(super) fn converted(&mut self, operand: Operand, ty: TypeId, span: Span) -> Option<Expr> {
        if operand.untyped {
            return self.converted_literal(operand, ty, span);
        }
        let from = operand.expr.ty;
        if from == ty {
            return Some(operand.expr);
        }
        if self.both_strings(from, ty) {
            return self.fitting_string(operand.expr, ty, span);
        }
        let types = &self.checker.program.types;
        let kinds = (types.get(from).clone(), types.get(ty).clone());
        let expr = operand.expr;
        match kinds {
            (Type::Elementary(a), Type::Elementary(b)) if widens(a, b) => {
                Some(self.convert(Conversion::Value, expr, ty, span))
            }
            (Type::Elementary(Elementary::Char), Type::String { .. })
            | (Type::Elementary(Elementary::Wchar), Type::WString { .. }) => {
                let kind = ExprKind::Intrinsic(Intrinsic::FromUnit, vec![expr]);
                Some(self.expr(ty, kind, span))
            }
            (Type::Subrange { base, .. }, Type::Elementary(b)) if base == b || widens(base, b) => {
                Some(self.convert(Conversion::Value, expr, ty, span))
            }
            (Type::Elementary(a), Type::Subrange { base, .. }) if a == base || widens(a, base) => {
                let base = self.elementary(base);
                let expr = if expr.ty == base {
                    expr
                } else {
                    self.convert(Conversion::Value, expr, base, span)
                };
                self.checked(expr, ty, span)
            }
            (Type::Subrange { base: a, .. }, Type::Subrange { base: b, .. })
                if a == b || widens(a, b) =>
            {
                let base = self.elementary(b);
                let expr = self.convert(Conversion::Value, expr, base, span);
                self.checked(expr, ty, span)
            }
            _ => {
                self.no_conversion(from, ty, span);
                None
            }
        }
    }

    /// A value of a subrange's base as one of the subrange.
    fn checked(&mut self, expr: Expr, ty: TypeId, span: Span) -> Option<Expr> {
        if let (ExprKind::Constant(Constant::Integer(value)), Type::Subrange { lower, upper, .. }) =
            (&expr.kind, self.checker.program.types.get(ty))
        {
            let (value, lower, upper) = (*value, *lower, *upper);
            if value < lower || value > upper {
                let found = format!("{value} for {}", self.type_name(ty));
                let one = Diagnostic::new(Code::OutOfRange, span, found);
                self.tell(one.allowed(format!("{lower}..{upper}")));
                return None;
            }
        }
        Some(self.convert(Conversion::Check, expr, ty, span))
    }

    /// A constant without a type takes the type that is needed if it fits.
    fn converted_literal(&mut self, operand: Operand, ty: TypeId, span: Span) -> Option<Expr> {
        let Some(value) = operand.constant().cloned() else { return Some(operand.expr) };
        let from = operand.expr.ty;
        let target = self.checker.program.types.get(ty).clone();
        match (&value, &target) {
            (Constant::Integer(0), Type::Reference { .. }) if self.is_reference(from) => {
                return Some(self.integer(ty, 0, span));
            }
            (Constant::String(_) | Constant::WString(_), _) => {
                return self.converted_text(operand.expr, &value, ty, &target, span);
            }
            _ if self.is_reference(from) => {}
            (Constant::Integer(number), Type::Elementary(elementary)) => {
                let numeric = super::types::is_integer(*elementary)
                    || super::types::is_real(*elementary)
                    || super::types::is_bit_string(*elementary);
                if numeric && let Some(value) = self.fitted(&value, ty) {
                    return Some(self.expr(ty, ExprKind::Constant(value), span));
                }
                if numeric {
                    let (least, most) = elementary.range()?;
                    let found = format!("{number} for {}", elementary.name());
                    let one = Diagnostic::new(Code::OutOfRange, span, found);
                    self.tell(one.allowed(format!("{least}..{most}")));
                    return None;
                }
            }
            (Constant::Real(_), Type::Elementary(elementary))
                if super::types::is_real(*elementary) =>
            {
                let value = match operand.short.filter(|_| *elementary == Elementary::Real) {
                    Some(short) => Constant::Real(f64::from(short)),
                    None => self.fitted(&value, ty)?,
                };
                if value == Constant::Real(f64::INFINITY) || value == Constant::Real(-f64::INFINITY)
                {
                    let found = "a number that is too large for REAL";
                    self.error(Code::OutOfRange, span, found);
                    return None;
                }
                return Some(self.expr(ty, ExprKind::Constant(value), span));
            }
            (Constant::Integer(number), Type::Subrange { base, .. }) => {
                let base = self.elementary(*base);
                let expr = self.integer(base, *number, span);
                let checked = self.checked(expr, ty, span)?;
                // A constant stays one.
                let kind = ExprKind::Constant(Constant::Integer(*number));
                return Some(Expr { kind, ..checked });
            }
            _ => {}
        }
        self.no_conversion(from, ty, span);
        None
    }

    fn is_reference(&self, ty: TypeId) -> bool {
        matches!(self.checker.program.types.get(ty), Type::Reference { .. })
    }

    fn converted_text(
        &mut self,
        expr: Expr,
        value: &Constant,
        ty: TypeId,
        target: &Type,
        span: Span,
    ) -> Option<Expr> {
        let one = match (value, target) {
            (Constant::String(bytes), Type::Elementary(Elementary::Char)) if bytes.len() == 1 => {
                i128::from(bytes[0])
            }
            (Constant::WString(units), Type::Elementary(Elementary::Wchar)) if units.len() == 1 => {
                i128::from(units[0])
            }
            _ if self.both_strings(expr.ty, ty) => return self.fitting_string(expr, ty, span),
            _ => {
                self.no_conversion(expr.ty, ty, span);
                return None;
            }
        };
        Some(self.integer(ty, one, span))
    }

    pub(super) fn both_strings(&self, a: TypeId, b: TypeId) -> bool {
        let types = &self.checker.program.types;
        matches!(
            (types.get(a), types.get(b)),
            (Type::String { .. }, Type::String { .. })
                | (Type::WString { .. }, Type::WString { .. })
        )
    }

    /// Strings of different lengths fit each other, and are cut when they are assigned; a constant that
    /// would be cut is a mistake.
    fn fitting_string(&mut self, expr: Expr, ty: TypeId, span: Span) -> Option<Expr> {
        self.used_as_string(&expr, span)?;
        let length = match &expr.kind {
            ExprKind::Constant(Constant::String(bytes)) => bytes.len(),
            ExprKind::Constant(Constant::WString(units)) => units.len(),
            _ => return Some(expr),
        };
        let (Type::String { capacity } | Type::WString { capacity }) =
            self.checker.program.types.get(ty)
        else {
            return Some(expr);
        };
        let capacity = *capacity;
        if length > usize::from(capacity) {
            let found = format!("a string of {length} characters for {}", self.type_name(ty));
            let one = Diagnostic::new(Code::OutOfRange, span, found);
            self.tell(one.allowed(format!("at most {capacity} characters")));
            return None;
        }
        Some(Expr { ty, ..expr })
    }

    /// A conversion node, or the converted constant.
    pub(super) fn convert(
        &mut self,
        conversion: Conversion,
        expr: Expr,
        ty: TypeId,
        span: Span,
    ) -> Expr {
        let folded = match &expr.kind {
            ExprKind::Constant(value) => self.fold_conversion(conversion, value, expr.ty, ty),
            _ => None,
        };
        match folded {
            Some(value) => self.expr(ty, ExprKind::Constant(value), span),
            None => self.expr(ty, ExprKind::Convert(conversion, Box::new(expr)), span),
        }
    }

    /// Tells that there is no implicit conversion, and what to write instead.
    pub(super) fn no_conversion(&mut self, from: TypeId, to: TypeId, span: Span) {
        let found = format!("{} where {} is needed", self.type_name(from), self.type_name(to));
        let types = &self.checker.program.types;
        let elementary = |ty: TypeId| match types.get(ty) {
            Type::Elementary(elementary) => Some(*elementary),
            Type::Subrange { base, .. } => Some(*base),
            _ => None,
        };
        let (a, b) = (elementary(from), elementary(to));
        let number = |elementary: Elementary| {
            super::types::is_integer(elementary) || super::types::is_real(elementary)
        };
        let loses = matches!((a, b), (Some(a), Some(b)) if number(a) && number(b));
        let code = if loses { Code::LosesValue } else { Code::TypeMismatch };
        let mut one = Diagnostic::new(code, span, found);
        match (a, b) {
            (Some(a), Some(Elementary::Bool)) if number(a) => {
                one = one.hint("compare it, such as `<> 0`");
            }
            (Some(a), Some(b)) if number(a) && super::types::is_duration(b) => {
                one = one.hint("a duration has a unit: `T#500ms`");
            }
            (Some(a), Some(b)) if a != b => {
                one = one.hint(format!("convert it: `{}_TO_{}(...)`", a.name(), b.name()));
            }
            _ => {}
        }
        let text = self.checker.sources.text(span);
        match (types.get(from), types.get(to)) {
            (Type::WString { .. }, Type::String { .. } | Type::Elementary(Elementary::Char))
                if text.starts_with('"') =>
            {
                one = one.hint("a STRING stands between single quotation marks: `'...'`");
            }
            (Type::String { .. }, Type::WString { .. } | Type::Elementary(Elementary::Wchar))
                if text.starts_with('\'') =>
            {
                one = one.hint("a WSTRING stands between double quotation marks: `\"...\"`");
            }
            _ => {}
        }
        match () {
            () if matches!(types.get(from), Type::Reference { target } if *target == to) => {
                one = one.hint("write `^` behind the reference");
            }
            () if matches!(types.get(to), Type::Reference { target } if *target == from) => {
                one = one.hint("write `REF(...)`");
            }
            () => {}
        }
        if loses {
            one = one.allowed("a type that loses nothing of the value");
        }
        self.tell(one);
    }
}
