//! CAN objects: an identifier on a bus, and where in its data a point lies.
//!
//! Several tables have one object, each with a field of it. Until all of them are known an object is a number made of its
//! controller and its identifier; then the objects are numbered as the guest has them.

use takt_abi::can::{DATA_MAX, EXTENDED, OBJECTS_MAX, ON_CHANGE, Object};
use takt_abi::io::{INPUT, Mapping, kind};
use takt_program::Elementary;
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span, quote};
use super::super::passthrough::check_hex;
use super::super::raw;
use super::place::{Bytes, bit_words, field, is_time};
use super::point::Point;
use super::{Around, Entry, Place};

/// Largest identifiers of 11 and of 29 bits.
const STANDARD_MAX: u64 = 0x7ff;
const EXTENDED_MAX: u64 = 0x1fff_ffff;

/// True if the place is a CAN object.
pub const fn is_can(m: &Mapping) -> bool {
    matches!(m.kind, kind::CAN | kind::CAN_AGE | kind::CAN_COUNT)
}

/// The place of a point in an object.
pub fn check(
    raw: &raw::Io,
    name: &Spanned<String>,
    header: &Span,
    point: &Point,
    mapping: Mapping,
    around: Around<'_>,
) -> Result<Place, Diagnostic> {
    let Some(bus) = around.buses.iter().position(|bus| bus.name == *name.get_ref()) else {
        let found = format!("the partition has no CAN controller {}", quote(name.get_ref()));
        let names: Vec<String> = around.buses.iter().map(|bus| quote(&bus.name)).collect();
        let allowed = match &names[..] {
            [] => "the name of a [[partition.can]] of the same partition".to_owned(),
            names => names.join(", "),
        };
        return Err(Diagnostic::new(name.span(), found, allowed));
    };
    let (identifier, id) = identifier(raw, header)?;
    let input = mapping.direction == INPUT;
    if let Some(send) = raw.send.as_ref().filter(|_| input) {
        let found = format!("`send` is about outputs, and {} is an input", quote(&point.name));
        return Err(Diagnostic::new(send.span(), found, "`send` for an output"));
    }
    let mapping = Mapping { place: (bus as u64) << 32 | u64::from(identifier), ..mapping };
    let wanted = |flag: &Option<Spanned<bool>>| {
        flag.as_ref().filter(|flag| *flag.get_ref()).map(Spanned::span)
    };
    let of = format!("CAN {}, object {id}", name.get_ref());
    match (&raw.byte, wanted(&raw.age), wanted(&raw.count)) {
        (Some(byte), None, None) => {
            let data = Bytes {
                called: "the data of a frame",
                count: DATA_MAX as u32,
                of: (name.span(), "the controller"),
            };
            let (field, place_bit) = field(raw, byte, point, data)?;
            let words = format!("{of}, byte {field}{}", bit_words(place_bit));
            Ok(Place { mapping: Mapping { kind: kind::CAN, field, place_bit, ..mapping }, words })
        }
        (None, Some(span), None) => {
            if !is_time(point) || !input {
                let found = format!("{} cannot be the age of an object", quote(&point.name));
                let allowed = "an input that is a TIME, LTIME, LINT, ULINT or LWORD: nanoseconds";
                return Err(Diagnostic::new(span, found, allowed));
            }
            let words = format!("{of}, its age");
            Ok(Place { mapping: Mapping { kind: kind::CAN_AGE, ..mapping }, words })
        }
        (None, None, Some(span)) => {
            let counts = matches!(point.ty, Some(Elementary::Udint | Elementary::Dword));
            if !counts || !input {
                let found = format!("{} cannot count how often it came", quote(&point.name));
                return Err(Diagnostic::new(span, found, "an input that is a UDINT or DWORD"));
            }
            let words = format!("{of}, how often it came");
            Ok(Place { mapping: Mapping { kind: kind::CAN_COUNT, ..mapping }, words })
        }
        (byte, age, count) => {
            let found = match (byte, &age, &count) {
                (None, None, None) => "what of the object is meant is not said",
                _ => "more than one thing of the object is asked for",
            };
            let allowed =
                "one of `byte = 0`, the first byte of a field, `age = true` and `count = true`";
            let span = count.or(age).unwrap_or(header.clone());
            Err(Diagnostic::new(span, found, allowed))
        }
    }
}

