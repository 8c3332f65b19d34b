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

pub use connected::Connected;
pub use plc::Plc;
pub use point::{Kind, POINTS_MAX, Point, Search, TooMany, matches, number_of, shown};
pub use value::{Value, is_signed};

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
