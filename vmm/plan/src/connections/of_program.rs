//! An input that is an output of a program in the same partition.

use takt_abi::io::{Mapping, WHOLE, kind};
use takt_program::Image;
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span, quote};
use super::super::raw;
use super::point::{self, Point};
use super::{Around, Place, find_program, is_bool, types};

pub fn check(
    raw: &raw::Io,
    name: &Spanned<String>,
    header: &Span,
    point: &Point,
    mapping: Mapping,
    around: Around<'_>,
) -> Result<Place, Diagnostic> {
    let of = raw.output_of.as_ref().or(raw.program.as_ref());
    let (number, program) = find_program(of, "output_of", header, around)?;
    let reader = &around.partition.programs[usize::from(mapping.program)];
    let (Some(image), Some(own)) = (program.program.image(), reader.program.image()) else {
        let found = "its program has no image";
        return Err(Diagnostic::new(name.span(), found, "a program with an image"));
    };
    let from = point::find_output(name, &image)?;
    check_types(name, (&from, &image), (point, &own))?;
    let mapping = Mapping {
        kind: kind::PROGRAM,
        place: number.into(),
        field: from.offset,
        place_bit: from.bit.unwrap_or(WHOLE),
        ..mapping
    };
    let words = format!("output {} of {}", name.get_ref(), program.program.name);
    Ok(Place { mapping, words })
}

/// Refuses an output of another size than the input, and one whose bits mean something else.
fn check_types(
    name: &Spanned<String>,
    (from, its): (&Point, &Image<'_>),
    (to, own): (&Point, &Image<'_>),
) -> Result<(), Diagnostic> {
    // What a BOOL is in the two images, a bit or a byte, makes no difference.
    let bits = |p: &Point| (0, 8 * u64::from(p.bytes));
    let input = types::parts(to, own, bits(to));
    let same_size = (is_bool(from), from.bytes) == (is_bool(to), to.bytes);
    let part = if same_size {
        match types::conflict(&types::parts(from, its, bits(from)), &input) {
            None => return Ok(()),
            conflict => conflict,
        }
    } else {
        input.first()
    };
    let size = |p: &Point| match p.bytes {
        _ if same_size || is_bool(p) => String::new(),
        1 => " (1 byte)".to_owned(),
        bytes => format!(" ({bytes} bytes)"),
    };
    let found = format!(
        "the output {} is of type {}{}, and the input {} is of type {}{}",
        quote(name.get_ref()),
        from.type_name,
        size(from),
        quote(&to.name),
        to.type_name,
        size(to)
    );
    let allowed = match part {
        Some(part) if input.len() == 1 => format!("an output of {}", part.allowed()),
        Some(part) if same_size => {
            format!("an output that at byte {} is of {}", part.bits.0 / 8, part.allowed())
        }
        _ => format!("an output of {} bytes with the same parts", to.bytes),
    };
    Err(Diagnostic::new(name.span(), found, allowed))
}
