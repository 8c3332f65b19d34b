//! A value of an elementary type: from bytes, to bytes, and as text.

use std::fmt;

use takt_program::{Elementary, Nanoseconds};

/// A value.
#[derive(Clone, Copy, Debug, PartialEq, PartialOrd)]
pub enum Value {
    /// A `BOOL`.
    Bool(bool),
    /// An integer with a sign, or a date.
    Signed(i64),
    /// An integer without one, a bit string, or a time of day.
    Unsigned(u64),
    /// A `REAL` or `LREAL`.
    Float(f64),
    /// In nanoseconds.
    Duration(i64),
}

impl Value {
    /// The value in these little-endian bytes; of a bit, in its place there.
    #[must_use]
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
    #[must_use]
    pub fn raw(self, elementary: Elementary) -> u64 {
        match (self, elementary) {
            (Value::Bool(on), _) => on.into(),
            (Value::Float(number), Elementary::Real) => (number as f32).to_bits().into(),
            (Value::Float(number), _) => number.to_bits(),
            (Value::Signed(number) | Value::Duration(number), _) => number.cast_unsigned(),
            (Value::Unsigned(number), _) => number,
        }
    }

    /// Whether it is a `BOOL` that is true.
    #[must_use]
    pub fn is_true(self) -> bool {
        self == Self::Bool(true)
    }

    /// Whether `found` is this value, give or take `tolerance`. Floating-point numbers are equal if they print the same
    /// with seven digits when no tolerance is given, since a table has no more.
    #[must_use]
    pub fn accepts(self, found: Self, tolerance: Option<f64>) -> bool {
        if let (Self::Float(want), Self::Float(is)) = (self, found)
            && !(want.is_finite() && is.is_finite())
        {
            // No tolerance has a meaning here: every finite number is within infinity of infinity.
            return want == is || (want.is_nan() && is.is_nan());
        }
        match (self, found, tolerance) {
            (Self::Float(want), Self::Float(is), None) => (want - is).abs() <= 5e-7 * want.abs(),
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
            Self::Float(number) => write!(f, "{}", digits(*number)),
            Self::Duration(number) => {
                let sign = if *number < 0 { "-" } else { "" };
                let shown = Nanoseconds(number.unsigned_abs()).to_string().replace(' ', "");
                write!(f, "T#{sign}{shown}")
            }
        }
    }
}

/// The fewest digits that give exactly this `REAL` or `LREAL` again. A very large or small one has an exponent: its
/// zeros would be hundreds of characters, more than an order to Takt has room for.
#[must_use]
pub fn digits<F: Copy + Into<f64> + fmt::Display + fmt::LowerExp>(number: F) -> String {
    let size = number.into().abs();
    let plain = size == 0.0 || !size.is_finite() || (1e-5..1e16).contains(&size);
    if plain { number.to_string() } else { format!("{number:e}") }
}

/// Whether its numbers have a sign.
#[must_use]
pub fn is_signed(elementary: Elementary) -> bool {
    use Elementary as E;
    matches!(elementary, E::Sint | E::Int | E::Dint | E::Lint | E::Date | E::Ldate | E::Dt | E::Ldt)
}

#[cfg(test)]
mod tests {
    use super::Value;

    #[test]
    fn infinity_and_no_number_are_only_themselves() {
        let all = [0.0, 2.0, f64::MAX, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
        for (i, want) in all.into_iter().enumerate() {
            for (k, found) in all.into_iter().enumerate() {
                for tolerance in [None, Some(0.5)] {
                    let accepts = Value::Float(want).accepts(Value::Float(found), tolerance);
                    assert_eq!(accepts, i == k, "{want} {found} {tolerance:?}");
                }
            }
        }
        assert!(Value::Float(1.0).accepts(Value::Float(1.000_000_4), None));
        assert!(!Value::Float(1.0).accepts(Value::Float(1.000_001), None));
        assert!(Value::Float(1.0).accepts(Value::Float(1.4), Some(0.5)));
    }
}
