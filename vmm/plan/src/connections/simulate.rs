//! Simulated inputs: a value that is constant or repeats, in place of a sensor.

use takt_abi::io::{Mapping, WHOLE, kind};
use takt_program::Elementary;
use takt_scheduler::time::Nanos;
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, quote};
use super::super::raw::{self, Keys};
use super::point::Point;
use super::{Place, is_bool};

/// Longest time after which a value repeats.
const PERIOD_MAX: Nanos = Nanos::from_millis(86_400_000);

/// Checks what an input is to be.
pub fn check(
    table: &Spanned<Keys<raw::Simulate>>,
    point: &Point,
    mapping: Mapping,
) -> Result<Place, Diagnostic> {
    let Keys(raw) = table.get_ref();
    if !is_number(point) {
        let found = format!("{} is neither a number nor a BOOL", quote(&point.name));
        let allowed =
            "an input of an elementary type that is a number, a bit string, a TIME or a BOOL";
        return Err(Diagnostic::new(table.span(), found, allowed));
    }
    let kind = match raw.shape.get_ref().as_str() {
        "constant" => return constant(raw, table, mapping),
        "ramp" => kind::RAMP,
        "sine" => kind::SINE,
        "square" => kind::SQUARE,
        other => {
            let found = format!("there is no shape {}", quote(other));
            let allowed = "\"constant\", \"ramp\", \"sine\" or \"square\"";
            return Err(Diagnostic::new(raw.shape.span(), found, allowed));
        }
    };
    if let Some(value) = &raw.value {
        let found = format!("`value` does not belong to the shape {}", quote(raw.shape.get_ref()));
        return Err(Diagnostic::new(value.span(), found, "`low`, `high` and `period`"));
    }
    let (low, high) = match (&raw.low, &raw.high) {
        (None, None) if is_bool(point) => (0.0, 1.0),
        (Some(low), Some(high)) => limits(low, high)?,
        _ => {
            let found = format!("the shape {} lacks a key", quote(raw.shape.get_ref()));
            let allowed = "`low` and `high`, which only a BOOL does not need";
            return Err(Diagnostic::new(table.span(), found, allowed));
        }
    };
    let allowed = format!("`period = \"10s\"`, more than nothing and at most {PERIOD_MAX}");
    let Some(period) = &raw.period else {
        let found = format!("the shape {} has no `period`", quote(raw.shape.get_ref()));
        return Err(Diagnostic::new(table.span(), found, allowed));
    };
    let length = period.get_ref().0;
    if length == Nanos::ZERO || length > PERIOD_MAX {
        let found = format!("a value cannot repeat each {length}");
        return Err(Diagnostic::new(period.span(), found, allowed));
    }
    let words = format!("simulated: {} from {low} to {high} each {length}", raw.shape.get_ref());
    Ok(simulated(mapping, kind, [low, high], length.0, words))
}

fn constant(
    raw: &raw::Simulate,
    table: &Spanned<Keys<raw::Simulate>>,
    mapping: Mapping,
) -> Result<Place, Diagnostic> {
    let others = [
        ("low", raw.low.as_ref().map(Spanned::span)),
        ("high", raw.high.as_ref().map(Spanned::span)),
        ("period", raw.period.as_ref().map(Spanned::span)),
    ];
    for (key, span) in others {
        if let Some(span) = span {
            let found = format!("`{key}` does not belong to the shape \"constant\"");
            return Err(Diagnostic::new(span, found, "`value`"));
        }
    }
    let Some(value) = &raw.value else {
        let found = "the shape \"constant\" has no `value`";
        return Err(Diagnostic::new(table.span(), found, "`value = 1.5`"));
    };
    let value = finite(value)?;
    let words = format!("simulated: {value}");
    Ok(simulated(mapping, kind::CONSTANT, [value, value], 0, words))
}

fn simulated(
    mapping: Mapping,
    kind: u8,
    [low, high]: [f64; 2],
    period_ns: u64,
    words: String,
) -> Place {
    let (low, high) = (low.to_bits(), high.to_bits());
    let mapping = Mapping { kind, place: low, high, period_ns, place_bit: WHOLE, ..mapping };
    Place { mapping, words }
}

/// Both ends of a shape. The kernel computes with their distance.
fn limits(low: &Spanned<f64>, high: &Spanned<f64>) -> Result<(f64, f64), Diagnostic> {
    let (from, to) = (finite(low)?, finite(high)?);
    if (to - from).is_finite() {
        return Ok((from, to));
    }
    let found = format!("from {from:e} to {to:e} is further than a number can say");
    let allowed = format!("`low` and `high` that are at most {:e} apart", f64::MAX);
    Err(Diagnostic::new(high.span(), found, allowed).and(low.span(), "from here"))
}

fn finite(value: &Spanned<f64>) -> Result<f64, Diagnostic> {
    let number = *value.get_ref();
    if number.is_finite() {
        return Ok(number);
    }
    let found = format!("{number} is no value of a point");
    Err(Diagnostic::new(value.span(), found, "a finite number"))
}

fn is_number(point: &Point) -> bool {
    use Elementary::{Char, Date, Dt, Ldate, Ldt, Ltod, Tod, Wchar};
    let other = [Char, Wchar, Date, Ldate, Tod, Ltod, Dt, Ldt];
    point.ty.is_some_and(|ty| !other.contains(&ty))
}
