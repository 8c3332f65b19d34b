//! The point that a table connects: a variable of the program, or an address in its process image.

use takt_program::{Area, Elementary, Image, TaskId, TypeId, TypeKind, Variable};
use toml::Spanned;

use super::super::diagnostic::{Diagnostic, Span, quote};
use super::super::raw;

/// Which way the values go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Into the program.
    Input,
    /// Out of it.
    Output,
}

/// Some bytes, or one bit, of a process image.
#[derive(Clone, Debug)]
pub struct Point {
    /// As the file names it.
    pub name: String,
    pub direction: Direction,
    pub offset: u32,
    pub bytes: u32,
    /// None for whole bytes.
    pub bit: Option<u8>,
    /// None for arrays, structures and texts.
    pub ty: Option<Elementary>,
    /// None for an address at which the program declares nothing of this size.
    pub id: Option<TypeId>,
    /// As IEC 61131-3 writes it.
    pub type_name: String,
    /// The task that alone writes it, if the image knows.
    pub writer: Option<TaskId>,
}

/// The point that a table names, and where it does.
pub fn find(raw: &raw::Io, header: &Span, image: &Image<'_>) -> Result<(Point, Span), Diagnostic> {
    match (&raw.point, &raw.at) {
        (Some(name), None) => Ok((by_name(name, image)?, name.span())),
        (None, Some(text)) => Ok((by_address(text, image)?, text.span())),
        (Some(point), Some(at)) => {
            let found = "both `point` and `at` say which point it is";
            Err(Diagnostic::new(at.span(), found, "one of them").and(point.span(), "the other one"))
        }
        (None, None) => {
            let found = "which point of the program it is is not said";
            let allowed =
                "`point = \"level\"`, the name of an input or an output, or `at = \"%IW2\"`";
            Err(Diagnostic::new(header.clone(), found, allowed))
        }
    }
}

/// An input or an output by its name.
fn by_name(name: &Spanned<String>, image: &Image<'_>) -> Result<Point, Diagnostic> {
    let Some(variable) = image.variable(name.get_ref()) else {
        let found = format!("the program has no variable {}", quote(name.get_ref()));
        return Err(Diagnostic::new(name.span(), found, "an input or an output of its image"));
    };
    of_variable(&variable, image).ok_or_else(|| {
        let found = format!("{} is neither an input nor an output", quote(name.get_ref()));
        Diagnostic::new(name.span(), found, "a variable that lies in %I or in %Q")
    })
}

fn of_variable(variable: &Variable<'_>, image: &Image<'_>) -> Option<Point> {
    let direction = match variable.area {
        Area::Input => Direction::Input,
        Area::Output => Direction::Output,
        _ => return None,
    };
    let ty = image.type_of(variable.ty).and_then(|ty| match ty.kind {
        TypeKind::Elementary(elementary) => Some(elementary),
        TypeKind::Enumeration { base, .. } | TypeKind::Subrange { base, .. } => Some(base),
        _ => None,
    });
    Some(Point {
        name: variable.name.to_owned(),
        direction,
        offset: variable.offset,
        bytes: variable.bytes,
        bit: variable.bit,
        ty,
        id: Some(variable.ty),
        type_name: image.type_name(variable.ty).to_string(),
        writer: variable.writer,
    })
}

