//! Values of a program: found by a path, read and written, and from text.

pub use takt_points::Value;
use takt_points::is_signed;
use takt_program::{Area, Elementary, Image, Type, TypeId, TypeKind, Variable};
use takt_st::syntax::ast::LiteralValue;
use takt_st::syntax::literal;

use crate::run::Machine;

/// Where a value lies, and what it is.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Of the variable that it is, or is a part of.
    pub area: Area,
    address: u64,
    bit: Option<u8>,
    elementary: Elementary,
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
        Ok(Self { area: variable.area, address: at, bit: variable.bit, elementary })
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
        parse(self.elementary, text)
    }
}

/// A value of this type, from text.
pub fn parse(elementary: Elementary, text: &str) -> Result<Value, String> {
    let bits = 8 * elementary.bytes();
    let (found, keyword) = (text, elementary.keyword());
    match elementary {
        Elementary::Bool => match text.to_ascii_lowercase().as_str() {
            "0" | "false" => Ok(Value::Bool(false)),
            "1" | "true" => Ok(Value::Bool(true)),
            _ => Err(format!("found `{found}`; a BOOL is 0, 1, FALSE or TRUE")),
        },
        Elementary::Real | Elementary::Lreal => {
            // A REAL is read as one: read as an LREAL first, it would be rounded twice.
            let number = match elementary {
                Elementary::Real => text.parse::<f32>().map(f64::from),
                _ => text.parse(),
            };
            let number = number.map_err(|_| format!("found `{found}`, which is no number"))?;
            if number.is_infinite() && text.contains(|c: char| c.is_ascii_digit()) {
                return Err(format!("found `{found}`, which is too large for {keyword}"));
            }
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
            let (digits, radix) = hex.map_or((text, 10), |hex| (hex, 16));
            // A plus is a sign of a decimal number only.
            let number = Some(digits).filter(|digits| radix == 10 || !digits.starts_with('+'));
            let number = number.and_then(|digits| u64::from_str_radix(digits, radix).ok());
            let number = number.filter(|number| *number <= most);
            let number =
                number.ok_or_else(|| format!("found `{found}`; {keyword} is 0 to {most}"))?;
            Ok(Value::Unsigned(number))
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
