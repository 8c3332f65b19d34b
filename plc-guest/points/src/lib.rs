//! Values of a PLC while it runs, by name, through the control socket of its Takt.
//!
//! `takt plc watch` and its neighbours ask with this, and so does the page of values of `takt top`.
//!
//! Takt knows no names. They are those of the images that the partition file names; so before anything is asked, the
//! hashes of these images are compared with those of the images that run.

mod connected;
mod plc;
mod point;
mod value;

use takt_client::ClientError;
use takt_protocol::Range;

pub use connected::Connected;
pub use plc::Plc;
pub use point::{Kind, POINTS_MAX, Point, Search, TooMany, matches, number_of, shown};
pub use value::{Value, digits, is_signed};

/// Why there are no values.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Takt refuses, or none answers.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// A name, a file or an image is not what it must be.
    #[error("{0}")]
    Input(String),
    /// The PLC tells nothing, or something else than was asked for.
    #[error("{0}")]
    Silent(&'static str),
}

/// What to ask for, to be told the bytes of these points in their order. Points that follow each other in memory are one range: an
/// array of 10,000 values is one piece, and a request has room for few.
#[must_use]
pub fn ranges(points: &[Point]) -> Vec<Range> {
    let mut all: Vec<Range> = Vec::new();
    for point in points {
        let next = point.range;
        if let Some(last) = all.last_mut()
            && (last.program, last.area) == (next.program, next.area)
            && last.offset.checked_add(last.bytes.into()) == Some(next.offset)
            && let Some(bytes) = last.bytes.checked_add(next.bytes)
        {
            last.bytes = bytes;
        } else {
            all.push(next);
        }
    }
    all
}

/// The value of each point in the bytes of a line, as text.
///
/// # Errors
/// If the line is not as long as it must be.
pub fn texts(points: &[Point], values: &takt_protocol::Values) -> Result<Vec<String>, Error> {
    let bytes = takt_protocol::from_hex(&values.bytes);
    let line = bytes.as_deref().and_then(|bytes| cut(points, bytes)).ok_or_else(not_asked_for)?;
    Ok(points.iter().zip(line).map(|(point, bytes)| point.show(bytes)).collect())
}

/// Of a line of values that is not as long as it must be.
#[must_use]
pub fn not_asked_for() -> Error {
    Error::Silent("the values that came are not those that were asked for")
}

/// The bytes of each point in a line of values.
#[must_use]
pub fn cut<'v>(points: &[Point], bytes: &'v [u8]) -> Option<Vec<&'v [u8]>> {
    let mut rest = bytes;
    let mut all = Vec::with_capacity(points.len());
    for point in points {
        let (value, more) = rest.split_at_checked(point.range.bytes.into())?;
        all.push(value);
        rest = more;
    }
    rest.is_empty().then_some(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_program::{Elementary, Flags};
    use takt_protocol::Area;

    fn point(area: Area, offset: u32, bytes: u16) -> Point {
        let (name, type_name) = ("p.x".into(), "LWORD".into());
        let range = Range { program: 0, area, offset, bytes };
        let (kind, flags) = (Kind::Elementary(Elementary::Lword), Flags::NONE);
        Point { name, type_name, range, bit: None, kind, flags }
    }

    #[test]
    fn neighbours_in_memory_are_asked_for_together_and_in_their_order() {
        let of = |places: &[(Area, u32, u16)]| {
            let points: Vec<Point> = places.iter().map(|(a, o, b)| point(*a, *o, *b)).collect();
            ranges(&points).iter().map(|range| (range.offset, range.bytes)).collect::<Vec<_>>()
        };
        use Area::{Output, State};
        assert_eq!(of(&[(State, 0, 4), (State, 4, 2), (State, 6, 1)]), [(0, 7)]);
        assert_eq!(of(&[(State, 4, 4), (State, 0, 4)]), [(4, 4), (0, 4)], "the order stays");
        assert_eq!(of(&[(State, 0, 1), (State, 0, 1)]), [(0, 1), (0, 1)], "two bits of a byte");
        assert_eq!(of(&[(State, 0, 4), (Output, 4, 4)]), [(0, 4), (4, 4)]);
        assert_eq!(of(&[(State, 0, 65_535), (State, 65_535, 1)]), [(0, 65_535), (65_535, 1)]);
        let row: Vec<_> = (0..10_000).map(|i| (State, 4 * i, 4)).collect();
        assert_eq!(of(&row), [(0, 40_000)]);
    }
}
