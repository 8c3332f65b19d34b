//! Expressions.

use super::{Address, Name};
use crate::source::Span;

/// An expression.
#[derive(Clone, Debug)]
pub struct Expression {
    /// What it is.
    pub kind: ExpressionKind,
    /// Where it is.
    pub span: Span,
    /// The height of the tree that is made of it, which the parser keeps within [`crate::limits::HEIGHT`].
    pub height: u32,
}

impl Expression {
    /// A node over its parts.
    #[must_use]
    pub fn new(kind: ExpressionKind, span: Span) -> Self {
        let height = 1 + kind.parts_height();
        Self { kind, span, height }
    }
}

/// What an expression is.
#[derive(Clone, Debug)]
pub enum ExpressionKind {
    /// A literal.
    Literal(Literal),
    /// A name: of a variable, a constant, a value of an enumeration, the function itself.
    Name(Name),
    /// `Colour#Red`: the type and the value. They lie apart, since every expression takes as much memory as the largest
    /// kind.
    EnumerationValue(Box<(Name, Name)>),
    /// `%IX0.0`
    Address(Address),
    /// `base.name`
    Field(Box<Expression>, Name),
    /// `base.3`, `base.%X3`, `base.%B1`: a part of a bit string.
    Part(Box<Expression>, super::Width, u32, Span),
    /// `base[i, j]`
    Index(Box<Expression>, Vec<Expression>),
    /// `base^`
    Dereference(Box<Expression>),
    /// `-a`, `NOT a`
    Unary(UnaryOperator, Box<Expression>),
    /// `a + b`, with the operator's place.
    Binary(BinaryOperator, Span, Box<Expression>, Box<Expression>),
    /// `f(x, y := 1, z => q)`; what is called is a name, a field or an element of an array.
    Call(Box<Expression>, Vec<Argument>),
    /// `(a)`
    Parenthesised(Box<Expression>),
    /// What was already told.
    Error,
}

impl ExpressionKind {
    /// The height of the highest part.
    fn parts_height(&self) -> u32 {
        match self {
            Self::Literal(_)
            | Self::Name(_)
            | Self::EnumerationValue(..)
            | Self::Address(_)
            | Self::Error => 0,
            Self::Field(part, _)
            | Self::Part(part, ..)
            | Self::Dereference(part)
            | Self::Unary(_, part)
            | Self::Parenthesised(part) => part.height,
            Self::Binary(_, _, left, right) => left.height.max(right.height),
            Self::Index(base, indices) => {
                indices.iter().fold(base.height, |height, index| height.max(index.height))
            }
            Self::Call(callee, arguments) => {
                let values = arguments.iter().filter_map(|argument| argument.value.as_ref());
                let highest = values.fold(callee.height, |height, part| height.max(part.height));
                // Standard functions become an operation for each further argument, one over the other.
                highest + (arguments.len() as u32).saturating_sub(1)
            }
        }
    }
}

/// One argument of a call.
#[derive(Clone, Debug)]
pub struct Argument {
    /// The parameter's name in a formal call, and how it is bound.
    pub name: Option<(Name, Binding)>,
    /// The value, or where the output goes to. None in `x => ` without a target.
    pub value: Option<Expression>,
    /// All of it.
    pub span: Span,
}

/// How a parameter is bound in a formal call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Binding {
    /// `name := value`
    Input,
    /// `name => variable`
    Output,
    /// `NOT name => variable`
    NegatedOutput,
}

/// A literal as a value. Its range is checked against its type later.
#[derive(Clone, Debug, PartialEq)]
pub struct Literal {
    /// The type before the `#`, if written: `INT#5`.
    pub prefix: Option<Box<str>>,
    /// The value.
    pub value: LiteralValue,
}

/// The value of a literal.
#[derive(Clone, Debug, PartialEq)]
pub enum LiteralValue {
    /// TRUE or FALSE
    Bool(bool),
    /// Decimal or based, without its sign.
    Integer(u64),
    /// With a point.
    Real {
        /// As an LREAL.
        long: f64,
        /// As a REAL: the LREAL is rounded already, and might become another one.
        short: f32,
    },
    /// A duration in nanoseconds; `long` if LTIME is written.
    Duration {
        /// Nanoseconds.
        nanoseconds: i64,
        /// LTIME
        long: bool,
    },
    /// A date, in nanoseconds since 1970-01-01.
    Date {
        /// Nanoseconds.
        nanoseconds: i64,
        /// LDATE
        long: bool,
    },
    /// A time of day, in nanoseconds since midnight.
    TimeOfDay {
        /// Nanoseconds.
        nanoseconds: i64,
        /// LTOD
        long: bool,
    },
    /// A date and time, in nanoseconds since 1970-01-01.
    DateAndTime {
        /// Nanoseconds.
        nanoseconds: i64,
        /// LDT
        long: bool,
    },
    /// The bytes of a single-byte string.
    String(Vec<u8>),
    /// The UTF-16 units of a double-byte string.
    WideString(Vec<u16>),
    /// NULL
    Null,
}

/// An operator with one operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum UnaryOperator {
    /// `-`
    Negate,
    /// `+`
    Plus,
    /// `NOT`
    Not,
}

/// An operator with two operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BinaryOperator {
    /// `**`
    Power,
    /// `*`
    Multiply,
    /// `/`
    Divide,
    /// `MOD`
    Modulo,
    /// `+`
    Add,
    /// `-`
    Subtract,
    /// `<`
    Less,
    /// `>`
    Greater,
    /// `<=`
    LessEqual,
    /// `>=`
    GreaterEqual,
    /// `=`
    Equal,
    /// `<>`
    NotEqual,
    /// `AND`, `&`
    And,
    /// `AND_THEN`
    AndThen,
    /// `XOR`
    Xor,
    /// `OR`
    Or,
    /// `OR_ELSE`
    OrElse,
}
