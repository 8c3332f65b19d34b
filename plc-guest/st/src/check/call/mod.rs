//! Calls of functions and function blocks: what is called, as a value or as a statement.
//!
//! Which argument is for which parameter is in `bind`, what the arguments of a function become in `function`, those of
//! an instance in `block`; `overload` picks one of several functions of a library, `enable` has EN and ENO.

mod bind;
mod block;
mod enable;
mod function;
mod overload;

use enable::Enable;

use super::body::{Around, Body};
use super::expression::Operand;
use super::standard::is_channel;
use super::{Entry, test};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{ExprKind, Statement, StatementKind, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, Expression, ExpressionKind, Name, UnitKind};

impl<'a> Body<'_, 'a> {
    /// A call as a value.
    pub(in crate::check) fn call(
        &mut self,
        callee: &'a Expression,
        arguments: &'a [Argument],
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        let ExpressionKind::Name(name) = &callee.kind else {
            self.instance_as_value(callee);
            self.arguments_apart(arguments);
            return None;
        };
        if self.variable(name).is_some()
            || matches!(self.checker.names.get(&name.key), Some(Entry::Global(_)))
        {
            self.instance_as_value(callee);
            self.arguments_apart(arguments);
            return None;
        }
        let units = match self.checker.names.get(&name.key).cloned() {
            Some(Entry::Units(units)) => units,
            Some(entry) => {
                self.not_callable(name, &entry);
                self.arguments_apart(arguments);
                return None;
            }
            None => {
                self.around = None;
                return self.standard_call(name, arguments, span, hint);
            }
        };
        if self.checker.units[units[0]].ast.kind != UnitKind::Function {
            self.not_callable(name, &Entry::Units(units));
            self.arguments_apart(arguments);
            return None;
        }
        let (unit, list) = match units[..] {
            [unit] => (unit, self.function_arguments(unit, name, arguments, span, None)?),
            _ => {
                self.are_formal(&[], arguments, span)?;
                self.overloaded(&units, name, arguments, span)?
            }
        };
        let ty = self.result_type(unit, name, span)?;
        let routine = self.checker.units[unit].routine?;
        Some(Operand::typed(self.expr(ty, ExprKind::Call(routine, list), span)))
    }

    /// The type of a function's result.
    fn result_type(&mut self, unit: usize, name: &Name, span: Span) -> Option<TypeId> {
        let Some((_, ty)) = self.checker.units[unit].result else {
            let found = format!("`{}` has no result", name.text);
            self.tell(Diagnostic::new(Code::WrongKind, span, found).hint("call it as a statement"));
            return None;
        };
        Some(ty)
    }

    fn instance_as_value(&mut self, callee: &Expression) {
        let found = format!("a call of `{}` as a value", self.checker.sources.text(callee.span));
        self.tell(
            Diagnostic::new(Code::WrongKind, callee.span, found)
                .allowed("calls of functions")
                .hint("an instance of a function block is called as a statement; then read its outputs"),
        );
    }

    pub(in crate::check) fn not_callable(&mut self, name: &Name, entry: &Entry) {
        let (what, hint) = match entry {
            Entry::Type(_) => ("a type", "a conversion is called such as `INT_TO_REAL(...)`"),
            Entry::Global(_) => ("a variable", "only instances of function blocks can be called"),
            Entry::Units(units) => match self.checker.units[units[0]].ast.kind {
                UnitKind::FunctionBlock => (
                    "a function block and no instance",
                    "declare an instance of it in VAR and call that",
                ),
                UnitKind::Program | UnitKind::Test => {
                    ("a program", "give it a task in a CONFIGURATION")
                }
                UnitKind::Function => ("a function", ""),
            },
        };
        let found = format!("`{}` is {what}", name.text);
        self.tell(Diagnostic::new(Code::WrongKind, name.span, found).hint(hint));
    }

    /// A call as a statement.
    pub(in crate::check) fn call_statement(
        &mut self,
        expression: &'a Expression,
    ) -> Option<Vec<Statement>> {
        let ExpressionKind::Call(callee, arguments) = &expression.kind else { return None };
        let span = expression.span;
        if let ExpressionKind::Name(name) = &callee.kind
            && self.variable(name).is_none()
            && !matches!(self.checker.names.get(&name.key), Some(Entry::Global(_)))
        {
            return self.function_statement(name, expression, arguments, span);
        }
        // Calling it is using it in both ways.
        let Some(place) = self.write_place(callee).and_then(|_| self.read_place(callee)) else {
            self.arguments_apart(arguments);
            return None;
        };
        let ty = place.ty;
        let unit = self.block_of(ty);
        let Some(unit) = unit else {
            let found = format!("a call of {}", self.type_name(ty));
            let one = Diagnostic::new(Code::WrongKind, callee.span, found);
            self.tell(one.allowed("an instance of a function block"));
            self.arguments_apart(arguments);
            return None;
        };
        self.invoke(place, unit, arguments, span)
    }

    /// The unit whose instances are of a type.
    pub(in crate::check) fn block_of(&self, ty: TypeId) -> Option<usize> {
        self.checker.blocks.get(&ty).copied()
    }

    fn function_statement(
        &mut self,
        name: &'a Name,
        expression: &'a Expression,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Vec<Statement>> {
        let declared = self.checker.names.contains_key(&name.key);
        if !declared && self.in_test() && test::form(&name.key).is_some() {
            return self.test_statement(name, arguments, span);
        }
        if !declared && (&*name.key == "LOG_LINE" || is_channel(&name.key)) {
            let call = self.operand(expression, None)?;
            return Some(vec![self.evaluated(call.expr.kind, span)]);
        }
        let unit = match self.checker.names.get(&name.key) {
            Some(Entry::Units(units)) if units.len() == 1 => Some(units[0]),
            _ => None,
        };
        let function = unit.filter(|unit| self.checker.units[*unit].ast.kind == UnitKind::Function);
        let Some(unit) = function else {
            // It may not be callable at all, which is told there.
            self.operand(expression, None)?;
            let found = format!("the result of `{}` is not used", name.text);
            self.error(Code::NoEffect, span, found);
            return Some(Vec::new());
        };
        let mut enable = Enable::default();
        self.around = Some(Around::default());
        let list = self.function_arguments(unit, name, arguments, span, Some(&mut enable));
        let Around { before: mut run, behind } = self.around.take().unwrap_or_default();
        let (list, routine) = (list?, self.checker.units[unit].routine?);
        run.push(self.statement(StatementKind::Call(routine, list), span));
        run.extend(behind);
        self.enabled(run, enable, span)
    }

    fn missing(&mut self, parameter: &str, unit: &Name, span: Span) {
        let found = format!("`{parameter}` of `{}` is missing", unit.text);
        self.tell(Diagnostic::new(Code::WrongArguments, span, found));
    }

    /// Takes note that this unit calls another.
    pub(in crate::check) fn note_call(&mut self, unit: usize, span: Span) {
        self.checker.want(unit);
        if let Some(own) = self.unit {
            self.checker.calls.push((own, unit, span));
        }
    }
}
