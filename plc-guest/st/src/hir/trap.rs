//! How a program fails by its own doing.

use std::fmt;

use super::Location;

/// What a program did that ends it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TrapKind {
    /// An index outside of its array.
    Bounds,
    /// A division or MOD by zero.
    ZeroDivide,
    /// A reference that is NULL.
    Null,
    /// A loop that made more rounds than its budget, or a FOR with a step of 0.
    LoopBudget,
    /// A value outside of its subrange.
    Subrange,
}

impl fmt::Display for TrapKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            TrapKind::Bounds => "array index out of bounds",
            TrapKind::ZeroDivide => "division by zero",
            TrapKind::Null => "reference is NULL",
            TrapKind::LoopBudget => "loop without end",
            TrapKind::Subrange => "value out of its subrange",
        })
    }
}

/// A trap with its place in the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Trap {
    /// What happened.
    pub kind: TrapKind,
    /// Where.
    pub location: Location,
}
