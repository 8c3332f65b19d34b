//! EN and ENO: a call that may not happen, and what tells whether it did.

use super::super::Entry;
use super::super::body::{Around, Body};
use super::super::expression::Operand;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Elementary, ExprKind, Statement, StatementKind};
use crate::source::Span;
use crate::syntax::ast::{Argument, Binding, Expression, Name, UnitKind};

/// EN and ENO of a call, and its other arguments.
type Split<'a> = (Enable<'a>, Vec<&'a Argument>);

/// EN and ENO of a call.
#[derive(Clone, Copy, Default)]
pub(super) struct Enable<'a> {
    pub(super) en: Option<&'a Expression>,
    pub(super) eno: Option<&'a Expression>,
    /// Whether the body has declared ENO, and so assigns it itself when it runs.
    pub(super) by_body: bool,
}

impl Enable<'_> {
    /// Whether the call needs more than its arguments.
    pub(super) fn is_used(&self) -> bool {
        self.en.is_some() || self.eno.is_some() && !self.by_body
    }
}

impl<'a> Body<'_, 'a> {
    /// EN and ENO of a call of one of several functions, none of which declares them; and the other arguments.
    fn split(&mut self, arguments: &'a [Argument], span: Span) -> Option<Split<'a>> {
        self.are_formal(&[], arguments, span)?;
        let mut enable = Enable::default();
        let mut others = Vec::new();
        for argument in arguments {
            let given = match &argument.name {
                Some((name, Binding::Input)) if &*name.key == "EN" => Some((name, &mut enable.en)),
                Some((name, Binding::Output)) if &*name.key == "ENO" => {
                    Some((name, &mut enable.eno))
                }
                _ => None,
            };
            match (given, &argument.value) {
                (None, _) => others.push(argument),
                (Some((name, given)), Some(value)) => {
                    if given.replace(value).is_some() {
                        self.twice(name, argument.span);
                        return None;
                    }
                }
                // `ENO =>` leaves it unconnected.
                (Some(_), None) => {}
            }
        }
        Some((enable, others))
    }

    /// `target := f(EN := a, ...)`: a call with EN or ENO, which can be a whole value only.
    pub(in crate::check) fn enabled_assignment(
        &mut self,
        target: &'a Expression,
        name: &'a Name,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Vec<Statement>> {
        let Some(Entry::Units(units)) = self.checker.names.get(&name.key).cloned() else {
            let found = format!("EN or ENO in a call of `{}`", name.text);
            let one = Diagnostic::new(Code::NotSupported, span, found);
            self.tell(one.allowed("EN and ENO of declared functions and function blocks"));
            self.arguments_apart(arguments);
            return None;
        };
        if self.checker.units[units[0]].ast.kind != UnitKind::Function {
            self.not_callable(name, &Entry::Units(units));
            self.arguments_apart(arguments);
            return None;
        }
        let mut enable = Enable::default();
        self.around = Some(Around::default());
        let called = match units[..] {
            [unit] => self
                .function_arguments(unit, name, arguments, span, Some(&mut enable))
                .map(|list| (unit, list)),
            _ => self.split(arguments, span).and_then(|(found, others)| {
                enable = found;
                self.overloaded(&units, name, others, span)
            }),
        };
        let Around { before: mut run, behind } = self.around.take().unwrap_or_default();
        let place = self.write_place(target);
        let ((unit, list), place) = (called?, place?);
        let ty = self.result_type(unit, name, span)?;
        let routine = self.checker.units[unit].routine?;
        let call = Operand::typed(self.expr(ty, ExprKind::Call(routine, list), span));
        let value = self.converted(call, place.ty, span)?;
        run.extend(self.called_assignment(place, value, behind, span));
        self.enabled(run, enable, span)
    }

    /// Statements that run if EN is TRUE; ENO tells whether they did.
    pub(super) fn enabled(
        &mut self,
        block: Vec<Statement>,
        Enable { en, eno, by_body }: Enable<'a>,
        span: Span,
    ) -> Option<Vec<Statement>> {
        let bool_type = self.elementary(Elementary::Bool);
        let condition = match en {
            Some(en) => Some(self.value_of(en, bool_type)?),
            None => None,
        };
        let eno = match eno {
            Some(eno) => {
                let place = self.write_place(eno)?;
                if place.ty != bool_type {
                    self.no_conversion(bool_type, place.ty, eno.span);
                    return None;
                }
                Some(place)
            }
            None => None,
        };
        let set = |body: &Self, value: i128| {
            eno.clone().map(|place| {
                let value = body.integer(bool_type, value, span);
                body.statement(StatementKind::Assign(place, value), span)
            })
        };
        let mut run = block;
        if !by_body {
            run.extend(set(self, 1));
        }
        let Some(condition) = condition else { return Some(run) };
        let skip = set(self, 0).into_iter().collect();
        Some(vec![self.statement(StatementKind::If(vec![(condition, run)], skip), span)])
    }
}
