//! LOWER_BOUND and UPPER_BOUND (IEC 61131-3:2013, section 6.5.3).
//!
//! Their result is any integer, as the standard has it: the type that is needed where they stand, or else DINT.

use crate::check::body::Body;
use crate::check::expression::Operand;
use crate::check::types::is_integer;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Conversion, Elementary, Expr, ExprKind, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, Name};

impl<'a> Body<'_, 'a> {
    pub(super) fn bound(
        &mut self,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        let value = |formal: &str, at: usize| {
            let by_name = arguments.iter().find(|argument| {
                argument.name.as_ref().is_some_and(|(name, _)| &*name.key == formal)
            });
            let argument =
                by_name.or_else(|| arguments.get(at).filter(|argument| argument.name.is_none()));
            argument.and_then(|argument| argument.value.as_ref())
        };
        let (Some(array), Some(dimension), 2) = (value("ARR", 0), value("DIM", 1), arguments.len())
        else {
            let found = format!("these arguments of `{}`", name.text);
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            self.tell(one.allowed(format!("{}(ARR := array, DIM := 1)", name.text)));
            return None;
        };
        let place = self.read_place(array)?;
        let number = self.constant_integer(dimension)?;
        let upper = &*name.key == "UPPER_BOUND";
        let long = self.elementary(Elementary::Lint);
        let wrong = |body: &mut Self, allowed: String| {
            let found = format!("the dimension {number}");
            let one = Diagnostic::new(Code::OutOfRange, dimension.span, found);
            body.tell(one.allowed(allowed));
            None
        };
        if let Type::OpenArray { dimensions, .. } = *self.checker.program.types.get(place.ty) {
            if number < 1 || number > i128::from(dimensions) {
                return wrong(self, format!("1..{dimensions}"));
            }
            let kind = ExprKind::Bound { place, dimension: number as u8 - 1, upper };
            let bound = self.expr(long, kind, span);
            return Some(Operand::typed(self.of_needed_type(bound, hint, span)));
        }
        let mut ty = place.ty;
        let mut dimensions = 0;
        while let Type::Array { element, lower, upper: last } = *self.checker.program.types.get(ty)
        {
            dimensions += 1;
            if number == dimensions {
                let bound = if upper { last } else { lower };
                let bound = self.integer(long, bound.into(), span);
                return Some(Operand::typed(self.of_needed_type(bound, hint, span)));
            }
            ty = element;
        }
        if dimensions > 0 {
            return wrong(self, format!("1..{dimensions}"));
        }
        let found = format!("{} for `{}`", self.type_name(place.ty), name.text);
        let one = Diagnostic::new(Code::TypeMismatch, array.span, found);
        self.tell(one.allowed("an array"));
        None
    }

    /// A bound or a length, which is a LINT, in the integer type that is needed; one that does not fit traps.
    pub(super) fn of_needed_type(&mut self, bound: Expr, hint: Option<TypeId>, span: Span) -> Expr {
        let types = &self.checker.program.types;
        let needed = hint
            .and_then(|ty| types.scalar(ty))
            .filter(|ty| is_integer(*ty))
            .unwrap_or(Elementary::Dint);
        let Some((lower, upper)) = needed.range().filter(|_| needed != Elementary::Lint) else {
            return bound;
        };
        let ty = self.elementary(needed);
        let types = &mut self.checker.program.types;
        let fitting =
            types.subrange(needed.name(), Elementary::Lint, lower, upper.min(i64::MAX.into()));
        let checked = self.convert(Conversion::Check, bound, fitting, span);
        self.convert(Conversion::Value, checked, ty, span)
    }
}
