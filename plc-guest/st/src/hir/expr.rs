//! Expressions. Operands are evaluated from left to right.

use super::{Constant, Intrinsic, Location, Place, RoutineId, TypeId};

/// An expression with its type.
#[derive(Clone, Debug, PartialEq)]
pub struct Expr {
    /// The type of the value.
    pub ty: TypeId,
    /// What is computed.
    pub kind: ExprKind,
    /// Where it stands; what a trap in it is reported with.
    pub location: Location,
}

/// What an expression computes.
#[derive(Clone, Debug, PartialEq)]
pub enum ExprKind {
    /// A value of a scalar type or a string.
    Constant(Constant),
    /// The value at a place.
    Load(Place),
    /// The operand has the type of the expression.
    Unary(UnaryOperator, Box<Expr>),
    /// Both operands have the type of the expression.
    Arithmetic(Arithmetic, Box<Expr>, Box<Expr>),
    /// Both operands have the same scalar type, or are both STRING or both WSTRING of any capacity. The type is BOOL.
    Compare(Comparison, Box<Expr>, Box<Expr>),
    /// `AND_THEN`: the second operand is evaluated only if the first is TRUE.
    AndThen(Box<Expr>, Box<Expr>),
    /// `OR_ELSE`: the second operand is evaluated only if the first is FALSE.
    OrElse(Box<Expr>, Box<Expr>),
    /// A conversion from the operand's type to the expression's.
    Convert(Conversion, Box<Expr>),
    /// A call of a function that has a result. One argument per parameter, in the order of the locals.
    Call(RoutineId, Vec<Argument>),
    /// A function that the compiler knows.
    Intrinsic(Intrinsic, Vec<Expr>),
    /// `REF(place)`.
    Reference(Place),
    /// `LOWER_BOUND` or `UPPER_BOUND` of a dimension, from 0, of the open array at a place. The type is LINT.
    Bound {
        /// The open array.
        place: Place,
        /// The dimension, from 0.
        dimension: u8,
        /// Whether the upper bound is meant.
        upper: bool,
    },
}

/// An operator with one operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnaryOperator {
    /// `-`, of signed integers, reals and durations. The least integer stays itself.
    Negate,
    /// `NOT`, of BOOL and bit strings.
    Not,
}

/// An operator with two operands and a result of the same type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arithmetic {
    /// Integers wrap.
    Add,
    /// Integers wrap.
    Subtract,
    /// Integers wrap.
    Multiply,
    /// Integers round towards zero and trap if the divisor is 0; the least integer by -1 is itself.
    Divide,
    /// Integers only. The sign is the dividend's; traps if the divisor is 0.
    Modulo,
    /// BOOL and bit strings.
    And,
    /// BOOL and bit strings.
    Or,
    /// BOOL and bit strings.
    Xor,
}

/// A comparison. With NaN all but [`Comparison::NotEqual`] are FALSE. Strings compare unit by unit, a prefix is less.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs)] // Said by the names.
pub enum Comparison {
    Equal,
    NotEqual,
    Less,
    LessEqual,
    Greater,
    GreaterEqual,
}

/// A conversion between scalar types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Conversion {
    /// By value. Integer to integer keeps the low bits; integer to BOOL is `<> 0`; integer to real and LREAL to REAL
    /// round to the nearest, ties to even; real to integer rounds likewise, saturates, and makes 0 of NaN; real to BOOL
    /// is `<> 0`; WCHAR to CHAR is a question mark for a character that CHAR does not have.
    Value,
    /// Real to integer towards zero, saturating, 0 for NaN.
    Truncate,
    /// The same bits in another type of the same size.
    Bits,
    /// To a subrange of the same base, or from one to a narrower one: a value outside of the range traps.
    Check,
}

/// An argument of a call.
#[derive(Clone, Debug, PartialEq)]
pub enum Argument {
    /// For [`super::LocalKind::Input`]. The value's type is the parameter's; strings may differ in capacity.
    Value(Expr),
    /// For [`super::LocalKind::InOut`]. The place's type is the parameter's, or an array where the parameter is an open
    /// array of as many dimensions and the same element. No bit.
    Reference(Place),
    /// For [`super::LocalKind::Output`]: where the value goes after the call, if anywhere. The place's type is the
    /// parameter's. The place is evaluated before the call.
    Output(Option<Place>),
}

impl Expr {
    /// An expression from its parts.
    pub fn new(ty: TypeId, kind: ExprKind, location: Location) -> Expr {
        Expr { ty, kind, location }
    }
}
