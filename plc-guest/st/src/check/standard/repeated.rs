//! Functions of any number of arguments that become one operation for each pair.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::operator::Written;
use super::Given;
use super::table::Function;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Elementary, Expr, ExprKind, Intrinsic, Place, Root, Step, TypeId};
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
        // All but the first and the last are in two comparisons.
        for (one, place) in given.iter().take(given.len() - 1).skip(1) {
            self.refuse_copies(&one.expr, name, *place)?;
        }
        let mut rest = given.into_iter();
        let (mut left, mut result) = (rest.next()?, None);
        while let Some(right) = rest.next() {
            let next = if rest.len() > 0 { Some(right.clone()) } else { None };
            let one = self.binary_operands(written, left, right)?;
            result = Some(match result {
                None => one,
                Some(before) => self.binary_operands(and, (before, span), (one, span))?,
            });
            let Some(next) = next else { break };
            left = next;
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
        if given.len() > 2 {
            self.refuse_copies(&selector, name, place)?;
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

    /// Refuses what cannot be an argument that is used more than once: a call would happen more than once, and copies
    /// of a large one within another would be more than any memory holds.
    fn refuse_copies(&mut self, argument: &Expr, name: &Name, span: Span) -> Option<()> {
        let what = if has_call(argument) {
            "a call"
        } else if parts(argument, COPIED) >= COPIED {
            "a long expression"
        } else {
            return Some(());
        };
        let found = format!("{what} as an argument of `{}` that is used twice", name.text);
        let one = Diagnostic::new(Code::NotSupported, span, found);
        self.tell(one.hint("assign its result to a variable first"));
        None
    }
}

/// How many parts an expression that is copied can have.
const COPIED: usize = 100;

/// How many parts an expression has, counted up to a bound.
fn parts(expr: &Expr, bound: usize) -> usize {
    let mut count = 0;
    let mut waiting = vec![expr];
    while let Some(expr) = waiting.pop() {
        count += 1;
        if count >= bound {
            break;
        }
        match &expr.kind {
            ExprKind::Constant(_) => {}
            ExprKind::Load(place) | ExprKind::Reference(place) | ExprKind::Bound { place, .. } => {
                waiting.extend(parts_of_place(place));
            }
            ExprKind::Unary(_, part) | ExprKind::Convert(_, part) => waiting.push(part),
            ExprKind::Arithmetic(_, left, right)
            | ExprKind::Compare(_, left, right)
            | ExprKind::AndThen(left, right)
            | ExprKind::OrElse(left, right) => waiting.extend([&**left, &**right]),
            ExprKind::Intrinsic(_, list) => waiting.extend(list),
            // It is refused anyway.
            ExprKind::Call(..) => {}
        }
    }
    count
}

fn parts_of_place(place: &Place) -> Vec<&Expr> {
    let mut parts: Vec<&Expr> = Vec::new();
    if let Root::Deref(reference) = &place.root {
        parts.push(reference);
    }
    for step in &place.path {
        match step {
            Step::Index(index) | Step::Unit(index) => parts.push(index),
            Step::OpenIndex(list) => parts.extend(list),
            Step::Field(_) | Step::Bit(_) | Step::Part { .. } => {}
        }
    }
    parts
}

/// Whether an expression calls anything, which must not happen twice.
fn has_call(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Call(..) => true,
        ExprKind::Constant(_) => false,
        ExprKind::Load(place) | ExprKind::Reference(place) | ExprKind::Bound { place, .. } => {
            parts_of_place(place).into_iter().any(has_call)
        }
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
