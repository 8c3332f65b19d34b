//! What two tables must not share: an input has one source, and a place one output.

use takt_abi::io::{INPUT, Mapping, OUTPUT, WHOLE, kind};

use super::super::diagnostic::{Diagnostic, quote};
use super::{Around, Entry, is_channel};

/// The first bit of a range, and the one behind its last.
pub type Bits = (u64, u64);

/// Compares a table with those before it.
pub fn check(next: &Entry<'_>, before: &[Entry<'_>]) -> Result<(), Diagnostic> {
    let this = &next.connection.mapping;
    for other in before {
        let that = &other.connection.mapping;
        if this.direction == INPUT
            && (this.program, this.direction) == (that.program, that.direction)
            && meet(in_image(this), in_image(that))
        {
            let found = format!(
                "the input {} has a second source: {}",
                quote(&next.point.name),
                next.connection.place
            );
            let label = format!("the other one: {}", other.connection.place);
            return Err(Diagnostic::new(next.named.clone(), found, "one source for each input")
                .and(other.named.clone(), label));
        }
        if this.direction == OUTPUT && that.direction == OUTPUT {
            check_outputs(next, other)?;
        }
    }
    Ok(())
}

/// Two outputs that are written to one device or message.
fn check_outputs(next: &Entry<'_>, other: &Entry<'_>) -> Result<(), Diagnostic> {
    let (this, that) = (&next.connection.mapping, &other.connection.mapping);
    let refuse = |found: String, allowed: &str| {
        let label = format!("the other one: {}", quote(&other.point.name));
        Err(Diagnostic::new(next.placed.clone(), found, allowed).and(other.placed.clone(), label))
    };
    if this.kind != that.kind || !meet(in_device(this), in_device(that)) {
        return Ok(());
    }
    let names = || format!("{} and {}", quote(&other.point.name), quote(&next.point.name));
    if this.program != that.program {
        let found = format!("outputs of two programs are written to one place: {}", names());
        return refuse(
            found,
            "a channel, a CAN object or a register for the outputs of one program",
        );
    }
    if !is_channel(this) && (this.place, this.width) != (that.place, that.width) {
        let found = format!("{} are in registers that overlap", names());
        return refuse(found, "bits of one register, with the same `width`");
    }
    if meet(at_place(this), at_place(that)) {
        let found = format!("two outputs are written to one place: {}", names());
        return refuse(found, "one output for each bit of a register, a message or a CAN object");
    }
    Ok(())
}

pub const fn meet(a: Bits, b: Bits) -> bool {
    a.0 < b.1 && b.0 < a.1
}

/// The bits of a point in its image.
pub fn in_image(m: &Mapping) -> Bits {
    bits(m.offset.into(), m.bit, m.bytes.into())
}

/// The bits of a message, register or other image at the place.
pub fn at_place(m: &Mapping) -> Bits {
    bits(m.field.into(), m.place_bit, m.bytes.into())
}

/// All that is written at once: a whole message, CAN object or register.
fn in_device(m: &Mapping) -> Bits {
    if matches!(m.kind, kind::FIELD | kind::CAN) {
        (m.place, m.place + 1)
    } else {
        (m.place, m.place + u64::from(m.width))
    }
}

pub fn bits(byte: u64, bit: u8, bytes: u64) -> Bits {
    match bit {
        WHOLE => (8 * byte, 8 * (byte + bytes)),
        bit => (8 * byte + u64::from(bit), 8 * byte + u64::from(bit) + 1),
    }
}

/// A port whose messages are inputs or outputs is not one that a program uses by calls.
pub fn check_ports(entries: &[Entry<'_>], around: Around<'_>) -> Result<(), Diagnostic> {
    for entry in entries {
        let Some(name) = &entry.raw.channel else { continue };
        for program in &around.partition.programs {
            let Some(image) = program.program.image() else { continue };
            if image.ports().any(|port| port.name == name.get_ref().as_str()) {
                let found = format!(
                    "the program {} uses the port {} by calls",
                    quote(&program.program.name),
                    quote(name.get_ref())
                );
                let allowed = "a port that is either mapped to points or used by calls";
                return Err(Diagnostic::new(name.span(), found, allowed)
                    .and(program.span.clone(), "the program"));
            }
        }
    }
    Ok(())
}
