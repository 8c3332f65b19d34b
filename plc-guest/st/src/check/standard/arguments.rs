//! The arguments of a standard function: their order, and the types that it allows.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::types::{is_integer, is_real, is_shiftable};
use super::Given;
use super::table::{Function, Group, Make, Parameter};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Elementary, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, Binding, Name};

impl<'a> Body<'_, 'a> {
    /// The arguments in the order of the parameters, of types that those allow.
    pub(super) fn given(
        &mut self,
        function: &Function,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Vec<Given>> {
        let mut order: Vec<Option<&'a Argument>> = Vec::new();
        for (at, argument) in arguments.iter().enumerate() {
            let at = match &argument.name {
                None => Some(at),
                Some((formal, Binding::Input)) => function.place(&formal.key),
                Some(_) => None,
            };
            let free = at.filter(|at| *at < 1000 && order.get(*at).is_none_or(Option::is_none));
            let Some(at) = free else {
                let found = format!("this argument of `{}`", name.text);
                let one = Diagnostic::new(Code::WrongArguments, argument.span, found);
                self.tell(one.allowed(function.form()));
                return None;
            };
            if order.len() <= at {
                order.resize(at + 1, None);
            }
            order[at] = Some(argument);
        }
        let count = order.len();
        let fits = count >= function.least()
            && (count <= function.parameters.len() || function.extensible)
            && order.iter().all(Option::is_some);
        if !fits {
            let found = format!("{} arguments for `{}`", arguments.len(), name.text);
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            self.tell(one.allowed(function.form()));
            return None;
        }
        // What is needed of a comparison is BOOL, which says nothing of its arguments.
        let hint = hint.filter(|_| !matches!(function.make, Make::Comparison(_)));
        let mut given = Vec::new();
        let mut complete = true;
        for (at, argument) in order.into_iter().flatten().enumerate() {
            let value = argument.value.as_ref()?;
            let parameter = function.parameter(at);
            let hint = if parameter.is_group() { hint } else { None };
            let operand = self.operand(value, hint);
            let operand = operand.map(|operand| self.without_subrange(operand, value.span));
            match operand {
                Some(operand) => {
                    complete &= self.allowed(function, parameter, &operand, value.span);
                    given.push((operand, value.span));
                }
                None => complete = false,
            }
        }
        complete.then_some(given)
    }

    fn allowed(
        &mut self,
        function: &Function,
        parameter: Parameter,
        operand: &Operand,
        span: Span,
    ) -> bool {
        let ty = operand.expr.ty;
        let elementary = self.plain(ty);
        let is = |test: fn(Elementary) -> bool| elementary.is_some_and(test);
        let types = &self.checker.program.types;
        let (fits, allowed) = match parameter {
            Parameter::Bool => (elementary == Some(Elementary::Bool), "BOOL"),
            Parameter::Integer => (is(is_integer), "an integer"),
            Parameter::Same(group) => match group {
                Group::Number => (is(is_integer) || is(is_real), "a number"),
                Group::Real => (
                    is(is_real)
                        || elementary
                            .is_some_and(|elementary| operand.untyped && is_integer(elementary)),
                    "REAL or LREAL",
                ),
                Group::Bits => (is(is_shiftable) || operand.untyped, "BYTE, WORD, DWORD or LWORD"),
                Group::String => {
                    let character =
                        matches!(elementary, Some(Elementary::Char | Elementary::Wchar))
                            && function.make == Make::Concatenate;
                    (types.is_string(ty) || character, "STRING or WSTRING")
                }
                Group::Ordered => {
                    (elementary.is_some() || types.is_string(ty), "an elementary value")
                }
                // Any value can be copied, and the operator says what it takes.
                Group::Any | Group::Operands => (true, ""),
            },
        };
        if !fits {
            let found = format!("{} for `{}`", self.type_name(ty), function.name);
            let mut one = Diagnostic::new(Code::TypeMismatch, span, found).allowed(allowed);
            if let (Parameter::Same(Group::Real), Some(integer)) = (parameter, elementary)
                && is_integer(integer)
            {
                one = one.hint(format!("convert it: `{}_TO_LREAL(...)`", integer.name()));
            }
            self.tell(one);
            return false;
        }
        match parameter {
            Parameter::Same(Group::String) => self.used_as_string(&operand.expr, span).is_some(),
            _ => true,
        }
    }
}
