//! Places of values, as they are written in a request.
//!
//! The protocol knows no names: a client takes the place of a variable from the program image, after it has compared
//! the image's hash with that of the status.

use serde::{Deserialize, Serialize};
use takt_abi::live::{Area, Point, Range, WATCHED_RANGES};
use takt_scheduler::time::Nanos;

/// Longest time between two lines of values.
pub const INTERVAL_MAX: Nanos = Nanos::from_millis(3_600_000);
/// Longest name or text of a value, in bytes.
pub const LABEL_MAX: usize = 300;
/// No bit.
const NO_BIT: u32 = 255;

/// What a client calls a value that it writes or forces: for people, in events and in the status.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Named {
    /// The point.
    pub name: String,
    /// The value.
    pub text: String,
}

impl Named {
    /// With bounded texts that have no control characters.
    pub(crate) fn new(name: String, text: String) -> Option<Self> {
        let plain =
            |t: &str| (1..=LABEL_MAX).contains(&t.len()) && !t.chars().any(char::is_control);
        (plain(&name) && plain(&text)).then_some(Self { name, text })
    }
}

/// A value in the status that an operator keeps forced.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ForcedStatus {
    /// What the client has called the point.
    pub name: String,
    /// What it has called the value.
    pub text: String,
    /// Program, area, offset, bytes, and the bit or 255.
    pub point: [u32; 5],
    /// The value.
    pub value: u64,
    /// Since when, since the epoch.
    pub since_ns: u64,
}

/// Values of one cycle.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Values {
    /// Whose.
    pub partition: String,
    /// Number of the release of the window after whose work they were taken.
    pub cycle: u64,
    /// That release, since the epoch.
    pub release_ns: u64,
    /// The same as the programs see it: since the beginning of their tasks.
    pub time_ns: u64,
    /// Samples before this one that were lost: the PLC had no time left, or the client did not read.
    pub missed: u64,
    /// Programs that were in the middle of something, a bit for each.
    pub unsettled: u16,
    /// The bytes of all ranges, in the order of the request, in hexadecimal digits.
    pub bytes: String,
}

/// `[program, area, offset, bytes]` as a range.
pub(crate) fn range([program, area, offset, bytes]: [u32; 4]) -> Option<Range> {
    let range = Range {
        program: u8::try_from(program).ok()?,
        area: Area::of(u8::try_from(area).ok()?)?,
        offset,
        bytes: u16::try_from(bytes).ok().filter(|bytes| *bytes > 0)?,
    };
    offset.checked_add(bytes).map(|_| range)
}

/// All ranges of a request, if there are not too many.
pub(crate) fn ranges(raw: &[[u32; 4]]) -> Option<Vec<Range>> {
    let few = raw.len() <= WATCHED_RANGES;
    few.then(|| raw.iter().map(|raw| range(*raw)).collect())?
}

/// A range as it is written.
#[must_use]
pub fn raw_range(range: Range) -> [u32; 4] {
    [range.program.into(), range.area as u32, range.offset, range.bytes.into()]
}

/// `[program, area, offset, bytes, bit]` as a point.
pub(crate) fn point([program, area, offset, bytes, bit]: [u32; 5]) -> Option<Point> {
    let bit = if bit == NO_BIT { None } else { Some(u8::try_from(bit).ok()?) };
    Point::new(range([program, area, offset, bytes])?, bit)
}

/// A point as it is written.
#[must_use]
pub fn raw_point(point: Point) -> [u32; 5] {
    let [program, area, offset, bytes] = raw_range(point.range);
    [program, area, offset, bytes, point.bit.map_or(NO_BIT, u32::from)]
}
