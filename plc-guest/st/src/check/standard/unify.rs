//! The type that all arguments of a group are brought to.

use std::ops::RangeInclusive;

use super::super::body::Body;
use super::super::convert::common;
use super::super::expression::Operand;
use super::super::types::{is_bit_string, is_character, is_integer, is_real};
use super::Given;
use super::table::{Function, Group, Parameter};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, Conversion, Elementary, Expr, ExprKind, Intrinsic, TypeId};
use crate::source::Span;

impl<'a> Body<'_, 'a> {
    /// The type that all arguments of a group are brought to.
    pub(super) fn same(
        &mut self,
        given: &[Given],
        function: &Function,
        hint: Option<TypeId>,
    ) -> Option<TypeId> {
        let real = function.parameters.contains(&Parameter::Same(Group::Real));
        let group = || given.iter().filter(|(operand, _)| !operand.untyped);
        let first = group().next().map(|(operand, _)| operand.expr.ty);
        let Some(mut ty) = first else {
            // Numbers alone: what is needed, if they fit.
            let (operand, _) = given.first()?;
            let any = function.takes_any();
            let hinted = hint.filter(|hint| {
                let fits = self.plain(*hint).is_some_and(|hint| {
                    is_real(hint)
                        || !real && is_integer(hint)
                        || any && (is_bit_string(hint) || is_character(hint))
                });
                fits && given.iter().all(|(operand, _)| self.takes(operand, *hint))
            });
            if hinted.is_none() && self.checker.program.types.is_string(operand.expr.ty) {
                // Text alone: the longest. One of another kind is told where it is converted.
                let all = given.iter().map(|(operand, _)| operand.expr.ty);
                let strings = all.filter(|ty| self.both_strings(*ty, operand.expr.ty));
                return strings.reduce(|a, b| self.longer(a, b));
            }
            let long = self.elementary(Elementary::Lreal);
            let reals = given.iter().any(|(operand, _)| operand.expr.ty == long);
            let own = if real || reals { Some(long) } else { self.widest(given) };
            let common = hinted.or(own);
            if common.is_none() {
                let (operand, span) = given.last()?;
                let found = format!("{} among these values", self.type_name(operand.expr.ty));
                self.tell(
                    Diagnostic::new(Code::TypeMismatch, *span, found).allowed("values of one type"),
                );
            }
            return common;
        };
        for (operand, span) in given {
            let next = operand.expr.ty;
            if self.both_strings(ty, next) {
                ty = self.longer(ty, next);
                continue;
            }
            if next == ty || operand.untyped && self.takes(operand, ty) {
                continue;
            }
            if let Some(real) = hint.filter(|hint| self.real_with(operand, ty, Some(*hint))) {
                ty = real;
                continue;
            }
            let joined = match (self.plain(ty), self.plain(next)) {
                (Some(a), Some(b)) => common(a, b),
                _ => None,
            };
            let Some(joined) = joined else {
                self.no_conversion(next, ty, *span);
                return None;
            };
            ty = self.elementary(joined);
        }
        Some(ty)
    }

    fn widest(&mut self, given: &[Given]) -> Option<TypeId> {
        let mut widest = self.plain(given.first()?.0.expr.ty);
        for (operand, _) in given {
            widest = common(widest?, self.plain(operand.expr.ty)?);
        }
        Some(self.elementary(widest?))
    }

    fn longer(&self, a: TypeId, b: TypeId) -> TypeId {
        let types = &self.checker.program.types;
        if types.size(a) >= types.size(b) { a } else { b }
    }

    pub(super) fn all_as(&mut self, given: Vec<Given>, ty: TypeId) -> Option<Vec<Expr>> {
        given
            .into_iter()
            .map(|(operand, span)| {
                if self.both_strings(operand.expr.ty, ty) {
                    self.used_as_string(&operand.expr, span)?;
                    return Some(operand.expr);
                }
                self.converted(operand, ty, span)
            })
            .collect()
    }

    pub(super) fn as_long(&mut self, operand: Operand, span: Span) -> Option<Expr> {
        let long = self.elementary(Elementary::Lint);
        if operand.untyped || operand.expr.ty == long {
            return self.converted(operand, long, span);
        }
        Some(self.convert(Conversion::Value, operand.expr, long, span))
    }

    /// The same of a length or a count. One of ULINT that LINT does not have is still a large one, not below zero.
    pub(super) fn as_length(&mut self, operand: Operand, span: Span) -> Option<Expr> {
        let (ty, most) = (operand.expr.ty, i128::from(i64::MAX));
        let fits = match operand.expr.kind {
            ExprKind::Constant(Constant::Integer(value)) => value <= most,
            _ => self.plain(ty) != Some(Elementary::Ulint),
        };
        if operand.untyped || fits {
            return self.as_long(operand, span);
        }
        let most = self.integer(ty, most, span);
        let fitting = self.intrinsic(Intrinsic::Min, vec![operand.expr, most], ty, span);
        self.as_long(fitting, span)
    }

    /// The integer type that is needed, and whether it has all these values; else DINT. What is computed with takes
    /// no type that lacks some of them: the result might fit, and would be wrong.
    pub(super) fn integer_result(
        &mut self,
        hint: Option<TypeId>,
        values: RangeInclusive<i128>,
        span: Span,
    ) -> (TypeId, bool) {
        let whole = self.whole == Some(span);
        let hinted =
            hint.and_then(|hint| Some((hint, self.plain(hint).filter(|ty| is_integer(*ty))?)));
        let hinted = hinted.and_then(|(hint, ty)| {
            let (least, most) = ty.range()?;
            Some((hint, least <= *values.start() && *values.end() <= most))
        });
        match hinted {
            Some((hint, fits)) if whole || fits => (hint, fits),
            _ => (self.elementary(Elementary::Dint), true),
        }
    }
}
