//! The syntax tree: what is written, before anybody asks whether it means something.
//!
//! Where the parser told of an error, the tree has an `Error` node or lacks the part: later stages
//! say nothing more about it.

mod declaration;
mod expression;
mod statement;
mod types;

pub use declaration::*;
pub use expression::*;
pub use statement::*;
pub use types::*;

use crate::source::Span;

/// A name with its place. Case does not count: two names are the same if their keys are.
#[derive(Clone, Debug)]
pub struct Name {
    /// As it is written.
    pub text: Box<str>,
    /// In upper case.
    pub key: Box<str>,
    /// Where it is.
    pub span: Span,
}

impl Name {
    /// A name as it is written at a place.
    #[must_use]
    pub fn new(text: &str, span: Span) -> Self {
        Self { text: text.into(), key: text.to_ascii_uppercase().into(), span }
    }
}

/// All of one file.
#[derive(Clone, Debug, Default)]
pub struct File {
    /// What it declares, in order.
    pub declarations: Vec<Declaration>,
}

impl File {
    /// Whether it has a TEST: all that it declares is for tests alone then.
    #[must_use]
    pub fn has_tests(&self) -> bool {
        let is_test = |declaration: &Declaration| matches!(declaration, Declaration::Unit(unit) if unit.kind == UnitKind::Test);
        self.declarations.iter().any(is_test)
    }
}
