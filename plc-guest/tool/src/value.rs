//! Values of a program as text: found by a path, read, written and compared.

use std::fmt;

use takt_program::{Elementary, Image, Nanoseconds, Type, TypeId, TypeKind, Variable};
use takt_st::syntax::ast::LiteralValue;
use takt_st::syntax::literal;

use crate::run::Machine;

/// Where a value lies, and what it is.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    address: u64,
    bit: Option<u8>,
    elementary: Elementary,
}

/// A value.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub enum Value {
    Bool(bool),
    Signed(i64),
    Unsigned(u64),
    Float(f64),
    /// In nanoseconds.
    Duration(i64),
}

/// Why there is no such value.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlaceError {
    #[error("the program has no point `{0}`; `takt plc inspect` lists them")]
    Unknown(String),
    #[error("`{0}` has no part `{1}`")]
    NoPart(String, String),
    #[error("`{0}` is {1}; a column is one value")]
    NotSimple(String, &'static str),
}

impl Place {
    /// The value of this name: a variable, or a part of one such as `mix.row[2]`.
    pub fn find(image: &Image<'_>, name: &str) -> Result<Self, PlaceError> {
        let (variable, rest) =
            longest(image, name).ok_or_else(|| PlaceError::Unknown(name.into()))?;
        let mut at = variable.address(image);
        let mut ty = image.type_of(variable.ty);
        let mut rest = rest;
        while !rest.is_empty() {
            let part = ty.as_ref().and_then(|ty| part(image, ty, rest));
            let Some((offset, of, left)) = part else {
                return Err(PlaceError::NoPart(name.into(), rest.into()));
            };
            (at, ty, rest) = (at + offset, image.type_of(of), left);
        }
        let elementary = match ty.map(|ty| ty.kind) {
            Some(TypeKind::Elementary(elementary)) => elementary,
            Some(TypeKind::Enumeration { base } | TypeKind::Subrange { base, .. }) => base,
            Some(TypeKind::String { .. } | TypeKind::WString { .. }) => {
                return Err(PlaceError::NotSimple(name.into(), "a text"));
            }
            Some(TypeKind::Reference { .. }) => {
                return Err(PlaceError::NotSimple(name.into(), "a reference"));
            }
            _ => return Err(PlaceError::NotSimple(name.into(), "an array or structure")),
        };
        Ok(Self { address: at, bit: variable.bit, elementary })
    }

    /// The value now. There is always one, unless the program's memory is not what its image says.
    pub fn get(&self, machine: &Machine<'_>) -> Option<Value> {
        let found = machine.get(self.address, self.elementary.bytes().into())?;
        let mut bytes = [0; 8];
        bytes.get_mut(..found.len())?.copy_from_slice(&found);
        Some(Value::from_raw(self.elementary, self.bit, u64::from_le_bytes(bytes)))
    }

    /// Sets the value.
    pub fn put(&self, machine: &Machine<'_>, value: Value) {
        let bits = match (value, self.bit) {
            (Value::Bool(on), Some(bit)) => {
                let Some(old) = machine.get(self.address, 1) else { return };
                let mask = 1 << bit;
                u64::from(if on { old[0] | mask } else { old[0] & !mask })
            }
            _ => value.raw(self.elementary),
        };
        machine.put(self.address, &bits.to_le_bytes()[..self.elementary.bytes() as usize]);
    }

    /// A value of this place's type, from text.
    pub fn parse(&self, text: &str) -> Result<Value, String> {
        Value::parse(self.elementary, text)
    }
}

impl Value {
    /// The value in these little-endian bytes; of a bit, in its place there.
    pub fn from_raw(elementary: Elementary, bit: Option<u8>, raw: u64) -> Self {
        let unused = 64 - 8 * elementary.bytes();
        let raw = raw << unused >> unused;
        match elementary {
            Elementary::Bool => Value::Bool(raw >> bit.unwrap_or(0) & 1 == 1),
            Elementary::Real => Value::Float(f32::from_bits(raw as u32).into()),
            Elementary::Lreal => Value::Float(f64::from_bits(raw)),
            Elementary::Time | Elementary::Ltime => Value::Duration(raw.cast_signed()),
            _ if is_signed(elementary) => Value::Signed((raw << unused).cast_signed() >> unused),
            _ => Value::Unsigned(raw),
        }
    }

    /// The little-endian bytes of the value; of a bit, 0 or 1.
    pub fn raw(self, elementary: Elementary) -> u64 {
        match (self, elementary) {
            (Value::Bool(on), _) => on.into(),
            (Value::Float(number), Elementary::Real) => (number as f32).to_bits().into(),
            (Value::Float(number), _) => number.to_bits(),
            (Value::Signed(number) | Value::Duration(number), _) => number.cast_unsigned(),
            (Value::Unsigned(number), _) => number,
        }
    }

