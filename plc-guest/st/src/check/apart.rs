//! Expressions that stand where something else is wrong, such as the arguments of a function that there is not.
//!
//! Which type is needed there is not known. What is wrong in such an expression by itself is told all the same, so that
//! one run shows every mistake.

use super::Entry;
use super::body::{Around, Body};
use super::place::Access;
use crate::syntax::ast::{
    Argument, ArrayElement, Binding, Expression, ExpressionKind, Initial, Label, Name,
};

impl<'a> Body<'_, 'a> {
    /// Tells what is wrong in an expression by itself.
    pub(super) fn apart(&mut self, expression: &'a Expression) {
        match &expression.kind {
            ExpressionKind::Parenthesised(inner) => self.apart(inner),
            // A whole array or a value of an enumeration may be right there.
            ExpressionKind::Name(name) => self.name_apart(name),
            _ => {
                // What may stand around a call is not known either.
                self.around = Some(Around::default());
                self.operand(expression, None);
                self.around = None;
            }
        }
    }

    /// [`Body::apart`] for each.
    pub(super) fn all_apart(&mut self, expressions: impl IntoIterator<Item = &'a Expression>) {
        expressions.into_iter().for_each(|expression| self.apart(expression));
    }

    /// [`Body::apart`] for the values of arguments; those of outputs are assigned.
    pub(super) fn arguments_apart(&mut self, arguments: &'a [Argument]) {
        for argument in arguments {
            let Some(value) = &argument.value else { continue };
            self.apart(value);
            let output = matches!(&argument.name, Some((_, binding)) if *binding != Binding::Input);
            if output && let ExpressionKind::Name(name) = &value.kind {
                self.mark(name, Access::Write);
            }
        }
    }

    /// [`Body::apart`] for an initial value.
    pub(super) fn initial_apart(&mut self, initial: &'a Initial) {
        match initial {
            Initial::Value(value) => self.apart(value),
            Initial::Array(elements, _) => {
                for element in elements {
                    match element {
                        ArrayElement::One(value) => self.initial_apart(value),
                        ArrayElement::Repeated(count, values) => {
                            self.apart(count);
                            values.iter().for_each(|value| self.initial_apart(value));
                        }
                    }
                }
            }
            Initial::Structure(fields, _) => {
                fields.iter().for_each(|(_, value)| self.initial_apart(value));
            }
        }
    }

    /// [`Body::apart`] for a label of CASE. A name alone may be a value of a type that is not understood.
    pub(super) fn label_apart(&mut self, label: &'a Label) {
        let bounds = match label {
            Label::One(value) => vec![value],
            Label::Range(low, high) => vec![low, high],
        };
        let names = |value: &&Expression| matches!(value.kind, ExpressionKind::Name(_));
        self.all_apart(bounds.into_iter().filter(|value| !names(value)));
    }

    fn name_apart(&mut self, name: &Name) {
        self.mark(name, Access::Read);
        let top = self.checker.names.contains_key(&name.key);
        let value = self.checker.enumeration_values.contains_key(&*name.key);
        if self.variable(name).is_none() && !self.is_result(name) && !top && !value {
            self.unknown(name);
        }
    }

    fn mark(&mut self, name: &Name, access: Access) {
        let (read, written) = (access == Access::Read, access == Access::Write);
        if let Some(index) = self.variable(name) {
            self.variables[index].read |= read;
            self.variables[index].written |= written;
            self.mark_external(name, access);
        } else if let Some(Entry::Global(global)) = self.checker.names.get(&name.key) {
            let global = &mut self.checker.globals[*global];
            global.read |= read;
            global.written |= written;
        }
    }
}
