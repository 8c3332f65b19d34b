//! Statements.

use super::{Argument, Expr, Location, Place, RoutineId};

/// Statements one after the other.
pub type Block = Vec<Statement>;

/// A statement.
#[derive(Clone, Debug, PartialEq)]
pub struct Statement {
    /// What it does.
    pub kind: StatementKind,
    /// Where it begins; what a trap of the loop budget is reported with.
    pub location: Location,
}

/// What a statement does.
#[derive(Clone, Debug, PartialEq)]
pub enum StatementKind {
    /// The value is evaluated before the place. Types are equal; strings may differ in capacity, and what exceeds the
    /// place's is cut. Structures and arrays are copied whole.
    Assign(Place, Expr),
    /// A function whose result is dropped, or that has none.
    Call(RoutineId, Vec<Argument>),
    /// Runs the body of the function block or program at a place. The arguments are those of its parameters that are not
    /// fields.
    Invoke(Place, RoutineId, Vec<Argument>),
    /// The first arm whose condition is TRUE, else the last block.
    If(Vec<(Expr, Block)>, Block),
    /// The arm that holds the selector's value, else the last block. The selector is of an integer class. Arms do not
    /// overlap; if they do, the first counts.
    Case(Expr, Vec<CaseArm>, Block),
    /// `FOR variable := from TO to BY by`. The three are evaluated once, in this order, and have the variable's type,
    /// which is an integer type; then the variable is assigned. The variable is a place without an index or reference
    /// in its path. A `by` of 0 traps as a loop without end; its sign, if the type is signed, decides the direction. If
    /// `from` has passed `to` there is no round. After each round the variable is increased by `by`, and wraps; the
    /// loop ends if the variable had passed `to`, or passes it, or left the type's range. So no end value makes a FOR
    /// endless; a body that assigns the variable can, and the loop budget ends it.
    For(Box<ForLoop>),
    /// As long as the condition is TRUE. The loop budget counts tests of the condition.
    While(Expr, Block),
    /// Until the condition, evaluated after the body, is TRUE.
    Repeat(Block, Expr),
    /// Leaves the innermost loop.
    Exit,
    /// Goes on with the next round of the innermost loop: to FOR's increase, WHILE's or REPEAT's condition.
    Continue,
    /// Ends the routine.
    Return,
}

/// The parts of FOR. They lie apart, since every statement takes as much memory as the largest kind.
#[derive(Clone, Debug, PartialEq)]
pub struct ForLoop {
    /// What is counted.
    pub variable: Place,
    /// The first value.
    pub from: Expr,
    /// The last value.
    pub to: Expr,
    /// The step.
    pub by: Expr,
    /// What is repeated.
    pub body: Block,
}

/// An arm of CASE.
#[derive(Clone, Debug, PartialEq)]
pub struct CaseArm {
    /// Ranges of values, both ends included.
    pub ranges: Vec<(i128, i128)>,
    /// What is done.
    pub body: Block,
}
