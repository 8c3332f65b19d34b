//! Conversions: `REAL_TO_INT`, `TO_INT`, `REAL_TRUNC_INT` (IEC 61131-3:2013, tables 22 to 27).
//!
//! Those from and to strings are functions of the library; `TO_STRING(x)` is the one for the type of
//! `x`. TIME and dates become LINT and back in nanoseconds, which is Takt's own.

use crate::check::Entry;
use crate::check::body::Body;
use crate::check::expression::Operand;
use crate::check::names::elementary;
use crate::check::types::{is_bit_string, is_date, is_duration, is_integer, is_real};
use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{
    Argument as HirArgument, Arithmetic, Conversion, Elementary, Expr, ExprKind, Intrinsic, Type,
};
use crate::source::Span;
use crate::syntax::ast::{Argument, Name};

/// The nanoseconds of a day.
const DAY: i128 = 86_400_000_000_000;

/// How far before 1970 the first whole day of DT begins, in nanoseconds.
const FIRST_DAY: i128 = (1 << 63) / DAY * DAY;

/// How a value becomes one of another type.
enum Way {
    Node(Conversion),
    /// The start of the day.
    Date,
    /// What is left of the day.
    Clock,
}

impl<'a> Body<'_, 'a> {
    /// None if the name is of no conversion.
    #[allow(clippy::option_option)]
    pub(super) fn conversion_call(
        &mut self,
        name: &'a Name,
        arguments: &'a [Argument],
        span: Span,
    ) -> Option<Option<Operand>> {
        let library = binary_coded(&name.key);
        let (from, to, truncates) = match library {
            Some(_) => (None, Target::String, false),
            None => parse(&name.key)?,
        };
        let value = match arguments {
            [Argument { name: None, value: Some(value), .. }] => Some(value),
            [Argument { name: Some((formal, _)), value: Some(value), .. }]
                if &*formal.key == "IN" =>
            {
                Some(value)
            }
            _ => None,
        };
        let Some(value) = value else {
            let found = format!("{} arguments for `{}`", arguments.len(), name.text);
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            self.tell(one.allowed(format!("{}(IN)", name.text)));
            return Some(None);
        };
        let operand = match from {
            Some(from) => {
                let ty = self.elementary(from);
                self.value_of(value, ty).map(Operand::typed)
            }
            None => self.operand(value, None),
        };
        let Some(operand) = operand else { return Some(None) };
        let operand = self.without_subrange(operand, value.span);
        if let Some(key) = library {
            return Some(self.call_of_library(key, operand, name, span));
        }
        let Target::Elementary(to) = to else {
            return Some(self.by_library(to, operand, name, span));
        };
        Some(self.conversion(operand, to, truncates, name, span))
    }

    fn conversion(
        &mut self,
        operand: Operand,
        to: Elementary,
        truncates: bool,
        name: &Name,
        span: Span,
    ) -> Option<Operand> {
        let from = operand.expr.ty;
        let ty = self.elementary(to);
        let types = &self.checker.program.types;
        let scalar = match types.get(from) {
            Type::Reference { .. } => None,
            Type::String { .. } | Type::WString { .. } => {
                return self.by_library(Target::Elementary(to), operand, name, span);
            }
            _ => types.scalar(from),
        };
        let Some(way) = scalar.and_then(|from| way(from, to, truncates)) else {
            let found = format!("`{}` of {}", name.text, self.type_name(from));
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            let one = one.allowed("a conversion of the standard's tables 22 to 27");
            let is_time = |ty| is_duration(ty) || is_date(ty);
            let is_number = |ty| is_integer(ty) || is_real(ty);
            let hinted = match scalar {
                Some(from) if is_time(from) && is_number(to) || is_number(from) && is_time(to) => {
                    let (from, to) = (from.name(), to.name());
                    one.hint(format!("by nanoseconds: `LINT_TO_{to}({from}_TO_LINT(...))`"))
                }
                _ => one,
            };
            self.tell(hinted);
            return None;
        };
        Some(Operand::typed(match way {
            Way::Node(conversion) => self.convert(conversion, operand.expr, ty, span),
            Way::Date => {
                // Counted from the first whole day, without a sign: so a time before 1970 is rounded down too. The minutes
                // before that day have none that could be told.
                let unsigned = self.elementary(Elementary::Ulint);
                let least = self.integer(operand.expr.ty, -FIRST_DAY, span);
                let from = operand.expr.ty;
                let time = self.intrinsic(Intrinsic::Max, vec![operand.expr, least], from, span);
                let moved = self.with_number(Arithmetic::Add, time.expr, FIRST_DAY, span);
                let moved = self.convert(Conversion::Value, moved, unsigned, span);
                let days = self.with_number(Arithmetic::Divide, moved, DAY, span);
                let start = self.with_number(Arithmetic::Multiply, days, DAY, span);
                let start = self.with_number(Arithmetic::Subtract, start, FIRST_DAY, span);
                self.convert(Conversion::Value, start, ty, span)
            }
            Way::Clock => {
                // Of a time before 1970 the rest is not above zero: it is taken from a day.
                let rest = self.with_number(Arithmetic::Modulo, operand.expr, DAY, span);
                let rest = self.with_number(Arithmetic::Add, rest, DAY, span);
                let rest = self.with_number(Arithmetic::Modulo, rest, DAY, span);
                self.convert(Conversion::Value, rest, ty, span)
            }
        }))
    }

    /// An operation of an expression and a number of its type.
    fn with_number(&self, operation: Arithmetic, left: Expr, number: i128, span: Span) -> Expr {
        let ty = left.ty;
        let right = Box::new(self.integer(ty, number, span));
        self.expr(ty, ExprKind::Arithmetic(operation, Box::new(left), right), span)
    }

    /// A conversion from or to a string: the library's function of the name with both types.
    fn by_library(
        &mut self,
        to: Target,
        operand: Operand,
        name: &Name,
        span: Span,
    ) -> Option<Operand> {
        let from = match self.checker.program.types.get(operand.expr.ty) {
            Type::String { .. } => "STRING",
            Type::WString { .. } => "WSTRING",
            Type::Elementary(elementary) => elementary.name(),
            _ => "",
        };
        self.call_of_library(&format!("{from}_TO_{}", to.name()), operand, name, span)
    }

    /// A call of the library's function of this name with one argument.
    fn call_of_library(
        &mut self,
        key: &str,
        operand: Operand,
        name: &Name,
        span: Span,
    ) -> Option<Operand> {
        let unit = match self.checker.names.get(key) {
            Some(Entry::Units(units)) if units.len() == 1 => Some(units[0]),
            _ => None,
        };
        let parameter = unit.and_then(|unit| {
            self.checker.declare_unit(unit, span, false)?;
            let entry = &self.checker.units[unit];
            match entry.parameters[..] {
                [only] => entry.variables[only].ty.zip(entry.result.map(|(_, ty)| ty)),
                _ => None,
            }
        });
        let (Some(unit), Some((parameter, result))) = (unit, parameter) else {
            let found = format!("`{}` of {}", name.text, self.type_name(operand.expr.ty));
            let one = Diagnostic::new(Code::WrongArguments, span, found);
            self.tell(one.hint(format!("there is no function `{key}`")));
            return None;
        };
        let value = self.converted(operand, parameter, span)?;
        self.note_call(unit, span);
        let routine = self.checker.units[unit].routine?;
        let kind = ExprKind::Call(routine, vec![HirArgument::Value(value)]);
        Some(Operand::typed(self.expr(result, kind, span)))
    }
}

