//! Functions of any number of arguments that become one operation for each pair.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::operator::Written;
use super::Given;
use super::table::Function;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Elementary, Expr, ExprKind, Intrinsic, TypeId};
use crate::source::Span;
use crate::syntax::ast::{BinaryOperator, Name};

impl<'a> Body<'_, 'a> {
    pub(super) fn chain(
        &mut self,
        operator: BinaryOperator,
        name: &Name,
        given: Vec<Given>,
        span: Span,
        needed: Option<TypeId>,
    ) -> Option<Operand> {
        let written = Written { operator, place: name.span, span, needed };
        let mut rest = given.into_iter();
        let mut result = rest.next()?;
        for next in rest {
            let operand = self.binary_operands(written, result, next)?;
            result = (operand, span);
        }
        Some(result.0)
    }

    /// `GT(a, b, c)` is `a > b AND b > c`.
    pub(super) fn comparisons(
        &mut self,
        operator: BinaryOperator,
        name: &Name,
        given: Vec<Given>,
        span: Span,
    ) -> Option<Operand> {
        let written = Written { operator, place: name.span, span, needed: None };
        let and = Written { operator: BinaryOperator::And, ..written };
        let mut result: Option<Operand> = None;
        for pair in given.windows(2) {
            let [left, right] = pair else { return None };
            let one = self.binary_operands(written, left.clone(), right.clone())?;
            result = Some(match result {
                None => one,
                Some(before) => self.binary_operands(and, (before, span), (one, span))?,
            });
        }
        if given.len() > 2 && given[1..given.len() - 1].iter().any(|(one, _)| has_call(&one.expr)) {
            self.twice(name, span);
            return None;
        }
        result
    }

    pub(super) fn multiplex(
        &mut self,
        mut given: Vec<Given>,
        function: &Function,
        name: &Name,
        hint: Option<TypeId>,
        span: Span,
    ) -> Option<Operand> {
        let (selector, place) = given.remove(0);
        let selector = self.as_length(selector, place)?;
        if given.len() > 2 && has_call(&selector) {
            self.twice(name, span);
            return None;
        }
        if let ExprKind::Constant(Constant::Integer(value)) = selector.kind
            && !(0..given.len() as i128).contains(&value)
        {
            let found = format!("the selector {value} of {} inputs", given.len());
            let one = Diagnostic::new(Code::OutOfRange, place, found);
            self.tell(one.allowed(format!("0..{}", given.len() - 1)));
            return None;
        }
        let ty = self.same(&given, function, hint)?;
        let mut list = self.all_as(given, ty)?.into_iter();
        let mut result = list.next()?;
        let bool_type = self.elementary(Elementary::Bool);
        for (at, next) in list.enumerate() {
            let number = self.integer(selector.ty, at as i128 + 1, place);
            // A selector above the last input selects the last.
            let kind = ExprKind::Compare(
                crate::hir::Comparison::GreaterEqual,
                Box::new(selector.clone()),
                Box::new(number),
            );
            let here = self.expr(bool_type, kind, place);
            let list = vec![here, result, next];
            result = self.intrinsic(Intrinsic::Select, list, ty, span).expr;
        }
        Some(Operand::typed(result))
    }

    fn twice(&mut self, name: &Name, span: Span) {
        let found = format!("a call as an argument of `{}` that is used twice", name.text);
        let one = Diagnostic::new(Code::NotSupported, span, found);
        self.tell(one.hint("assign its result to a variable first"));
    }
}

/// Whether an expression calls anything, which must not happen twice.
fn has_call(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Call(..) => true,
        ExprKind::Constant(_) | ExprKind::Bound { .. } => false,
        ExprKind::Load(place) | ExprKind::Reference(place) => place_has_call(place),
        ExprKind::Unary(_, part) | ExprKind::Convert(_, part) => has_call(part),
        ExprKind::Arithmetic(_, left, right)
        | ExprKind::Compare(_, left, right)
        | ExprKind::AndThen(left, right)
        | ExprKind::OrElse(left, right) => has_call(left) || has_call(right),
        ExprKind::Intrinsic(
            Intrinsic::LogLine | Intrinsic::ChannelRead(_) | Intrinsic::ChannelWrite(_),
            _,
        ) => true,
        ExprKind::Intrinsic(_, list) => list.iter().any(has_call),
    }
}

fn place_has_call(place: &crate::hir::Place) -> bool {
    use crate::hir::{Root, Step};
    let root = matches!(&place.root, Root::Deref(reference) if has_call(reference));
    root || place.path.iter().any(|step| match step {
        Step::Index(index) | Step::Unit(index) => has_call(index),
        Step::OpenIndex(list) => list.iter().any(has_call),
        _ => false,
    })
}
