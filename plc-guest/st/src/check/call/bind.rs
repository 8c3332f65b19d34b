//! Which argument is for which parameter.

use super::super::body::Body;
use super::super::names::similar;
use super::super::unit::Storage;
use super::enable::Enable;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Constant, TypeId};
use crate::source::Span;
use crate::syntax::ast::{
    Argument, BinaryOperator, Binding, Expression, ExpressionKind, Name, SectionKind,
};

/// A parameter of a unit.
#[derive(Clone, Debug)]
pub(super) struct Parameter {
    pub(super) name: String,
    pub(super) kind: SectionKind,
    pub(super) ty: Option<TypeId>,
    pub(super) initial: Constant,
    pub(super) storage: Storage,
    /// Whether the unit has an initial value for it.
    pub(super) optional: bool,
}

/// The arguments of a call, one for each parameter if it is given.
pub(super) struct Bound<'a> {
    pub(super) given: Vec<Option<(&'a Expression, Binding)>>,
    pub(super) enable: Enable<'a>,
}

impl<'a> Body<'_, 'a> {
    pub(super) fn parameters(&mut self, unit: usize) -> Vec<Parameter> {
        let span = self.checker.units[unit].ast.name.span;
        self.checker.declare_unit(unit, span, false);
        let entry = &self.checker.units[unit];
        entry
            .parameters
            .iter()
            .map(|index| {
                let variable = &entry.variables[*index];
                Parameter {
                    name: variable.name.text.to_string(),
                    kind: variable.kind,
                    ty: variable.ty,
                    initial: variable.initial.clone(),
                    storage: variable.storage.clone(),
                    optional: variable.initialised,
                }
            })
            .collect()
    }

    /// Whether the arguments of a call have names. Formal and informal ones are not mixed.
    pub(super) fn are_formal(
        &mut self,
        parameters: &[Parameter],
        arguments: &[Argument],
        span: Span,
    ) -> Option<bool> {
        let formal = arguments.iter().filter(|argument| argument.name.is_some()).count();
        if formal == 0 || formal == arguments.len() {
            return Some(formal != 0);
        }
        let found = "arguments with and without names in one call";
        let mut one = Diagnostic::new(Code::WrongArguments, span, found);
        if let Some(name) = compared(parameters, arguments) {
            one = one.hint(format!("`=` compares; a value is given with `{name} := ...`"));
        }
        self.tell(one.allowed("all with names, or none"));
        None
    }

    /// Tells that a parameter is given twice.
    pub(super) fn twice(&mut self, formal: &Name, span: Span) {
        let found = format!("two arguments for `{}`", formal.text);
        self.error(Code::WrongArguments, span, found);
    }

    /// Finds the parameter of each argument.
    pub(super) fn bind(
        &mut self,
        parameters: &[Parameter],
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Bound<'a>> {
        let mut bound = Bound { given: vec![None; parameters.len()], enable: Enable::default() };
        let mut complete = true;
        if !self.are_formal(parameters, arguments, span)? {
            // Outputs may be left out at the end, or all of them.
            let inputs: Vec<usize> = (0..parameters.len())
                .filter(|at| parameters[*at].kind != SectionKind::Output)
                .collect();
            let places: Vec<usize> = match arguments.len() <= inputs.len() {
                true => inputs,
                false => (0..parameters.len()).collect(),
            };
            if arguments.len() > places.len() {
                let found = format!("{} arguments for `{}`", arguments.len(), name.text);
                let one = Diagnostic::new(Code::WrongArguments, span, found);
                self.tell(one.allowed(describe(parameters)));
                return None;
            }
            for (argument, at) in arguments.iter().zip(places) {
                let binding = match parameters[at].kind {
                    SectionKind::Output => Binding::Output,
                    _ => Binding::Input,
                };
                bound.given[at] = Some((argument.value.as_ref()?, binding));
            }
            return Some(bound);
        }
        for argument in arguments {
            let Some((formal, binding)) = &argument.name else { continue };
            let Some(value) = &argument.value else {
                // `x =>` leaves the output unconnected.
                continue;
            };
            match (&*formal.key, binding) {
                ("EN", Binding::Input) => {
                    if bound.enable.en.replace(value).is_some() {
                        self.twice(formal, argument.span);
                        complete = false;
                    }
                    continue;
                }
                ("ENO", Binding::Output) => {
                    let given = bound.enable.eno.replace(value).is_some();
                    bound.enable.by_body =
                        parameters.iter().any(|one| one.name.eq_ignore_ascii_case("ENO"));
                    if !bound.enable.by_body {
                        if given {
                            self.twice(formal, argument.span);
                            complete = false;
                        }
                        continue;
                    }
                }
                _ => {}
            }
            let found = parameters
                .iter()
                .position(|parameter| parameter.name.eq_ignore_ascii_case(&formal.text));
            let Some(at) = found else {
                self.no_parameter(parameters, name, formal);
                complete = false;
                continue;
            };
            let output = parameters[at].kind == SectionKind::Output;
            if output != (*binding != Binding::Input) {
                let (what, sign) = if output { ("an output", "=>") } else { ("an input", ":=") };
                let found = format!("`{}` is {what} of `{}`", formal.text, name.text);
                let one = Diagnostic::new(Code::WrongArguments, argument.span, found);
                self.tell(one.allowed(format!("`{} {sign} ...`", formal.text)));
                complete = false;
                continue;
            }
            if bound.given[at].replace((value, *binding)).is_some() {
                self.twice(formal, argument.span);
                complete = false;
            }
        }
        complete.then_some(bound)
    }

    fn no_parameter(&mut self, parameters: &[Parameter], name: &Name, formal: &Name) {
        let found = format!("`{}` has no parameter `{}`", name.text, formal.text);
        let mut one =
            Diagnostic::new(Code::WrongArguments, formal.span, found).allowed(describe(parameters));
        let names = parameters.iter().map(|parameter| &*parameter.name);
        if let Some(similar) = similar(&formal.key, names) {
            one = one.hint(format!("did you mean `{similar}`?"));
        }
        self.tell(one);
    }
}

/// The parameters, as one writes their names in a call.
fn describe(parameters: &[Parameter]) -> String {
    if parameters.is_empty() {
        return "no arguments".to_owned();
    }
    let shown: Vec<String> = parameters
        .iter()
        .take(12)
        .map(|parameter| match parameter.kind {
            SectionKind::Output => format!("{} =>", parameter.name),
            _ => format!("{} :=", parameter.name),
        })
        .collect();
    shown.join(", ")
}

/// The name of a parameter that an argument compares instead of giving it a value: `IN = TRUE`.
fn compared<'n>(parameters: &[Parameter], arguments: &'n [Argument]) -> Option<&'n str> {
    let values = arguments.iter().filter(|argument| argument.name.is_none());
    values.filter_map(|argument| argument.value.as_ref()).find_map(|value| match &value.kind {
        ExpressionKind::Binary(BinaryOperator::Equal, _, left, _) => match &left.kind {
            ExpressionKind::Name(name) => {
                let known = |one: &Parameter| one.name.eq_ignore_ascii_case(&name.text);
                parameters.iter().any(known).then_some(&*name.text)
            }
            _ => None,
        },
        _ => None,
    })
}
