//! Calls of functions and function blocks: which argument is for which parameter, and what it becomes.

use super::Entry;
use super::body::Body;
use super::expression::Operand;
use super::unit::{Storage, is_part};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    self, Constant, Elementary, Expr, ExprKind, Place, Statement, StatementKind, Type, TypeId,
};
use crate::source::Span;
use crate::syntax::ast::{
    Argument, Binding, Expression, ExpressionKind, Name, SectionKind, UnitKind,
};

/// A parameter of a unit.
#[derive(Clone, Debug)]
pub(super) struct Parameter {
    name: String,
    kind: SectionKind,
    ty: Option<TypeId>,
    initial: Constant,
    storage: Storage,
    /// Whether the unit has an initial value for it.
    optional: bool,
}

/// The arguments of a call, one for each parameter if it is given.
struct Bound<'a> {
    given: Vec<Option<(&'a Expression, Binding)>>,
    en: Option<&'a Expression>,
    eno: Option<&'a Expression>,
}

impl<'a> Body<'_, 'a> {
    /// A call as a value.
    pub(super) fn call(
        &mut self,
        callee: &'a Expression,
        arguments: &'a [Argument],
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        let ExpressionKind::Name(name) = &callee.kind else {
            self.instance_as_value(callee);
            return None;
        };
        if self.variable(name).is_some()
            || matches!(self.checker.names.get(&name.key), Some(Entry::Global(_)))
        {
            self.instance_as_value(callee);
            return None;
        }
        let units = match self.checker.names.get(&name.key).cloned() {
            Some(Entry::Units(units)) => units,
            Some(entry) => {
                self.not_callable(name, &entry);
                return None;
            }
            None => return self.standard_call(name, arguments, span, hint),
        };
        if self.checker.units[units[0]].ast.kind != UnitKind::Function {
            self.not_callable(name, &Entry::Units(units));
            return None;
        }
        let (unit, list) = match units[..] {
            [unit] => (unit, self.function_arguments(unit, name, arguments, span, None)?),
            _ => self.overloaded(&units, name, arguments, span)?,
        };
        let result = self.checker.units[unit].result;
        let Some((_, ty)) = result else {
            let found = format!("`{}` has no result", name.text);
            self.tell(Diagnostic::new(Code::WrongKind, span, found).hint("call it as a statement"));
            return None;
        };
        let routine = self.checker.units[unit].routine?;
        Some(Operand::typed(self.expr(ty, ExprKind::Call(routine, list), span)))
    }

    fn instance_as_value(&mut self, callee: &Expression) {
        let found = format!("a call of `{}` as a value", self.checker.sources.text(callee.span));
        self.tell(
            Diagnostic::new(Code::WrongKind, callee.span, found)
                .allowed("calls of functions")
                .hint("an instance of a function block is called as a statement; then read its outputs"),
        );
    }

    pub(super) fn not_callable(&mut self, name: &Name, entry: &Entry) {
        let (what, hint) = match entry {
            Entry::Type(_) => ("a type", "a conversion is called such as `INT_TO_REAL(...)`"),
            Entry::Global(_) => ("a variable", "only instances of function blocks can be called"),
            Entry::Units(units) => match self.checker.units[units[0]].ast.kind {
                UnitKind::FunctionBlock => (
                    "a function block and no instance",
                    "declare an instance of it in VAR and call that",
                ),
                UnitKind::Program => ("a program", "give it a task in a CONFIGURATION"),
                UnitKind::Function => ("a function", ""),
            },
        };
        let found = format!("`{}` is {what}", name.text);
        self.tell(Diagnostic::new(Code::WrongKind, name.span, found).hint(hint));
    }

    /// A call as a statement.
    pub(super) fn call_statement(&mut self, expression: &'a Expression) -> Option<Vec<Statement>> {
        let ExpressionKind::Call(callee, arguments) = &expression.kind else { return None };
        let span = expression.span;
        if let ExpressionKind::Name(name) = &callee.kind
            && self.variable(name).is_none()
            && !matches!(self.checker.names.get(&name.key), Some(Entry::Global(_)))
        {
            return self.function_statement(name, expression, arguments, span);
        }
        let place = self.write_place(callee)?;
        // Calling it is using it in both ways.
        self.read_place(callee)?;
        let ty = place.ty;
        let unit = self.block_of(ty);
        let Some(unit) = unit else {
            let found = format!("a call of {}", self.type_name(ty));
            let one = Diagnostic::new(Code::WrongKind, callee.span, found);
            self.tell(one.allowed("an instance of a function block"));
            return None;
        };
        self.invoke(place, unit, arguments, span)
    }

    /// The unit whose instances are of a type.
    pub(super) fn block_of(&self, ty: TypeId) -> Option<usize> {
        self.checker.blocks.get(&ty).copied()
    }

    fn function_statement(
        &mut self,
        name: &'a Name,
        expression: &'a Expression,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Vec<Statement>> {
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
        let mut enable = (None, None);
        let list = self.function_arguments(unit, name, arguments, span, Some(&mut enable))?;
        let routine = self.checker.units[unit].routine?;
        let call = self.statement(StatementKind::Call(routine, list), span);
        self.enabled(vec![call], enable, span)
    }

    /// `target := f(EN := a, ...)`: a call with EN or ENO, which can be a whole value only.
    pub(super) fn enabled_assignment(
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
    fn enabled(
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

    /// Calls the instance at a place.
    pub(super) fn invoke(
        &mut self,
        place: Place,
        unit: usize,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Vec<Statement>> {
        self.note_call(unit, span);
        let parameters = self.parameters(unit);
        let name = self.checker.units[unit].ast.name.clone();
        let bound = self.bind(&parameters, &name, arguments, span)?;
        let mut block = Vec::new();
        let mut behind = Vec::new();
        let mut complete = true;
        for (parameter, given) in parameters.iter().zip(&bound.given) {
            let (Some(ty), Some((value, binding))) = (parameter.ty, given) else {
                if parameter.kind == SectionKind::InOut {
                    self.missing(&parameter.name, &name, span);
                    complete = false;
                }
                continue;
            };
            let done = match (&parameter.storage, parameter.kind) {
                (Storage::Field(field), SectionKind::Input) => {
                    self.value_of(value, ty).map(|value| {
                        let target = place.clone().field(*field, ty);
                        block.push(self.statement(StatementKind::Assign(target, value), span));
                    })
                }
                (Storage::Reference(field, reference), _) => self.in_out(value, ty).map(|target| {
                    let field = place.clone().field(*field, *reference);
                    let value = self.expr(*reference, ExprKind::Reference(target), value.span);
                    block.push(self.statement(StatementKind::Assign(field, value), span));
                }),
                (Storage::Field(field), SectionKind::Output) => {
                    let source = place.clone().field(*field, ty);
                    self.output(source, value, *binding).map(|one| behind.push(one))
                }
                _ => None,
            };
            complete &= done.is_some();
        }
        if !complete {
            return None;
        }
        let routine = self.checker.units[unit].routine?;
        block.push(self.statement(StatementKind::Invoke(place, routine), span));
        block.extend(behind);
        self.enabled(block, (bound.en, bound.eno), span)
    }

    /// `output => target`, behind the call.
    fn output(
        &mut self,
        source: Place,
        target: &'a Expression,
        binding: Binding,
    ) -> Option<Statement> {
        let place = self.write_place(target)?;
        let ty = source.ty;
        let mut value = self.expr(ty, ExprKind::Load(source), target.span);
        if binding == Binding::NegatedOutput {
            let negated = self.unary_operator(
                crate::syntax::ast::UnaryOperator::Not,
                Operand::typed(value),
                target.span,
            )?;
            value = negated.expr;
        }
        let value = self.converted(Operand::typed(value), place.ty, target.span)?;
        Some(self.statement(StatementKind::Assign(place, value), target.span))
    }

    /// What is handed on by reference: a place of exactly the parameter's type.
    fn in_out(&mut self, value: &'a Expression, ty: TypeId) -> Option<Place> {
        let place = self.write_place(value)?;
        // What gets it may read it too.
        if let ExpressionKind::Name(name) = &value.kind
            && let Some(index) = self.variable(name)
        {
            self.variables[index].read = true;
        }
        if is_part(&place) {
            let found = "a bit or a part of a variable for a VAR_IN_OUT";
            let one = Diagnostic::new(Code::WrongArguments, value.span, found);
            self.tell(one.allowed("a whole variable, field or element"));
            return None;
        }
        if let hir::Root::Global(id) = place.root
            && self.checker.program.global(id).storage.bit.is_some()
        {
            let found = "a bit of an image for a VAR_IN_OUT";
            let one = Diagnostic::new(Code::WrongArguments, value.span, found);
            self.tell(one.hint("copy it to a variable and back"));
            return None;
        }
        let types = &self.checker.program.types;
        let fits = place.ty == ty
            || match types.get(ty) {
                Type::OpenArray { element, dimensions } => {
                    let mut inner = place.ty;
                    for _ in 0..*dimensions {
                        if let Type::Array { element, .. } = types.get(inner) {
                            inner = *element;
                        }
                    }
                    inner == *element && inner != place.ty
                }
                _ => false,
            };
        if !fits {
            let found = format!(
                "{} for a VAR_IN_OUT of type {}",
                self.type_name(place.ty),
                self.type_name(ty)
            );
            let one = Diagnostic::new(Code::TypeMismatch, value.span, found);
            self.tell(one.allowed("a variable of exactly this type"));
            return None;
        }
        Some(place)
    }

    fn missing(&mut self, parameter: &str, unit: &Name, span: Span) {
        let found = format!("`{parameter}` of `{}` is missing", unit.text);
        self.tell(Diagnostic::new(Code::WrongArguments, span, found));
    }

    /// Takes note that this unit calls another.
    pub(super) fn note_call(&mut self, unit: usize, span: Span) {
        self.checker.want(unit);
        if let Some(own) = self.unit {
            self.checker.calls.push((own, unit, span));
        }
    }

    fn parameters(&mut self, unit: usize) -> Vec<Parameter> {
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

    /// The arguments of a call of a function. EN and ENO go to `enable`, or are refused.
    fn function_arguments(
        &mut self,
        unit: usize,
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
        enable: Option<&mut (Option<&'a Expression>, Option<&'a Expression>)>,
    ) -> Option<Vec<hir::Argument>> {
        self.note_call(unit, span);
        let parameters = self.parameters(unit);
        let bound = self.bind(&parameters, name, arguments, span)?;
        match enable {
            Some(enable) => *enable = (bound.en, bound.eno),
            None if bound.en.is_some() || bound.eno.is_some() => {
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
            let ty = parameter.ty?;
            let argument = match (parameter.kind, given) {
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
                (_, Some((target, binding))) => self.output_argument(target, *binding, ty),
                (_, None) => Some(hir::Argument::Output(None)),
            };
            match argument {
                Some(argument) => list.push(argument),
                None => complete = false,
            }
        }
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
    /// variable of the compiler's, which is converted behind the statement.
    fn output_argument(
        &mut self,
        target: &'a Expression,
        binding: Binding,
        ty: TypeId,
    ) -> Option<hir::Argument> {
        let place = self.write_place(target)?;
        if place.ty == ty && binding != Binding::NegatedOutput {
            return Some(hir::Argument::Output(Some(place)));
        }
        let local = self.temporary("'output", ty);
        let through = Place::local(local, ty);
        let statement = self.output(through.clone(), target, binding)?;
        let Some(after) = &mut self.after else {
            let found = format!(
                "an output of type {} for a variable of type {} within a condition",
                self.type_name(ty),
                self.type_name(place.ty)
            );
            let one = Diagnostic::new(Code::NotSupported, target.span, found);
            self.tell(one.hint("call the function in a statement before"));
            return None;
        };
        after.push(statement);
        Some(hir::Argument::Output(Some(through)))
    }

    /// Finds the parameter of each argument. Formal and informal arguments are not mixed.
    fn bind(
        &mut self,
        parameters: &[Parameter],
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Bound<'a>> {
        let mut bound = Bound { given: vec![None; parameters.len()], en: None, eno: None };
        let mut complete = true;
        let formal = arguments.iter().filter(|argument| argument.name.is_some()).count();
        if formal != 0 && formal != arguments.len() {
            let found = "arguments with and without names in one call";
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            self.tell(one.allowed("all with names, or none"));
            return None;
        }
        if formal == 0 {
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
                    bound.en = Some(value);
                    continue;
                }
                ("ENO", Binding::Output) => {
                    bound.eno = Some(value);
                    continue;
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
                let found = format!("two arguments for `{}`", formal.text);
                self.error(Code::WrongArguments, argument.span, found);
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
        if let Some(similar) = super::names::similar(&formal.key, names) {
            one = one.hint(format!("did you mean `{similar}`?"));
        }
        self.tell(one);
    }

    /// The first function of a library whose inputs the arguments fit: without any conversion if there
    /// is one, else with implicit ones.
    fn overloaded(
        &mut self,
        units: &[usize],
        name: &Name,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<(usize, Vec<hir::Argument>)> {
        let mut operands = Vec::new();
        for argument in arguments {
            let formal = argument.name.as_ref().map(|(name, _)| name.text.to_string());
            let value = argument.value.as_ref()?;
            operands.push((formal, self.operand(value, None)?, value.span));
        }
        for exact in [true, false] {
            for unit in units {
                let parameters = self.parameters(*unit);
                let Some(order) = fitting_order(&parameters, &operands) else { continue };
                let fits = order.iter().zip(&operands).all(|(at, (_, operand, _))| {
                    parameters[*at].ty.is_some_and(|ty| self.fits(operand, ty, exact))
                });
                if fits {
                    self.note_call(*unit, span);
                    let mut list: Vec<Option<Expr>> = vec![None; parameters.len()];
                    for (at, (_, operand, span)) in order.into_iter().zip(operands) {
                        list[at] = Some(self.converted(operand, parameters[at].ty?, span)?);
                    }
                    let list: Option<Vec<hir::Argument>> =
                        list.into_iter().map(|value| value.map(hir::Argument::Value)).collect();
                    return Some((*unit, list?));
                }
            }
        }
        let types: Vec<String> =
            operands.iter().map(|(_, operand, _)| self.type_name(operand.expr.ty)).collect();
        let found = format!("`{}` of {}", name.text, types.join(", "));
        let mut one = Diagnostic::new(Code::WrongArguments, span, found);
        let forms: Vec<String> = units.iter().take(4).map(|unit| self.form(*unit)).collect();
        one = one.allowed(forms.join(" or "));
        self.tell(one);
        None
    }

    fn form(&mut self, unit: usize) -> String {
        let parameters = self.parameters(unit);
        let types: Vec<String> = parameters
            .iter()
            .filter_map(|parameter| parameter.ty)
            .map(|ty| self.type_name(ty))
            .collect();
        format!("{}({})", self.checker.units[unit].ast.name.text, types.join(", "))
    }

    /// Whether an operand is a value of a type, with implicit conversions unless `exact`.
    pub(super) fn fits(&self, operand: &Operand, ty: TypeId, exact: bool) -> bool {
        let from = operand.expr.ty;
        if from == ty || self.both_strings(from, ty) {
            return true;
        }
        let (Some(a), Some(b)) = (self.plain(from), self.plain(ty)) else { return false };
        if exact {
            return false;
        }
        match operand.constant() {
            Some(Constant::Integer(value)) if operand.untyped => {
                super::types::is_real(b)
                    || super::types::is_integer(b) && super::literal::fits(b, *value)
            }
            Some(Constant::Real(_)) if operand.untyped => super::types::is_real(b),
            _ => super::convert::widens(a, b),
        }
    }
}

/// The parameter of each operand, if there is one for each and none is left without.
fn fitting_order(
    parameters: &[Parameter],
    operands: &[(Option<String>, Operand, Span)],
) -> Option<Vec<usize>> {
    if parameters.len() != operands.len() {
        return None;
    }
    let mut order = Vec::new();
    for (at, (formal, ..)) in operands.iter().enumerate() {
        let at = match formal {
            Some(formal) => parameters
                .iter()
                .position(|parameter| parameter.name.eq_ignore_ascii_case(formal))?,
            None => at,
        };
        if order.contains(&at) || parameters[at].kind != SectionKind::Input {
            return None;
        }
        order.push(at);
    }
    Some(order)
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