/// The library's function that an overloaded conversion of binary coded decimals calls: the other type follows from the
/// size, and a shorter one is widened.
pub(super) fn binary_coded(key: &str) -> Option<&'static str> {
    Some(match key {
        "BCD_TO_USINT" => "BYTE_BCD_TO_USINT",
        "BCD_TO_UINT" => "WORD_BCD_TO_UINT",
        "BCD_TO_UDINT" => "DWORD_BCD_TO_UDINT",
        "BCD_TO_ULINT" => "LWORD_BCD_TO_ULINT",
        "TO_BCD_BYTE" => "USINT_TO_BCD_BYTE",
        "TO_BCD_WORD" => "UINT_TO_BCD_WORD",
        "TO_BCD_DWORD" => "UDINT_TO_BCD_DWORD",
        "TO_BCD_LWORD" => "ULINT_TO_BCD_LWORD",
        _ => return None,
    })
}

/// What a conversion gives.
#[derive(Clone, Copy)]
pub(super) enum Target {
    Elementary(Elementary),
    String,
    WString,
}

impl Target {
    fn name(self) -> &'static str {
        match self {
            Self::Elementary(elementary) => elementary.name(),
            Self::String => "STRING",
            Self::WString => "WSTRING",
        }
    }
}

/// The types in the name of a conversion, and whether it cuts off the fraction.
pub(super) fn parse(key: &str) -> Option<(Option<Elementary>, Target, bool)> {
    let target = |name: &str| match name {
        "STRING" => Some(Target::String),
        "WSTRING" => Some(Target::WString),
        _ => elementary(name).map(Target::Elementary),
    };
    if let Some(to) = key.strip_prefix("TO_") {
        return Some((None, target(to)?, false));
    }
    if let Some(to) = key.strip_prefix("TRUNC_") {
        return Some((None, target(to)?, true));
    }
    let (from, to, truncates) = match key.split_once("_TRUNC_") {
        Some((from, to)) => (from, to, true),
        // The last one: `LTIME_OF_DAY_TO_TOD` has no other, `STRING_TO_...` is the library's.
        None => {
            let (from, to) = key.rsplit_once("_TO_")?;
            (from, to, false)
        }
    };
    let to = target(to)?;
    if matches!(from, "STRING" | "WSTRING") {
        return Some((None, to, truncates));
    }
    Some((Some(elementary(from)?), to, truncates))
}

