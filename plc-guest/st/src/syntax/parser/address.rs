//! Direct addresses: `%IX0.1`, `%QW4`, `%M*`.

use super::{Parse, Parser};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::{Address, Area, Place, Width};

/// The bytes of each image.
const AREA_BYTES: u64 = 64 << 10;

const FORMS: &str = "`%IX<byte>.<bit>`, `%IB<n>`, `%IW<n>`, `%ID<n>`, `%IL<n>` where n counts units of that \
                     width, or `%I*`; likewise `%Q` and `%M`";

impl Parser<'_> {
    pub(super) fn address(&mut self) -> Parse<Address> {
        let span = self.current.span;
        match parse(self.text(span), span) {
            Ok(address) => {
                self.advance();
                Ok(address)
            }
            Err(found) => {
                let one = Diagnostic::new(Code::InvalidAddress, span, found).allowed(FORMS);
                self.tell(one);
                self.advance();
                Err(super::Told)
            }
        }
    }

    /// `%X3` or `%B1` behind a variable: the width and the number.
    pub(super) fn part(&mut self) -> Parse<(Width, u32)> {
        let span = self.current.span;
        let text = self.text(span);
        let found = text.strip_prefix('%').and_then(|text| {
            let (width, number) = text.split_at_checked(1)?;
            Some((self::width(width)?, number.parse().ok()?))
        });
        if found.is_none() {
            let found = format!("`{text}` as a part of a variable");
            let allowed = "`%X3` or `3` (a bit), `%B1`, `%W1`, `%D1`";
            let one = Diagnostic::new(Code::InvalidAddress, span, found).allowed(allowed);
            self.tell(one);
        }
        self.advance();
        found.ok_or(super::Told)
    }
}

fn width(letter: &str) -> Option<Width> {
    Some(match letter {
        "X" | "x" => Width::Bit,
        "B" | "b" => Width::Byte,
        "W" | "w" => Width::Word,
        "D" | "d" => Width::Double,
        "L" | "l" => Width::Long,
        _ => return None,
    })
}

/// The bytes that a width covers, 1 for a bit.
fn bytes(width: Width) -> u64 {
    match width {
        Width::Bit | Width::Byte => 1,
        Width::Word => 2,
        Width::Double => 4,
        Width::Long => 8,
    }
}

fn parse(text: &str, span: Span) -> Result<Address, String> {
    let wrong = || format!("`{text}` as an address");
    let body = text.strip_prefix('%').unwrap_or(text);
    let (area, body) = body.split_at_checked(1).ok_or_else(wrong)?;
    let area = match area {
        "I" | "i" => Area::Input,
        "Q" | "q" => Area::Output,
        "M" | "m" => Area::Marker,
        _ => return Err(wrong()),
    };
    if body == "*" {
        return Ok(Address { area, place: None, span });
    }
    let (width, numbers) = match body.split_at_checked(1) {
        Some((letter, rest)) if width(letter).is_some() => (width(letter), rest),
        _ => (None, body),
    };
    let width = width.unwrap_or(Width::Bit);
    let mut parts = numbers.split('.').map(str::parse::<u32>);
    let first = parts.next().ok_or_else(wrong)?.map_err(|_| wrong())?;
    let bit = match (width, parts.next()) {
        (Width::Bit, Some(Ok(bit))) if bit < 8 => bit as u8,
        (Width::Bit, None) => return Err(format!("`{text}` names a bit without its byte")),
        (Width::Bit, Some(Ok(bit))) => return Err(format!("bit {bit} of a byte in `{text}`")),
        (_, None) => 0,
        _ => return Err(wrong()),
    };
    if parts.next().is_some() {
        return Err(wrong());
    }
    let byte = u64::from(first) * bytes(width);
    if byte + bytes(width) > AREA_BYTES {
        return Err(format!("`{text}` is behind the end of its image of 64 KiB"));
    }
    Ok(Address { area, place: Some(Place { width, byte: byte as u32, bit }), span })
}
