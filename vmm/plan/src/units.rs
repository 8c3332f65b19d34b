//! Durations and sizes as they are written in the file: a whole number and its unit.
//!
//! A bare number would be shorter, but the unit would then live in the documentation, and a factor
//! of a thousand in a schedule is not found by looking at it. Fractions are refused because every
//! one of them is a whole number of the next smaller unit, and `KB` because readers disagree on
//! how many bytes it has.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, Visitor};
use takt_scheduler::time::Nanos;
use thiserror::Error;

use super::diagnostic::quote;

const DURATION: &str =
    "a duration in quotes: a whole number and ns, us, ms or s, such as \"300us\"";
const GUARD: &str =
    "\"auto\", or a duration in quotes: a whole number and ns, us, ms or s, such as \"20us\"";
const SIZE: &str =
    "a size in quotes: a whole number and KiB, MiB or GiB (of 1024 bytes), such as \"64MiB\"";

/// Name and factor of each unit.
type Units = &'static [(&'static str, u64)];
const DURATION_UNITS: Units = &[("ns", 1), ("us", 1_000), ("ms", 1_000_000), ("s", 1_000_000_000)];
const SIZE_UNITS: Units = &[("KiB", 1 << 10), ("MiB", 1 << 20), ("GiB", 1 << 30)];

/// A duration of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Duration(pub Nanos);

/// A release guard as it is written: of a length, or one that follows the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guard {
    /// Always this long.
    Fixed(Nanos),
    /// `"auto"`.
    Auto,
}

/// A size of the file, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Bytes(pub u64);

/// Why a text is not a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum UnitError {
    /// Less than nothing.
    #[error("is negative")]
    Negative,
    /// No digits first.
    #[error("does not start with a whole number")]
    NoNumber,
    /// A decimal point.
    #[error("has a fraction: use the next smaller unit")]
    Fraction,
    /// Digits only.
    #[error("has no unit")]
    NoUnit,
    /// Digits only, where nothing else says that a duration is meant.
    #[error("has no unit: write ns, us, ms or s behind the number, such as 5s")]
    NoUnitOfTime,
    /// A space before the unit.
    #[error("has a space before its unit")]
    Space,
    /// A unit of something else.
    #[error("has an unknown unit")]
    UnknownUnit,
    /// KB and its like.
    #[error("has a unit that some take for 1000 and others for 1024")]
    DecimalUnit,
    /// Beyond 64 bits.
    #[error("is too large to be counted in 64 bits")]
    TooLarge,
}

fn parse(text: &str, units: Units) -> Result<u64, UnitError> {
    if text.starts_with(['-', '\u{2212}']) {
        return Err(UnitError::Negative);
    }
    let digits = text.bytes().take_while(u8::is_ascii_digit).count();
    let (number, unit) = text.split_at(digits);
    if number.is_empty() {
        return Err(UnitError::NoNumber);
    }
    let &(_, factor) = units.iter().find(|(name, _)| *name == unit).ok_or(match unit {
        "" => UnitError::NoUnit,
        "K" | "KB" | "kB" | "M" | "MB" | "G" | "GB" => UnitError::DecimalUnit,
        _ if unit.starts_with(['.', ',']) => UnitError::Fraction,
        _ if unit.starts_with(' ') => UnitError::Space,
        _ => UnitError::UnknownUnit,
    })?;
    // A number of digits only fails to parse when it does not fit.
    let number: u64 = number.parse().map_err(|_| UnitError::TooLarge)?;
    number.checked_mul(factor).ok_or(UnitError::TooLarge)
}

/// A duration that stands outside the file, such as on the command line.
///
/// # Errors
/// See [`UnitError`].
pub fn parse_duration(text: &str) -> Result<Nanos, UnitError> {
    parse(text, DURATION_UNITS).map(Nanos).map_err(|error| match error {
        UnitError::NoUnit => UnitError::NoUnitOfTime,
        error => error,
    })
}

