//! EN and ENO: a call that may not happen, and what tells whether it did.

use super::super::Entry;
use super::super::body::Body;
use super::super::expression::Operand;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Elementary, ExprKind, Statement, StatementKind};
use crate::source::Span;
use crate::syntax::ast::{Argument, Expression, Name};

impl<'a> Body<'_, 'a> {
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
            return None;
        };
        let unit = units[0];
        let mut enable = (None, None);
        let list = self.function_arguments(unit, name, arguments, span, Some(&mut enable))?;
        let (_, ty) = self.checker.units[unit].result?;
        let routine = self.checker.units[unit].routine?;
        let call = Operand::typed(self.expr(ty, ExprKind::Call(routine, list), span));
        let place = self.write_place(target)?;
        let value = self.converted(call, place.ty, span)?;
        let assign = self.statement(StatementKind::Assign(place, value), span);
        self.enabled(vec![assign], enable, span)
    }

    /// Statements that run if EN is TRUE; ENO tells whether they did.
    pub(super) fn enabled(
        &mut self,
        block: Vec<Statement>,
        (en, eno): (Option<&'a Expression>, Option<&'a Expression>),
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
        run.extend(set(self, 1));
        let Some(condition) = condition else { return Some(run) };
        let skip = set(self, 0).into_iter().collect();
        Some(vec![self.statement(StatementKind::If(vec![(condition, run)], skip), span)])
    }
}
