//! Statements.

use super::{Expression, Name};
use crate::source::Span;

/// A statement.
#[derive(Clone, Debug)]
pub struct Statement {
    /// What it is.
    pub kind: StatementKind,
    /// Where it is.
    pub span: Span,
}

/// What a statement is.
#[derive(Clone, Debug)]
pub enum StatementKind {
    /// `target := value;`
    Assign {
        /// What is assigned.
        target: Expression,
        /// The value.
        value: Expression,
        /// `?=` instead of `:=`, with which a reference is tried.
        attempt: bool,
    },
    /// A call alone.
    Call(Expression),
    /// IF and ELSIF, then ELSE.
    If {
        /// Condition and body of each.
        branches: Vec<(Expression, Vec<Statement>)>,
        /// ELSE
        otherwise: Option<Vec<Statement>>,
    },
    /// CASE
    Case {
        /// What selects.
        selector: Expression,
        /// Labels and body of each.
        branches: Vec<(Vec<Label>, Vec<Statement>)>,
        /// ELSE
        otherwise: Option<Vec<Statement>>,
    },
    /// FOR
    For(Box<ForLoop>),
    /// WHILE
    While(Expression, Vec<Statement>),
    /// REPEAT ... UNTIL
    Repeat(Vec<Statement>, Expression),
    /// EXIT
    Exit,
    /// CONTINUE
    Continue,
    /// RETURN
    Return,
    /// What was already told.
    Error,
}

/// The parts of FOR. They lie apart, since every statement takes as much memory as the largest kind.
#[derive(Clone, Debug)]
pub struct ForLoop {
    /// The control variable.
    pub variable: Name,
    /// Its first value.
    pub from: Expression,
    /// Its last value.
    pub to: Expression,
    /// BY
    pub by: Option<Expression>,
    /// The body.
    pub body: Vec<Statement>,
}

/// A label of CASE.
#[derive(Clone, Debug)]
pub enum Label {
    /// One value.
    One(Expression),
    /// `low..high`
    Range(Expression, Expression),
}
