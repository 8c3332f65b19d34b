//! LOWER_BOUND and UPPER_BOUND (IEC 61131-3:2013, table 36).

use crate::check::body::Body;
use crate::check::expression::Operand;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Elementary, ExprKind, Type};
use crate::source::Span;
use crate::syntax::ast::{Argument, Name};

impl<'a> Body<'_, 'a> {
    pub(super) fn bound(
        &mut self,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
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
            return Some(Operand::typed(self.expr(long, kind, span)));
        }
        let mut ty = place.ty;
        let mut dimensions = 0;
        while let Type::Array { element, lower, upper: last } = *self.checker.program.types.get(ty)
        {
            dimensions += 1;
            if number == dimensions {
                let bound = if upper { last } else { lower };
                return Some(Operand::typed(self.integer(long, bound.into(), span)));
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
}
