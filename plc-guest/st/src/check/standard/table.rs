//! The signatures of the functions that the compiler makes itself (IEC 61131-3:2013, tables 28 to 36).

use crate::hir::{Elementary, Intrinsic};
use crate::syntax::ast::BinaryOperator;

/// One function.
pub(super) struct Function {
    pub(super) name: &'static str,
    /// The parameters with their formal names.
    pub(super) names: &'static [&'static str],
    pub(super) parameters: &'static [Parameter],
    /// Whether the last parameter may be given again and again.
    pub(super) extensible: bool,
    pub(super) make: Make,
}

/// What an argument may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Parameter {
    /// BOOL
    Bool,
    /// ANY_INT
    Integer,
    /// Of a group; all such arguments are brought to one type.
    Same(Group),
}

impl Parameter {
    /// Whether the type that is needed of the result says something of this argument.
    pub(super) fn is_group(self) -> bool {
        matches!(self, Self::Same(_))
    }
}

/// A group of types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Group {
    /// ANY_NUM
    Number,
    /// ANY_REAL
    Real,
    /// ANY_BIT without BOOL
    Bits,
    /// ANY_STRING
    String,
    /// ANY_ELEMENTARY
    Ordered,
    /// ANY
    Any,
    /// What an operator takes.
    Operands,
}

/// What the call becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Make {
    /// All arguments and the result of one type.
    Intrinsic(Intrinsic),
    /// The same from left to right over any number.
    Fold(Intrinsic),
    /// An operator over all arguments.
    Operator(BinaryOperator),
    /// A comparison of each with the next.
    Comparison(BinaryOperator),
    /// EXPT
    Power,
    /// LIMIT
    Limit,
    /// MOVE
    Move,
    /// SEL
    Select,
    /// MUX
    Multiplex,
    /// A bit string and a count.
    Shift(Intrinsic),
    /// A string and integers.
    Text(Intrinsic),
    /// CONCAT
    Concatenate,
    /// The code of a character of a string, for the library: BYTE of STRING, WORD of WSTRING.
    Unit,
    /// A number about strings.
    Measure(Intrinsic),
    /// LOG_LINE
    LogLine,
    /// TRUNC
    Truncate,
    /// What the task is told at its release.
    Clock(Intrinsic, Elementary),
}

impl Function {
    /// The parameter at a place; the last one again behind it.
    pub(super) fn parameter(&self, at: usize) -> Parameter {
        self.parameters[at.min(self.parameters.len().saturating_sub(1))]
    }

    /// The place of a formal name: `IN3` is the third of an extensible function.
    pub(super) fn place(&self, key: &str) -> Option<usize> {
        if let Some(at) = self.names.iter().position(|name| *name == key) {
            return Some(at);
        }
        let number: usize = key.strip_prefix("IN")?.parse().ok()?;
        let last = *self.names.last()?;
        let last_number: usize = last.strip_prefix("IN")?.parse().ok()?;
        (self.extensible && number > last_number && number < 1000)
            .then(|| self.names.len() + number - last_number - 1)
    }

    pub(super) fn least(&self) -> usize {
        self.parameters.len()
    }

    /// Whether it chooses among its arguments, which need be no numbers then.
    pub(super) fn takes_any(&self) -> bool {
        let chosen = [Parameter::Same(Group::Ordered), Parameter::Same(Group::Any)];
        self.parameters.iter().any(|parameter| chosen.contains(parameter))
    }

    /// How it is called, for messages.
    pub(super) fn form(&self) -> String {
        let more = if self.extensible { ", ..." } else { "" };
        format!("{}({}{more})", self.name, self.names.join(", "))
    }
}

/// The function of this key.
pub(super) fn function(key: &str) -> Option<&'static Function> {
    FUNCTIONS.iter().find(|function| function.name == key)
}

const fn fixed(
    name: &'static str,
    names: &'static [&'static str],
    parameters: &'static [Parameter],
    make: Make,
) -> Function {
    Function { name, names, parameters, extensible: false, make }
}

const fn extensible(
    name: &'static str,
    names: &'static [&'static str],
    parameters: &'static [Parameter],
    make: Make,
) -> Function {
    Function { name, names, parameters, extensible: true, make }
}

const NUMBER: Parameter = Parameter::Same(Group::Number);
const REAL: Parameter = Parameter::Same(Group::Real);
const BITS: Parameter = Parameter::Same(Group::Bits);
const STRING: Parameter = Parameter::Same(Group::String);
const ORDERED: Parameter = Parameter::Same(Group::Ordered);
const ANY: Parameter = Parameter::Same(Group::Any);
const OPERANDS: Parameter = Parameter::Same(Group::Operands);
const INTEGER: Parameter = Parameter::Integer;
const IN: &[&str] = &["IN"];
const TWO: &[&str] = &["IN1", "IN2"];