    /// A value of this type, from text.
    pub fn parse(elementary: Elementary, text: &str) -> Result<Self, String> {
        let bits = 8 * elementary.bytes();
        let (found, keyword) = (text, elementary.keyword());
        match elementary {
            Elementary::Bool => match text.to_ascii_lowercase().as_str() {
                "0" | "false" => Ok(Value::Bool(false)),
                "1" | "true" => Ok(Value::Bool(true)),
                _ => Err(format!("found `{found}`; a BOOL is 0, 1, FALSE or TRUE")),
            },
            Elementary::Real | Elementary::Lreal => {
                let number =
                    text.parse().map_err(|_| format!("found `{found}`, which is no number"))?;
                Ok(Value::Float(number))
            }
            Elementary::Time | Elementary::Ltime => duration(text),
            _ if is_signed(elementary) => {
                let most = i64::MAX >> (64 - bits);
                let number = text.parse().ok().filter(|n| (!most..=most).contains(n));
                let number = number
                    .ok_or_else(|| format!("found `{found}`; {keyword} is {} to {most}", !most))?;
                Ok(Value::Signed(number))
            }
            _ => {
                let most = u64::MAX >> (64 - bits);
                let hex = text.strip_prefix("16#").or_else(|| text.strip_prefix("0x"));
                let number = hex.map_or_else(|| text.parse(), |hex| u64::from_str_radix(hex, 16));
                let number = number.ok().filter(|number| *number <= most);
                let number =
                    number.ok_or_else(|| format!("found `{found}`; {keyword} is 0 to {most}"))?;
                Ok(Value::Unsigned(number))
            }
        }
    }

    /// Whether it is a `BOOL` that is true.
    pub fn is_true(self) -> bool {
        self == Self::Bool(true)
    }

    /// Whether `found` is this value, give or take `tolerance`. Floating-point numbers are equal if they print the same
    /// with seven digits when no tolerance is given, since a table has no more.
    pub fn accepts(self, found: Self, tolerance: Option<f64>) -> bool {
        match (self, found, tolerance) {
            (Self::Float(want), Self::Float(is), None) => {
                want == is
                    || (want.is_nan() && is.is_nan())
                    || (want - is).abs() <= 5e-7 * want.abs()
            }
            (want, is, None) => want == is,
            (want, is, Some(tolerance)) => match (want.integer(), is.integer()) {
                // Numbers of 64 bits would lose digits as floating-point ones.
                (Some(want), Some(is)) => want.abs_diff(is) as f64 <= tolerance,
                _ => (want.number() - is.number()).abs() <= tolerance,
            },
        }
    }

    fn integer(self) -> Option<i128> {
        match self {
            Self::Bool(on) => Some(on.into()),
            Self::Signed(number) | Self::Duration(number) => Some(number.into()),
            Self::Unsigned(number) => Some(number.into()),
            Self::Float(_) => None,
        }
    }

    fn number(self) -> f64 {
        match self {
            Self::Bool(on) => on.into(),
            Self::Signed(number) | Self::Duration(number) => number as f64,
            Self::Unsigned(number) => number as f64,
            Self::Float(number) => number,
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(on) => write!(f, "{}", u8::from(*on)),
            Self::Signed(number) => write!(f, "{number}"),
            Self::Unsigned(number) => write!(f, "{number}"),
            Self::Float(number) => write!(f, "{number}"),
            Self::Duration(number) => {
                let sign = if *number < 0 { "-" } else { "" };
                let shown = Nanoseconds(number.unsigned_abs()).to_string().replace(' ', "");
                write!(f, "T#{sign}{shown}")
            }
        }
    }
}

/// A duration: as in Structured Text, or a number of nanoseconds.
fn duration(text: &str) -> Result<Value, String> {
    let prefix = text.split_once('#').map(|(prefix, _)| prefix.to_ascii_uppercase());
    let nanoseconds = match prefix.as_deref() {
        Some("T" | "TIME" | "LT" | "LTIME") => match literal::duration(text) {
            Ok(LiteralValue::Duration { nanoseconds, .. }) => Some(nanoseconds),
            _ => None,
        },
        _ => text.parse().ok(),
    };
    let allowed = "a duration is T#1.5s, T#250ms and so on, or a number of nanoseconds";
    nanoseconds.map(Value::Duration).ok_or_else(|| format!("found `{text}`; {allowed}"))
}

fn is_signed(elementary: Elementary) -> bool {
    use Elementary as E;
    matches!(elementary, E::Sint | E::Int | E::Dint | E::Lint | E::Date | E::Ldate | E::Dt | E::Ldt)
}

/// The variable whose name is the longest beginning of `name`, and the rest.
fn longest<'a, 'n>(image: &Image<'a>, name: &'n str) -> Option<(Variable<'a>, &'n str)> {
    let ends = name.char_indices().rev().filter(|(_, c)| ".[".contains(*c)).map(|(at, _)| at);
    std::iter::once(name.len())
        .chain(ends)
        .find_map(|end| Some((image.variable(&name[..end])?, &name[end..])))
}

/// The first part of `path` (`.field` or `[index]`) in a value of this type: its offset, its type, and the rest of the
/// path.
fn part<'n>(image: &Image<'_>, ty: &Type<'_>, path: &'n str) -> Option<(u64, TypeId, &'n str)> {
    if let Some(path) = path.strip_prefix('.') {
        let end = path.find(['.', '[']).unwrap_or(path.len());
        let field = image.fields(ty).find(|field| field.name.eq_ignore_ascii_case(&path[..end]))?;
        return Some((field.offset.into(), field.ty, &path[end..]));
    }
    let (index, rest) = path.strip_prefix('[')?.split_once(']')?;
    let TypeKind::Array { element, lower, upper } = ty.kind else { return None };
    let index: i64 = index.trim().parse().ok().filter(|index| (lower..=upper).contains(index))?;
    let bytes = image.type_of(element)?.bytes;
    Some((index.abs_diff(lower) * u64::from(bytes), element, rest))
}
