//! The arguments of a function, one for each parameter.

use super::super::body::{Around, Body};
use super::bind::Parameter;
use super::enable::Enable;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{self, ExprKind, Place, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, Binding, Expression, Name, SectionKind};

impl<'a> Body<'_, 'a> {
    /// The arguments of a call of a function. EN and ENO go to `enable`, or are refused.
    pub(super) fn function_arguments(
        &mut self,
        unit: usize,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
        enable: Option<&mut Enable<'a>>,
    ) -> Option<Vec<hir::Argument>> {
        // A call within an argument is one within an expression.
        let mut around = self.around.take();
        self.note_call(unit, span);
        let parameters = self.parameters(unit);
        let Some(bound) = self.bind(&parameters, name, arguments, span) else {
            self.arguments_apart(arguments);
            return None;
        };
        match enable {
            Some(enable) => *enable = bound.enable,
            None if bound.enable.is_used() => {
                let found = "EN or ENO in a call within an expression";
                let one = Diagnostic::new(Code::NotSupported, span, found);
                self.tell(one.allowed("a call alone, or `variable := function(EN := ...)`"));
                return None;
            }
            None => {}
        }
        let informal = arguments.iter().any(|argument| argument.name.is_none());
        let mut list = Vec::new();
        let mut complete = true;
        for (parameter, given) in parameters.iter().zip(&bound.given) {
            let Some(ty) = parameter.ty else {
                // Its declaration has an error.
                complete = false;
                self.all_apart(given.map(|(value, _)| value));
                continue;
            };
            let open = matches!(self.checker.program.types.get(ty), Type::OpenArray { .. });
            let argument = match (parameter.kind, given) {
                (SectionKind::Input, Some((value, _))) if open => self
                    .read_place(value)
                    .and_then(|place| self.by_reference(place, value, ty, "VAR_INPUT"))
                    .map(hir::Argument::Reference),
                (SectionKind::Output, Some((target, Binding::Output))) if open => self
                    .write_place(target)
                    .and_then(|place| self.by_reference(place, target, ty, "VAR_OUTPUT"))
                    .map(hir::Argument::Reference),
                (SectionKind::Output, Some((target, _))) if open => {
                    let found = format!("`NOT` of {}", self.type_name(ty));
                    self.error(Code::TypeMismatch, target.span, found);
                    None
                }
                (_, None) if open => {
                    self.missing(&parameter.name, name, span);
                    None
                }
                (SectionKind::Input, Some((value, _))) => {
                    self.value_of(value, ty).map(hir::Argument::Value)
                }
                (SectionKind::Input, None) if informal && !parameter.optional => {
                    self.missing(&parameter.name, name, span);
                    None
                }
                (SectionKind::Input, None) => self.default_argument(parameter, name, ty, span),
                (SectionKind::InOut, Some((value, _))) => {
                    self.in_out(value, ty).map(hir::Argument::Reference)
                }
                (SectionKind::InOut, None) => {
                    self.missing(&parameter.name, name, span);
                    None
                }
                (_, Some((target, binding))) => {
                    self.output_argument(target, *binding, ty, &mut around)
                }
                (_, None) => Some(hir::Argument::Output(None)),
            };
            match argument {
                Some(argument) => list.push(argument),
                None => complete = false,
            }
        }
        self.around = around;
        complete.then_some(list)
    }

    fn default_argument(
        &mut self,
        parameter: &Parameter,
        name: &Name,
        ty: TypeId,
        span: Span,
    ) -> Option<hir::Argument> {
        let types = &self.checker.program.types;
        if types.scalar(ty).is_none() && !types.is_string(ty) {
            self.missing(&parameter.name, name, span);
            return None;
        }
        let value = self.checker.constant_value(ty, parameter.initial.clone());
        let expr = self.expr(ty, ExprKind::Constant(value), span);
        Some(hir::Argument::Value(expr))
    }

    /// Where an output of a function goes: to the target itself if it has the type, else through a
    /// variable of the compiler's, which is converted behind the call.
    fn output_argument(
        &mut self,
        target: &'a Expression,
        binding: Binding,
        ty: TypeId,
        around: &mut Option<Around>,
    ) -> Option<hir::Argument> {
        let place = self.write_place(target)?;
        if place.ty == ty && binding != Binding::NegatedOutput {
            return Some(hir::Argument::Output(Some(place)));
        }
        let Some(around) = around else {
            let found = match binding {
                Binding::NegatedOutput => "`NOT` of an output within an expression".to_owned(),
                _ => format!(
                    "an output of type {} for a variable of type {} within an expression",
                    self.type_name(ty),
                    self.type_name(place.ty)
                ),
            };
            let one = Diagnostic::new(Code::NotSupported, target.span, found);
            self.tell(one.hint("call the function in a statement before, or `variable := f(...)`"));
            return None;
        };
        let place = self.fixed(place, &mut around.before, target.span);
        let through = Place::local(self.temporary("'output", ty), ty);
        let statement = self.output(through.clone(), place, binding, target.span)?;
        around.behind.push(statement);
        Some(hir::Argument::Output(Some(through)))
    }
}