/// A point by an address as Structured Text has it: `%IX0.3`, `%IB2`, `%QW1`, which is bytes 2 and 3.
fn by_address(text: &Spanned<String>, image: &Image<'_>) -> Result<Point, Diagnostic> {
    let wrong = |found: String| {
        let allowed = "%I or %Q with X, B, W, D or L: \"%IX0.3\" is bit 3 of byte 0, \"%QW1\" the bytes 2 and 3";
        Diagnostic::new(text.span(), found, allowed)
    };
    let parsed = parse(text.get_ref());
    let (direction, ty, offset, bit) =
        parsed.ok_or_else(|| wrong(format!("{} is no address", quote(text.get_ref()))))?;
    let (area, letter) = match direction {
        Direction::Input => (Area::Input, 'I'),
        Direction::Output => (Area::Output, 'Q'),
    };
    let end = image.area_bytes(area);
    let width = ty.bytes();
    if offset.checked_add(ty.bytes()).is_none_or(|last| last > end) {
        let found = format!(
            "{} lies outside of the program's %{letter}, which has {end} bytes",
            text.get_ref()
        );
        return Err(wrong(found));
    }
    // Variables of the same bits say who writes them.
    let covers = |v: &Variable<'_>| {
        let range = v.offset..v.offset.saturating_add(v.bytes);
        let all = range.contains(&offset) && range.contains(&(offset + ty.bytes() - 1));
        v.area == area && all && (v.bit.is_none() || v.bit == bit)
    };
    let writer = image.variables().filter(covers).find_map(|v| v.writer);
    let name = text.get_ref().clone();
    let exact = |v: &Variable<'_>| {
        v.area == area && (v.offset, v.bytes, v.bit) == (offset, ty.bytes(), bit)
    };
    // An address of a variable is the variable, with its type. If it has several names of different types, or none, it is bits.
    let mut declared = image.variables().filter(exact).filter_map(|v| of_variable(&v, image));
    if let Some(first) = declared.next()
        && declared.all(|other| other.type_name == first.type_name)
    {
        return Ok(Point { name, writer, ..first });
    }
    let type_name = ty.keyword().to_owned();
    let ty = Some(ty);
    Ok(Point { name, direction, offset, bytes: width, bit, ty, id: None, type_name, writer })
}

fn parse(text: &str) -> Option<(Direction, Elementary, u32, Option<u8>)> {
    let mut letters = text.strip_prefix('%')?.chars();
    let direction = match letters.next()?.to_ascii_uppercase() {
        'I' => Direction::Input,
        'Q' => Direction::Output,
        _ => return None,
    };
    let ty = match letters.next()?.to_ascii_uppercase() {
        'X' => Elementary::Bool,
        'B' => Elementary::Byte,
        'W' => Elementary::Word,
        'D' => Elementary::Dword,
        'L' => Elementary::Lword,
        _ => return None,
    };
    let number = |digits: &str| {
        let good = (1..=5).contains(&digits.len()) && digits.bytes().all(|d| d.is_ascii_digit());
        digits.parse::<u32>().ok().filter(|_| good)
    };
    match (ty, letters.as_str().split_once('.')) {
        (Elementary::Bool, Some((byte, bit))) => {
            let bit = number(bit).filter(|bit| *bit < 8)?;
            Some((direction, ty, number(byte)?, Some(bit as u8)))
        }
        (Elementary::Bool, None) | (_, Some(_)) => None,
        (_, None) => Some((direction, ty, number(letters.as_str())? * ty.bytes(), None)),
    }
}

/// An output by its name or address, for the table of an input that is read from it.
pub fn find_output(text: &Spanned<String>, image: &Image<'_>) -> Result<Point, Diagnostic> {
    let point = if text.get_ref().starts_with('%') {
        by_address(text, image)
    } else {
        by_name(text, image)
    };
    let point = point?;
    if point.direction == Direction::Input {
        let found = format!("{} is an input", quote(text.get_ref()));
        return Err(Diagnostic::new(text.span(), found, "an output"));
    }
    Ok(point)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_count_in_units_of_their_size() {
        use Direction::{Input, Output};
        use Elementary::{Bool, Byte, Dword, Lword, Word};
        assert_eq!(parse("%IX3.5"), Some((Input, Bool, 3, Some(5))));
        assert_eq!(parse("%qb7"), Some((Output, Byte, 7, None)));
        assert_eq!(parse("%IW2"), Some((Input, Word, 4, None)));
        assert_eq!(parse("%QD4"), Some((Output, Dword, 16, None)));
        assert_eq!(parse("%IL99999"), Some((Input, Lword, 799_992, None)));
        let wrong = [
            "",
            "%",
            "IW0",
            "%MW0",
            "%IW",
            "%IX0",
            "%IX0.8",
            "%IX.1",
            "%IW1.1",
            "%I0",
            "%IW+1",
            "%IW100000",
            "%IWä",
        ];
        for text in wrong {
            assert_eq!(parse(text), None, "{text}");
        }
    }
}