/// Takes only a text, and words its errors as serde does: "found, expected this".
struct Quantity {
    units: Units,
    form: &'static str,
}

impl Visitor<'_> for Quantity {
    type Value = u64;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.form)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<u64, E> {
        parse(text, self.units)
            .map_err(|e| E::custom(format_args!("{} {e}, expected {}", quote(text), self.form)))
    }
}

impl<'de> Deserialize<'de> for Duration {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Duration, D::Error> {
        let quantity = Quantity { units: DURATION_UNITS, form: DURATION };
        from.deserialize_str(quantity).map(|n| Duration(Nanos(n)))
    }
}

struct GuardVisitor;

impl Visitor<'_> for GuardVisitor {
    type Value = Guard;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(GUARD)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<Guard, E> {
        if text == "auto" {
            return Ok(Guard::Auto);
        }
        let length = Quantity { units: DURATION_UNITS, form: GUARD }.visit_str(text)?;
        Ok(Guard::Fixed(Nanos(length)))
    }
}

impl<'de> Deserialize<'de> for Guard {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Guard, D::Error> {
        from.deserialize_str(GuardVisitor)
    }
}

impl<'de> Deserialize<'de> for Bytes {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Bytes, D::Error> {
        from.deserialize_str(Quantity { units: SIZE_UNITS, form: SIZE }).map(Bytes)
    }
}

/// Prints the largest unit that needs no fraction, as it may stand in the file: `4MiB`, `1028KiB`.
impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.0;
        let fits = |(_, factor): &&(&str, u64)| n != 0 && n.is_multiple_of(*factor);
        match SIZE_UNITS.iter().rev().find(fits) {
            Some((name, factor)) => f.pad(&format!("{}{name}", n / factor)),
            None => f.pad(&format!("{n} bytes")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_whole_numbers_of_a_known_unit() {
        assert_eq!(parse("300us", DURATION_UNITS), Ok(300_000));
        assert_eq!(parse("0us", DURATION_UNITS), Ok(0));
        assert_eq!(parse("1s", DURATION_UNITS), Ok(1_000_000_000));
        assert_eq!(parse("4MiB", SIZE_UNITS), Ok(4 << 20));
        assert_eq!(parse("18446744073709551615ns", DURATION_UNITS), Ok(u64::MAX));
    }

    #[test]
    fn each_way_to_get_it_wrong_has_its_own_name() {
        let duration = |text| parse(text, DURATION_UNITS).unwrap_err();
        assert_eq!(duration(""), UnitError::NoNumber);
        assert_eq!(duration("us"), UnitError::NoNumber);
        assert_eq!(duration("+1us"), UnitError::NoNumber);
        assert_eq!(duration("-1us"), UnitError::Negative);
        assert_eq!(duration("1.5ms"), UnitError::Fraction);
        assert_eq!(duration("100"), UnitError::NoUnit);
        assert_eq!(parse_duration("100"), Err(UnitError::NoUnitOfTime));
        assert_eq!(duration("100 us"), UnitError::Space);
        assert_eq!(duration("1\u{b5}s"), UnitError::UnknownUnit);
        assert_eq!(duration("18446744073709551616ns"), UnitError::TooLarge);
        assert_eq!(duration("18446744073709552s"), UnitError::TooLarge);
        assert_eq!(parse("4MB", SIZE_UNITS), Err(UnitError::DecimalUnit));
        assert_eq!(parse("4us", SIZE_UNITS), Err(UnitError::UnknownUnit));
    }

    #[test]
    fn sizes_print_as_they_may_be_written() {
        assert_eq!(Bytes(4 << 20).to_string(), "4MiB");
        assert_eq!(Bytes((1 << 20) + 4096).to_string(), "1028KiB");
        assert_eq!(Bytes(64 << 30).to_string(), "64GiB");
        assert_eq!(Bytes(0).to_string(), "0 bytes");
    }
}
