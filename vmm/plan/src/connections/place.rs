//! The place that a point is connected to: a channel or a register; CAN objects, outputs of programs and simulated values are
//! in files of their own.

use takt_abi::io::{INPUT, Mapping, WHOLE, kind};
use takt_program::{Elementary, limit};
use takt_scheduler::table::PartitionId;
use toml::Spanned;

use super::super::channels::{Channel, ChannelKind, End, Owner};
use super::super::diagnostic::{Diagnostic, Span, quote};
use super::super::passthrough::safe_values::{check_port, check_register};
use super::super::raw;
use super::point::Point;
use super::{Around, Place, can, is_bool, of_program, simulate};

/// The keys of places, of which a table has one, and what belongs to them.
const PLACES: &str = "one of `channel`, `can`, `port`, `mmio`, `output` (of a program) and `simulate`, for each table";

/// The place that a table names, and where it does.
pub fn find(
    raw: &raw::Io,
    header: &Span,
    point: &Point,
    mapping: Mapping,
    around: Around<'_>,
) -> Result<(Place, Span), Diagnostic> {
    let simulated = raw.simulate.as_ref().map(Spanned::span);
    let span = |value: &Option<Spanned<String>>| value.as_ref().map(Spanned::span);
    let places = [
        ("channel", span(&raw.channel)),
        ("can", span(&raw.can)),
        ("port", span(&raw.port)),
        ("mmio", span(&raw.mmio)),
        ("output", span(&raw.output)),
        ("simulate", simulated),
    ];
    let named: Vec<(&str, Span)> =
        places.into_iter().filter_map(|(key, span)| Some((key, span?))).collect();
    let (key, placed) = match &named[..] {
        [] => {
            let found = format!("what {} is connected to is not said", quote(&point.name));
            return Err(Diagnostic::new(header.clone(), found, PLACES));
        }
        [one] => one.clone(),
        [(one, there), (other, here), ..] => {
            let found = format!("both `{one}` and `{other}` say what the point is connected to");
            return Err(
                Diagnostic::new(here.clone(), found, PLACES).and(there.clone(), "the other one")
            );
        }
    };
    check_keys(raw, key)?;
    if mapping.direction != INPUT && matches!(key, "output" | "simulate") {
        let found = format!("`{key}` is for inputs, and {} is an output", quote(&point.name));
        let allowed = "for an output `channel`, `can`, `port` or `mmio`";
        return Err(Diagnostic::new(placed, found, allowed));
    }
    if let Some(name) = &raw.can {
        return Ok((can::check(raw, name, header, point, mapping, around)?, placed));
    }
    let connection = match (&raw.channel, &raw.port, &raw.mmio, &raw.output, &raw.simulate) {
        (Some(name), ..) => channel(raw, name, header, point, mapping, around),
        (_, Some(port), ..) => io_port(raw, port, point, mapping, around),
        (_, _, Some(name), ..) => register(raw, name, header, point, mapping, around),
        (_, _, _, Some(name), _) => of_program::check(raw, name, header, point, mapping, around),
        (_, _, _, _, Some(wave)) => simulate::check(wave, point, mapping),
        _ => Err(Diagnostic::new(header.clone(), "the point is connected to nothing", PLACES)),
    }?;
    Ok((connection, placed))
}

/// Keys that belong to other places than this one are refused.
fn check_keys(raw: &raw::Io, place: &str) -> Result<(), Diagnostic> {
    let keys = [
        ("byte", raw.byte.as_ref().map(Spanned::span), &["channel", "can"][..]),
        ("valid", raw.valid.as_ref().map(Spanned::span), &["channel"]),
        ("age", raw.age.as_ref().map(Spanned::span), &["channel", "can"]),
        ("bit", raw.bit.as_ref().map(Spanned::span), &["channel", "can", "port", "mmio"]),
        ("width", raw.width.as_ref().map(Spanned::span), &["port", "mmio"]),
        ("offset", raw.offset.as_ref().map(Spanned::span), &["mmio"]),
        ("id", raw.id.as_ref().map(Spanned::span), &["can"]),
        ("extended", raw.extended.as_ref().map(Spanned::span), &["can"]),
        ("count", raw.count.as_ref().map(Spanned::span), &["can"]),
        ("length", raw.length.as_ref().map(Spanned::span), &["can"]),
        ("send", raw.send.as_ref().map(Spanned::span), &["can"]),
        ("output_of", raw.output_of.as_ref().map(Spanned::span), &["output"]),
    ];
    for (key, span, places) in keys {
        if let Some(span) = span.filter(|_| !places.contains(&place)) {
            let places: Vec<String> = places.iter().map(|place| format!("`{place}`")).collect();
            let found = format!("`{key}` does not belong to `{place}`");
            let allowed = format!("`{key}` beside {}", places.join(" or "));
            return Err(Diagnostic::new(span, found, allowed));
        }
    }
    Ok(())
}

/// A number of nanoseconds fits into it.
pub fn is_time(point: &Point) -> bool {
    use Elementary::{Lint, Ltime, Lword, Time, Ulint};
    matches!(point.ty, Some(Time | Ltime | Lint | Ulint | Lword))
}