const fn numeric(name: &'static str, intrinsic: Intrinsic) -> Function {
    fixed(name, IN, &[REAL], Make::Intrinsic(intrinsic))
}

const fn operator(name: &'static str, operator: BinaryOperator) -> Function {
    extensible(name, TWO, &[OPERANDS, OPERANDS], Make::Operator(operator))
}

const fn pair(name: &'static str, operator: BinaryOperator) -> Function {
    fixed(name, TWO, &[OPERANDS, OPERANDS], Make::Operator(operator))
}

const fn comparison(name: &'static str, operator: BinaryOperator) -> Function {
    extensible(name, TWO, &[OPERANDS, OPERANDS], Make::Comparison(operator))
}

const fn shift(name: &'static str, intrinsic: Intrinsic) -> Function {
    fixed(name, &["IN", "N"], &[BITS, INTEGER], Make::Shift(intrinsic))
}

/// All of them. The names of the last five are Takt's own.
pub(super) static FUNCTIONS: &[Function] = &[
    fixed("ABS", IN, &[NUMBER], Make::Intrinsic(Intrinsic::Abs)),
    numeric("SQRT", Intrinsic::Sqrt),
    numeric("LN", Intrinsic::Ln),
    numeric("LOG", Intrinsic::Log),
    numeric("EXP", Intrinsic::Exp),
    numeric("SIN", Intrinsic::Sin),
    numeric("COS", Intrinsic::Cos),
    numeric("TAN", Intrinsic::Tan),
    numeric("ASIN", Intrinsic::Asin),
    numeric("ACOS", Intrinsic::Acos),
    numeric("ATAN", Intrinsic::Atan),
    fixed("ATAN2", &["Y", "X"], &[REAL, REAL], Make::Intrinsic(Intrinsic::Atan2)),
    operator("ADD", BinaryOperator::Add),
    operator("MUL", BinaryOperator::Multiply),
    pair("SUB", BinaryOperator::Subtract),
    pair("DIV", BinaryOperator::Divide),
    pair("MOD", BinaryOperator::Modulo),
    fixed("EXPT", TWO, &[NUMBER, NUMBER], Make::Power),
    fixed("MOVE", IN, &[ANY], Make::Move),
    fixed("TRUNC", IN, &[REAL], Make::Truncate),
    operator("AND", BinaryOperator::And),
    operator("OR", BinaryOperator::Or),
    operator("XOR", BinaryOperator::Xor),
    shift("SHL", Intrinsic::ShiftLeft),
    shift("SHR", Intrinsic::ShiftRight),
    shift("ROL", Intrinsic::RotateLeft),
    shift("ROR", Intrinsic::RotateRight),
    fixed("SEL", &["G", "IN0", "IN1"], &[Parameter::Bool, ANY, ANY], Make::Select),
    extensible("MAX", TWO, &[ORDERED, ORDERED], Make::Fold(Intrinsic::Max)),
    extensible("MIN", TWO, &[ORDERED, ORDERED], Make::Fold(Intrinsic::Min)),
    fixed("LIMIT", &["MN", "IN", "MX"], &[ORDERED, ORDERED, ORDERED], Make::Limit),
    extensible("MUX", &["K", "IN0", "IN1"], &[INTEGER, ANY, ANY], Make::Multiplex),
    comparison("GT", BinaryOperator::Greater),
    comparison("GE", BinaryOperator::GreaterEqual),
    comparison("EQ", BinaryOperator::Equal),
    comparison("LE", BinaryOperator::LessEqual),
    comparison("LT", BinaryOperator::Less),
    fixed("NE", TWO, &[OPERANDS, OPERANDS], Make::Comparison(BinaryOperator::NotEqual)),
    fixed("LEN", IN, &[STRING], Make::Measure(Intrinsic::Length)),
    fixed("LEFT", &["IN", "L"], &[STRING, INTEGER], Make::Text(Intrinsic::Left)),
    fixed("RIGHT", &["IN", "L"], &[STRING, INTEGER], Make::Text(Intrinsic::Right)),
    fixed("MID", &["IN", "L", "P"], &[STRING, INTEGER, INTEGER], Make::Text(Intrinsic::Mid)),
    extensible("CONCAT", TWO, &[STRING, STRING], Make::Concatenate),
    fixed("FIND", TWO, &[STRING, STRING], Make::Measure(Intrinsic::Find)),
    fixed("LOG_LINE", IN, &[STRING], Make::LogLine),
    fixed("TAKT_UNIT_AT", &["IN", "P"], &[STRING, INTEGER], Make::Unit),
    fixed("RELEASE_TIME", &[], &[], Make::Clock(Intrinsic::Now, Elementary::Time)),
    fixed("RELEASE_INTERVAL", &[], &[], Make::Clock(Intrinsic::Elapsed, Elementary::Time)),
    fixed("RELEASE_COUNT", &[], &[], Make::Clock(Intrinsic::Cycle, Elementary::Ulint)),
];
