//! Types and initial values as they are written.

use super::{Expression, Name, Variables};
use crate::source::Span;

/// `name : spec := initial;` in a TYPE block.
#[derive(Clone, Debug)]
pub struct TypeDeclaration {
    /// Its name.
    pub name: Name,
    /// What it is.
    pub spec: TypeSpec,
    /// The initial value of its variables.
    pub initial: Option<Initial>,
    /// All of it.
    pub span: Span,
}

/// A type as it is written.
#[derive(Clone, Debug)]
pub struct TypeSpec {
    /// What it is.
    pub kind: TypeKind,
    /// Where it is.
    pub span: Span,
}

/// What a type is.
#[derive(Clone, Debug)]
pub enum TypeKind {
    /// A name of an elementary or declared type, or of a function block.
    Named(Name),
    /// STRING or WSTRING, with its length in characters if written.
    Text {
        /// WSTRING
        wide: bool,
        /// `[80]`
        length: Option<Box<Expression>>,
    },
    /// `ARRAY [1..10, 0..3] OF spec`
    Array {
        /// One a dimension.
        ranges: Vec<ArrayRange>,
        /// Of what.
        element: Box<TypeSpec>,
    },
    /// `REF_TO spec`
    Reference(Box<TypeSpec>),
    /// `INT (0..100)`
    Subrange {
        /// The type.
        base: Name,
        /// The least value.
        low: Box<Expression>,
        /// The largest value.
        high: Box<Expression>,
    },
    /// `(Red, Green := 5)`, also `BYTE (Red := 1)`
    Enumeration {
        /// The type of its values, if written.
        base: Option<Name>,
        /// The values.
        values: Vec<EnumerationValue>,
    },
    /// `STRUCT ... END_STRUCT`
    Structure {
        /// The fields.
        fields: Vec<Variables>,
    },
    /// What was already told.
    Error,
}

/// The bounds of one dimension.
#[derive(Clone, Debug)]
pub enum ArrayRange {
    /// `low..high`
    Fixed(Box<(Expression, Expression)>),
    /// `*`
    Open(Span),
}

/// One value of an enumeration.
#[derive(Clone, Debug)]
pub struct EnumerationValue {
    /// Its name.
    pub name: Name,
    /// Its number, if written.
    pub value: Option<Expression>,
}

/// An initial value.
#[derive(Clone, Debug)]
pub enum Initial {
    /// `:= 5`
    Value(Expression),
    /// `:= [1, 2, 3(0)]`
    Array(Vec<ArrayElement>, Span),
    /// `:= (x := 1, y := 2)`
    Structure(Vec<(Name, Initial)>, Span),
}

impl Initial {
    /// Where it is.
    #[must_use]
    pub fn span(&self) -> Span {
        match self {
            Self::Value(value) => value.span,
            Self::Array(_, span) | Self::Structure(_, span) => *span,
        }
    }
}

/// One part of an array's initial value.
#[derive(Clone, Debug)]
pub enum ArrayElement {
    /// `1`
    One(Initial),
    /// `3(0, 1)`: these values so many times. None at all: the type's own initial value.
    Repeated(Expression, Vec<Initial>),
}