/// The identifier as the guest has it, and in words.
fn identifier(raw: &raw::Io, header: &Span) -> Result<(u32, String), Diagnostic> {
    let Some(id) = &raw.id else {
        let found = "which object of the bus is meant is not said";
        return Err(Diagnostic::new(header.clone(), found, "`id = \"0x181\"`, its identifier"));
    };
    let number = check_hex(id, "an identifier", "0x181")?;
    let extended = raw.extended.as_ref().is_some_and(|extended| *extended.get_ref());
    match (u32::try_from(number), extended) {
        (Ok(id), true) if number <= EXTENDED_MAX => Ok((id | EXTENDED, format!("{id:#010x}"))),
        (Ok(id), false) if number <= STANDARD_MAX => Ok((id, format!("{id:#05x}"))),
        _ => {
            let found = format!("the identifier {number:#x} has too many bits");
            let allowed = match extended {
                true => format!("at most {EXTENDED_MAX:#x}, 29 bits"),
                false => format!(
                    "at most {STANDARD_MAX:#x}, 11 bits; with `extended = true` {EXTENDED_MAX:#x}, 29 bits"
                ),
            };
            Err(Diagnostic::new(id.span(), found, allowed))
        }
    }
}

/// An object, with the places that say what it is.
struct Found<'a> {
    key: u64,
    object: Object,
    /// Where its identifier stands first.
    id: Span,
    length: Option<&'a Spanned<i64>>,
    send: Option<&'a Spanned<String>>,
    /// End of the fields, and the one that ends last.
    end: (u32, Span),
}

/// Numbers the objects of a partition. What several tables say of one object must agree.
pub fn objects(entries: &mut [Entry<'_>]) -> Result<Vec<Object>, Diagnostic> {
    let mut objects: Vec<Found<'_>> = Vec::new();
    for entry in entries.iter_mut().filter(|entry| is_can(&entry.connection.mapping)) {
        let m = &mut entry.connection.mapping;
        let id = entry.raw.id.as_ref().map_or(entry.placed.clone(), Spanned::span);
        let at = match objects.iter().position(|object| object.key == m.place) {
            Some(at) => at,
            None if objects.len() == OBJECTS_MAX => {
                let found = format!("this is object {} of the partition", OBJECTS_MAX + 1);
                return Err(Diagnostic::new(id, found, format!("at most {OBJECTS_MAX} objects")));
            }
            None => {
                let object = Object {
                    identifier: m.place as u32,
                    controller: (m.place >> 32) as u8,
                    direction: m.direction,
                    ..Object::NONE
                };
                let (key, end) = (m.place, (0, id.clone()));
                objects.push(Found { key, object, id: id.clone(), length: None, send: None, end });
                objects.len() - 1
            }
        };
        let object = &mut objects[at];
        if object.object.direction != m.direction {
            let found = "one identifier is both received and sent";
            let allowed = "an identifier has one sender on its bus";
            return Err(Diagnostic::new(id, found, allowed).and(object.id.clone(), "the other one"));
        }
        agree(&mut object.length, entry.raw.length.as_ref(), "length")?;
        agree(&mut object.send, entry.raw.send.as_ref(), "send")?;
        let end = if m.kind == kind::CAN { m.field + m.bytes } else { 0 };
        if end > object.end.0 {
            object.end = (end, entry.raw.byte.as_ref().map_or(id, Spanned::span));
        }
        m.place = at as u64;
    }
    objects.into_iter().map(complete).collect()
}

/// A key that stands in one table of an object at least, and says the same in the others that have it.
fn agree<'a, T: PartialEq>(
    known: &mut Option<&'a Spanned<T>>,
    said: Option<&'a Spanned<T>>,
    key: &str,
) -> Result<(), Diagnostic> {
    match (*known, said) {
        (Some(one), Some(other)) if one.get_ref() != other.get_ref() => {
            let found = format!("two tables of one object differ in `{key}`");
            Err(Diagnostic::new(other.span(), found, format!("one `{key}` for each object"))
                .and(one.span(), "the other one"))
        }
        (None, Some(_)) => {
            *known = said;
            Ok(())
        }
        _ => Ok(()),
    }
}

fn complete(found: Found<'_>) -> Result<Object, Diagnostic> {
    let (end, field) = found.end;
    let bytes = match found.length {
        None => end as u8,
        Some(length) => match u8::try_from(*length.get_ref()) {
            Ok(bytes) if usize::from(bytes) <= DATA_MAX && u32::from(bytes) >= end => bytes,
            Ok(bytes) if usize::from(bytes) <= DATA_MAX => {
                let found =
                    format!("a frame of {bytes} bytes does not reach to the end of a field");
                return Err(Diagnostic::new(length.span(), found, format!("{end} to {DATA_MAX}"))
                    .and(field, "the field"));
            }
            _ => {
                let found = format!("a frame cannot have {} data bytes", length.get_ref());
                return Err(Diagnostic::new(length.span(), found, format!("0 to {DATA_MAX}")));
            }
        },
    };
    let flags = match found.send.map(|send| (send, send.get_ref().as_str())) {
        None | Some((_, "cyclic")) => 0,
        Some((_, "on-change")) => ON_CHANGE,
        Some((send, other)) => {
            let found = format!("there is no value {} for `send`", quote(other));
            return Err(Diagnostic::new(send.span(), found, "\"cyclic\" or \"on-change\""));
        }
    };
    Ok(Object { bytes, flags, ..found.object })
}
