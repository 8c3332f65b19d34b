//! Calls of instances: inputs are assigned before, outputs read behind.

use super::super::body::Body;
use super::super::expression::Operand;
use super::super::unit::{Storage, is_part};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{self, ExprKind, Place, Statement, StatementKind, Type, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, Binding, Expression, ExpressionKind, SectionKind};

impl<'a> Body<'_, 'a> {
    /// Calls the instance at a place.
    pub(in crate::check) fn invoke(
        &mut self,
        place: Place,
        unit: usize,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Vec<Statement>> {
        self.note_call(unit, span);
        let parameters = self.parameters(unit);
        let name = self.checker.units[unit].ast.name.clone();
        let Some(bound) = self.bind(&parameters, &name, arguments, span) else {
            self.arguments_apart(arguments);
            return None;
        };
        let mut block = Vec::new();
        // One instance gets the inputs, runs and is read, whatever the call changes.
        let place = self.fixed(place, &mut block, span);
        let mut behind = Vec::new();
        let mut by_call = Vec::new();
        let mut complete = true;
        for (parameter, given) in parameters.iter().zip(&bound.given) {
            let (Some(ty), Some((value, binding))) = (parameter.ty, given) else {
                if parameter.kind == SectionKind::InOut && given.is_none() {
                    self.missing(&parameter.name, &name, span);
                    complete = false;
                }
                // Its parameter has an error.
                if let Some((value, _)) = given {
                    self.apart(value);
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
                (Storage::Local(_), SectionKind::InOut) => self
                    .in_out(value, ty)
                    .map(|target| by_call.push(hir::Argument::Reference(target))),
                (Storage::Field(field), SectionKind::Output) => {
                    let source = place.clone().field(*field, ty);
                    self.write_place(value)
                        .map(|target| self.fixed(target, &mut block, value.span))
                        .and_then(|target| self.output(source, target, *binding, value.span))
                        .map(|one| behind.push(one))
                }
                _ => None,
            };
            complete &= done.is_some();
        }
        if !complete {
            return None;
        }
        let routine = self.checker.units[unit].routine?;
        block.push(self.statement(StatementKind::Invoke(place, routine, by_call), span));
        block.extend(behind);
        self.enabled(block, bound.enable, span)
    }

    /// `output => target`, behind the call.
    pub(super) fn output(
        &mut self,
        source: Place,
        place: Place,
        binding: Binding,
        span: Span,
    ) -> Option<Statement> {
        let ty = source.ty;
        let mut value = self.expr(ty, ExprKind::Load(source), span);
        if binding == Binding::NegatedOutput {
            let negated = self.unary_operator(
                crate::syntax::ast::UnaryOperator::Not,
                Operand::typed(value),
                span,
            )?;
            value = negated.expr;
        }
        let value = self.converted(Operand::typed(value), place.ty, span)?;
        Some(self.statement(StatementKind::Assign(place, value), span))
    }

    /// What is handed on by reference: a place of exactly the parameter's type.
    pub(super) fn in_out(&mut self, value: &'a Expression, ty: TypeId) -> Option<Place> {
        let place = self.write_place(value)?;
        // What gets it may read it too.
        if let ExpressionKind::Name(name) = &value.kind
            && let Some(index) = self.variable(name)
        {
            self.variables[index].read = true;
        }
        self.by_reference(place, value, ty, "VAR_IN_OUT")
    }

    /// A place that is handed on for a parameter of a type, which stands in the section `what`.
    pub(super) fn by_reference(
        &mut self,
        place: Place,
        value: &'a Expression,
        ty: TypeId,
        what: &str,
    ) -> Option<Place> {
        if is_part(&place) {
            let found = format!("a bit or a part of a variable for a {what}");
            let one = Diagnostic::new(Code::WrongArguments, value.span, found);
            self.tell(one.allowed("a whole variable, field or element"));
            return None;
        }
        if let hir::Root::Global(id) = place.root
            && self.checker.program.global(id).storage.bit.is_some()
        {
            let found = format!("a bit of an image for a {what}");
            let one = Diagnostic::new(Code::WrongArguments, value.span, found);
            self.tell(one.hint("copy it to a variable and back"));
            return None;
        }
        let types = &self.checker.program.types;
        let fits = place.ty == ty
            || match types.get(ty) {
                Type::OpenArray { element, dimensions } => {
                    let inner = (0..*dimensions).try_fold(place.ty, |ty, _| match types.get(ty) {
                        Type::Array { element, .. } => Some(*element),
                        _ => None,
                    });
                    inner == Some(*element)
                }
                _ => false,
            };
        if !fits {
            let found =
                format!("{} for a {what} of type {}", self.type_name(place.ty), self.type_name(ty));
            let one = Diagnostic::new(Code::TypeMismatch, value.span, found);
            self.tell(one.allowed("a variable of exactly this type"));
            return None;
        }
        Some(place)
    }
}
