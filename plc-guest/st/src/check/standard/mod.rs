//! The standard functions that the compiler makes itself, by a table of their signatures.
//!
//! What is here is generic over ANY_* or has no form in ST: every other function of the standard is
//! written in ST, in the library. A function of the library with a name of this table would never be
//! called.

mod arguments;
mod bounds;
mod channel;
mod conversion;
pub mod known;
mod make;
mod repeated;
mod table;
mod text;
mod unify;

pub(super) use channel::is_channel;

use super::body::Body;
use super::expression::Operand;
use super::names::similar;
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Expr, ExprKind, Intrinsic, TypeId};
use crate::source::Span;
use crate::syntax::ast::{Argument, Name};

/// A checked argument with its place.
type Given = (Operand, Span);

impl<'a> Body<'_, 'a> {
    /// A call of something that the project does not declare.
    pub(in crate::check) fn standard_call(
        &mut self,
        name: &'a Name,
        arguments: &'a [Argument],
        span: Span,
        hint: Option<TypeId>,
    ) -> Option<Operand> {
        match &*name.key {
            "REF" => return self.reference(arguments, span),
            "LOWER_BOUND" | "UPPER_BOUND" => return self.bound(name, arguments, span, hint),
            key if is_channel(key) => return self.channel(name, arguments, span),
            _ => {}
        }
        let Some(function) = table::function(&name.key) else {
            return match self.conversion_call(name, arguments, span) {
                Some(result) => result,
                None => {
                    self.unknown_function(name);
                    self.arguments_apart(arguments);
                    None
                }
            };
        };
        let given = self.given(function, name, arguments, span, hint)?;
        self.make(function, name, given, span, hint)
    }

    fn unknown_function(&mut self, name: &Name) {
        let found = format!("there is no function `{}`", name.text);
        let mut one = Diagnostic::new(Code::UnknownName, name.span, found);
        if super::test::form(&name.key).is_some() {
            let one = one.hint("it is a function of tests: `TEST 'name' ... END_TEST`");
            return self.tell(one);
        }
        let known = table::FUNCTIONS.iter().map(|function| function.name);
        let known = known.chain(channel::FORMS.iter().map(|(name, _)| *name));
        let known = known.chain(self.checker.names.keys());
        let known = known.chain(self.variables.iter().map(|variable| &*variable.name.text));
        if let Some(similar) = similar(&name.key, known) {
            one = one.hint(format!("did you mean `{similar}`?"));
        }
        self.tell(one);
    }

    pub(super) fn intrinsic(
        &self,
        intrinsic: Intrinsic,
        list: Vec<Expr>,
        ty: TypeId,
        span: Span,
    ) -> Operand {
        Operand::typed(self.expr(ty, ExprKind::Intrinsic(intrinsic, list), span))
    }

    fn no_type(&mut self, name: &Name, span: Span) {
        let found = format!("a number without a type for `{}`", name.text);
        let one = Diagnostic::new(Code::TypeMismatch, span, found);
        self.tell(one.hint("write its type: `WORD#16#00FF`"));
    }
}