/// What part of a channel a table asks for.
enum Part<'a> {
    Field(&'a Spanned<i64>),
    Valid(Span),
    Age(Span),
}

fn channel(
    raw: &raw::Io,
    name: &Spanned<String>,
    header: &Span,
    point: &Point,
    mapping: Mapping,
    around: Around<'_>,
) -> Result<Place, Diagnostic> {
    let (number, channel) = find_channel(name, mapping.direction == INPUT, around)?;
    let mapping = Mapping { place: number, ..mapping };
    let port = name.get_ref();
    match part(raw, header)? {
        Part::Field(byte) => {
            let message = Bytes {
                called: "a message",
                count: channel.message_bytes,
                of: (name.span(), "the port"),
            };
            let (field, place_bit) = field(raw, byte, point, message)?;
            let bit = bit_words(place_bit);
            let words = format!("channel port {port}, byte {field}{bit}");
            Ok(Place { mapping: Mapping { kind: kind::FIELD, field, place_bit, ..mapping }, words })
        }
        Part::Valid(span) => {
            if !is_bool(point) || mapping.direction != INPUT {
                let found = format!("{} cannot say whether a message is valid", quote(&point.name));
                return Err(Diagnostic::new(span, found, "an input that is a BOOL"));
            }
            let words = format!("channel port {port}, whether it is valid");
            Ok(Place { mapping: Mapping { kind: kind::VALID, ..mapping }, words })
        }
        Part::Age(span) => {
            if !is_time(point) || mapping.direction != INPUT {
                let found = format!("{} cannot be the age of a message", quote(&point.name));
                let allowed = "an input that is a TIME, LTIME, LINT, ULINT or LWORD: nanoseconds";
                return Err(Diagnostic::new(span, found, allowed));
            }
            let words = format!("channel port {port}, the age of its message");
            Ok(Place { mapping: Mapping { kind: kind::AGE, ..mapping }, words })
        }
    }
}

fn part<'a>(raw: &'a raw::Io, header: &Span) -> Result<Part<'a>, Diagnostic> {
    let wanted = |flag: &Option<Spanned<bool>>| {
        flag.as_ref().filter(|flag| *flag.get_ref()).map(Spanned::span)
    };
    let allowed = "one of `byte = 0`, the first byte of a field, `valid = true` and `age = true`";
    match (&raw.byte, wanted(&raw.valid), wanted(&raw.age)) {
        (Some(byte), None, None) => Ok(Part::Field(byte)),
        (None, Some(span), None) => Ok(Part::Valid(span)),
        (None, None, Some(span)) => Ok(Part::Age(span)),
        (None, None, None) => {
            let found = "what of the channel is meant is not said";
            Err(Diagnostic::new(header.clone(), found, allowed))
        }
        (_, valid, age) => {
            let found = "more than one thing of the channel is asked for";
            Err(Diagnostic::new(valid.or(age).unwrap_or(header.clone()), found, allowed))
        }
    }
}

/// The ports of a partition as the guest's table has them: each channel with an end there is one.
pub fn ports(
    partition: PartitionId,
    channels: &[Channel],
) -> impl Iterator<Item = (&Channel, &End)> {
    let owner = Owner::Partition(partition);
    channels.iter().filter_map(move |channel| {
        let mut ends = std::iter::once(&channel.source).chain(&channel.destinations);
        Some((channel, ends.find(|end| end.owner == owner)?))
    })
}

/// A port of the partition at a sampling channel, by its place in the guest's table of ports, and the channel.
fn find_channel<'a>(
    name: &Spanned<String>,
    input: bool,
    around: Around<'a>,
) -> Result<(u64, &'a Channel), Diagnostic> {
    let refuse = |found: String, allowed: String| {
        Err(Diagnostic::new(
            name.span(),
            format!("the port {} {found}", quote(name.get_ref())),
            allowed,
        ))
    };
    let ports = ports(around.partition.partition.id, around.channels);
    let end = format!("{}:{}", around.partition.partition.name, name.get_ref());
    let end = quote(&end);
    let way = if input { "as a destination" } else { "as the source" };
    let Some((number, (channel, port))) =
        (0..).zip(ports).find(|(_, (_, end))| end.port == *name.get_ref())
    else {
        return refuse(
            "is no end of a channel".to_owned(),
            format!("a [[channel]] with {end} {way}"),
        );
    };
    if (channel.source == *port) == input {
        return refuse("goes the other way".to_owned(), format!("a [[channel]] with {end} {way}"));
    }
    if !matches!(channel.kind, ChannelKind::Sampling { .. }) {
        let found = format!("is an end of the queue {}", quote(&channel.name));
        let allowed = "a sampling channel: inputs and outputs are the newest values; a program \
                       reads and writes queues by calls";
        return refuse(found, allowed.to_owned());
    }
    if channel.message_bytes > limit::MESSAGE_BYTES {
        let found = format!("has messages of {} bytes", channel.message_bytes);
        let allowed = format!("a channel with `message_bytes` of at most {}", limit::MESSAGE_BYTES);
        return refuse(found, allowed);
    }
    Ok((number, channel))
}

