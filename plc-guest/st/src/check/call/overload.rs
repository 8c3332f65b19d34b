//! Several functions of a library that have one name: the one whose inputs the arguments fit.

use super::super::body::Body;
use super::super::convert::widens;
use super::super::expression::Operand;
use super::super::literal::fits;
use super::super::types::{is_integer, is_real};
use super::bind::Parameter;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{self, Constant, Expr, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, Binding, Name, SectionKind};

impl<'a> Body<'_, 'a> {
    /// The first function of a library whose inputs the arguments fit: without any conversion if there
    /// is one, else with implicit ones.
    pub(super) fn overloaded(
        &mut self,
        units: &[usize],
        name: &Name,
        arguments: impl IntoIterator<Item = &'a Argument>,
        span: Span,
    ) -> Option<(usize, Vec<hir::Argument>)> {
        // A call within an argument is one within an expression.
        self.around = None;
        let mut operands = Vec::new();
        for argument in arguments {
            if let Some((formal, Binding::Output | Binding::NegatedOutput)) = &argument.name {
                let found = format!("`{}` is no output of `{}`", formal.text, name.text);
                self.error(Code::WrongArguments, argument.span, found);
                return None;
            }
            let formal = argument.name.as_ref().map(|(name, _)| name.text.to_string());
            let value = argument.value.as_ref();
            let checked = value.and_then(|value| Some((self.operand(value, None)?, value.span)));
            operands.push(checked.map(|(operand, span)| (formal, operand, span)));
        }
        // All of them before any is given up.
        let operands: Vec<_> = operands.into_iter().collect::<Option<_>>()?;
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
    pub(in crate::check) fn fits(&self, operand: &Operand, ty: TypeId, exact: bool) -> bool {
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
                is_real(b) || is_integer(b) && fits(b, *value)
            }
            Some(Constant::Real(_)) if operand.untyped => is_real(b),
            _ => widens(a, b),
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