fn way(from: Elementary, to: Elementary, truncates: bool) -> Option<Way> {
    use Elementary::{Char, Date, Dt, Ldate, Ldt, Lint, Ltod, Tod, Wchar};
    let value = Some(Way::Node(Conversion::Value));
    let plain = |one: Elementary| is_integer(one) || is_bit_string(one);
    if truncates {
        let fits = is_real(from) && is_integer(to);
        return fits.then_some(Way::Node(Conversion::Truncate));
    }
    if from == to {
        return value;
    }
    match (from, to) {
        // The same bits (table 24).
        (a, b) if is_real(a) && is_bit_string(b) && a.size() == b.size() => {
            Some(Way::Node(Conversion::Bits))
        }
        (a, b) if is_bit_string(a) && is_real(b) && a.size() == b.size() => {
            Some(Way::Node(Conversion::Bits))
        }
        (a, b) if is_real(a) && (is_real(b) || is_integer(b)) => value,
        (a, b) if is_real(b) && is_integer(a) => value,
        (a, b) if is_real(a) && b == Elementary::Bool || is_real(b) && a == Elementary::Bool => {
            value
        }
        (a, b) if plain(a) && plain(b) => value,
        (Char, Wchar) | (Wchar, Char) => value,
        (Char | Wchar, b) if plain(b) => value,
        (a, Char | Wchar) if plain(a) => value,
        (a, b) if is_duration(a) && is_duration(b) => value,
        (a, Lint) if is_duration(a) || is_date(a) => value,
        (Lint, b) if is_duration(b) || is_date(b) => value,
        (Date, Ldate) | (Ldate, Date) | (Tod, Ltod) | (Ltod, Tod) | (Dt, Ldt) | (Ldt, Dt) => value,
        (Dt | Ldt, Date | Ldate) => Some(Way::Date),
        (Dt | Ldt, Tod | Ltod) => Some(Way::Clock),
        _ => None,
    }
}