/// Bytes in which a point can lie, and the place in the file that says whose they are.
pub struct Bytes {
    pub called: &'static str,
    pub count: u32,
    pub of: (Span, &'static str),
}

/// The first byte of a point among those of a message or a frame, and the bit of a BOOL in it.
pub fn field(
    raw: &raw::Io,
    byte: &Spanned<i64>,
    point: &Point,
    all: Bytes,
) -> Result<(u32, u8), Diagnostic> {
    let place_bit = match &raw.bit {
        None => WHOLE,
        Some(bit) => check_bit(bit, point, 8)?,
    };
    let Bytes { called, count, of: (whose, label) } = all;
    let last = i64::from(count) - i64::from(point.bytes);
    match u32::try_from(*byte.get_ref()) {
        Ok(field) if i64::from(field) <= last => Ok((field, place_bit)),
        _ => {
            let (bytes, first) = (point.bytes, byte.get_ref());
            let found =
                format!("{bytes} bytes at byte {first} do not lie in {called} of {count} bytes");
            let allowed = match last {
                0.. => format!("0 to {last}"),
                _ => format!("a point of at most {count} bytes"),
            };
            Err(Diagnostic::new(byte.span(), found, allowed).and(whose, label))
        }
    }
}

/// The bit of a BOOL among so many.
pub fn check_bit(bit: &Spanned<i64>, point: &Point, bits: u8) -> Result<u8, Diagnostic> {
    if !is_bool(point) {
        let found = format!("`bit` is about a BOOL, and {} is none", quote(&point.name));
        return Err(Diagnostic::new(bit.span(), found, "no `bit` for a point of whole bytes"));
    }
    let number = u8::try_from(*bit.get_ref()).ok().filter(|number| *number < bits);
    number.ok_or_else(|| {
        let found = format!("there is no bit {}", bit.get_ref());
        Diagnostic::new(bit.span(), found, format!("0 to {}", bits - 1))
    })
}

/// How a register is accessed: its width in bytes, and the bit of a BOOL.
fn access(
    raw: &raw::Io,
    place: &Spanned<String>,
    point: &Point,
    widths: &[u8],
) -> Result<(u8, u8), Diagnostic> {
    let all = || {
        let widths: Vec<String> = widths.iter().map(u8::to_string).collect();
        widths.join(", ")
    };
    let fits = |width: i64| u8::try_from(width).ok().filter(|width| widths.contains(width));
    let width = match &raw.width {
        None => fits(point.bytes.into()).ok_or_else(|| {
            let found =
                format!("{} has {} bytes, which no register has", quote(&point.name), point.bytes);
            Diagnostic::new(place.span(), found, format!("a point of {} bytes", all()))
        })?,
        Some(width) => fits(*width.get_ref())
            .filter(|width| u32::from(*width) >= point.bytes)
            .ok_or_else(|| {
                let found = format!(
                    "an access of {} bytes cannot be that of {}",
                    width.get_ref(),
                    quote(&point.name)
                );
                let allowed = format!("one of {} that is at least {}", all(), point.bytes);
                Diagnostic::new(width.span(), found, allowed)
            })?,
    };
    let bit = match &raw.bit {
        Some(bit) => check_bit(bit, point, 8 * width)?,
        None if is_bool(point) => {
            let found = format!("which bit of the register {} is, is not said", quote(&point.name));
            let allowed = format!("`bit = 0` to `bit = {}`", 8 * u32::from(width) - 1);
            return Err(Diagnostic::new(place.span(), found, allowed));
        }
        None => WHOLE,
    };
    Ok((width, bit))
}

fn io_port(
    raw: &raw::Io,
    port: &Spanned<String>,
    point: &Point,
    mapping: Mapping,
    around: Around<'_>,
) -> Result<Place, Diagnostic> {
    let (width, place_bit) = access(raw, port, point, &[1, 2, 4])?;
    let number = check_port(port, width, &around.passthrough.ports)?;
    let bit = bit_words(place_bit);
    let words = format!("I/O port {number:#x}{bit}");
    let mapping = Mapping { kind: kind::PORT, width, place_bit, place: number.into(), ..mapping };
    Ok(Place { mapping, words })
}

fn register(
    raw: &raw::Io,
    name: &Spanned<String>,
    header: &Span,
    point: &Point,
    mapping: Mapping,
    around: Around<'_>,
) -> Result<Place, Diagnostic> {
    let (width, place_bit) = access(raw, name, point, &[1, 2, 4, 8])?;
    let memory = &around.passthrough.memory;
    let offset = raw.offset.as_ref();
    let (index, offset) = check_register(name, offset, header, width, memory)?;
    let bit = bit_words(place_bit);
    let words = format!("register {} + {offset:#x}{bit}", name.get_ref());
    let address = memory[index].address + offset;
    let mapping = Mapping { kind: kind::REGISTER, width, place_bit, place: address, ..mapping };
    Ok(Place { mapping, words })
}

pub fn bit_words(bit: u8) -> String {
    if bit == WHOLE { String::new() } else { format!(", bit {bit}") }
}
