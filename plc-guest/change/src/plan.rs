//! A plan as bytes, and the rules that it keeps.
//!
//! A header of 96 bytes, then records of 16 bytes each; numbers are little-endian.
//!
//! | at | size | header |
//! | --- | --- | --- |
//! | 0 | 8 | magic: `TAKTCHG` and a zero |
//! | 8 | u32 | version: 1 |
//! | 12 | u32 | number of records |
//! | 16 | 32 | SHA-256 of the image that is left, as the image says it |
//! | 48 | 32 | SHA-256 of the image that is entered |
//! | 80 | u32 | bytes of the state of the first |
//! | 84 | u32 | bytes of the state of the second |
//! | 88 | u32 | bytes that are put aside |
//! | 92 | u32 | 0; 1 is a plan of another kind: [`large`](crate::large) |
//!
//! A record is a code (u8), two elementary types of a conversion (u8 each, else zero), a zero, and three
//! numbers (u32): from, to, count. The records are in three groups. First those that write the state, in the order of
//! the places that they write, which do not overlap. Then those that put bytes aside, one behind the other. Last
//! the references, in the order of their places.

use core::fmt;

use takt_program::{Elementary, Image};

use crate::conversion::Conversion;
use crate::cost::{COMMIT_NS, Cost, GATHER_BYTES, SAVED_BYTES};
use crate::header::{Header, IN_PLACE, relocate};

/// The first bytes of each plan.
pub const MAGIC: [u8; 8] = *b"TAKTCHG\0";
/// The version of this format.
pub const VERSION: u32 = 1;
/// Size of the header.
pub const HEADER_BYTES: usize = 96;
/// Size of a record.
pub const RECORD_BYTES: usize = 16;
/// Most records: few more are within [`COMMIT_NS`], and the kernel checks a plan in a part of one window.
pub const RECORDS: u32 = 256;
/// Size of the longest plan.
pub const PLAN_BYTES: usize = HEADER_BYTES + RECORDS as usize * RECORD_BYTES;

/// One step. Places are offsets in the state: `from` in that of the old version, `to` in that of the new one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The bytes stay where they are. Told only for the references into them.
    Keep {
        /// Where.
        at: u32,
        /// How many.
        bytes: u32,
    },
    /// The bytes get to another place.
    Copy {
        /// Where they are.
        from: u32,
        /// Where they get to.
        to: u32,
        /// How many.
        bytes: u32,
    },
    /// Values, one behind the other, get to another type.
    Convert {
        /// Where the first is.
        from: u32,
        /// Where it gets to.
        to: u32,
        /// How many values.
        count: u32,
        /// From which type to which.
        conversion: Conversion,
    },
    /// The bytes get the initial values of the new version.
    Initial {
        /// Where.
        to: u32,
        /// How many.
        bytes: u32,
    },
    /// The bytes come back that the change before has put aside.
    Restore {
        /// Where they are in what was put aside.
        from: u32,
        /// Where they get to.
        to: u32,
        /// How many.
        bytes: u32,
    },
    /// The bytes are put aside, for a roll-back.
    Save {
        /// Where they are.
        from: u32,
        /// Where they get to in what is put aside.
        to: u32,
        /// How many.
        bytes: u32,
    },
    /// An address of 8 bytes is changed to where its target gets to; to zero if that is gone.
    Reference {
        /// Where it is.
        from: u32,
        /// Where it gets to.
        to: u32,
    },
}

mod code {
    pub const KEEP: u8 = 1;
    pub const COPY: u8 = 2;
    pub const CONVERT: u8 = 3;
    pub const INITIAL: u8 = 4;
    pub const RESTORE: u8 = 5;
    pub const SAVE: u8 = 6;
    pub const REFERENCE: u8 = 7;
}

impl Step {
    /// How many bytes it writes.
    #[must_use]
    pub const fn bytes(&self) -> u32 {
        match *self {
            Self::Keep { bytes, .. }
            | Self::Copy { bytes, .. }
            | Self::Initial { bytes, .. }
            | Self::Restore { bytes, .. }
            | Self::Save { bytes, .. } => bytes,
            Self::Convert { count, conversion, .. } => {
                count.saturating_mul(conversion.to().bytes())
            }
            Self::Reference { .. } => 8,
        }
    }

    /// The first place that it writes.
    pub(crate) const fn target(&self) -> u32 {
        match *self {
            Self::Keep { at: to, .. }
            | Self::Copy { to, .. }
            | Self::Convert { to, .. }
            | Self::Initial { to, .. }
            | Self::Restore { to, .. }
            | Self::Save { to, .. }
            | Self::Reference { to, .. } => to,
        }
    }

    /// Whether it is done before the commit: initial values behind the state of the old version, of this
    /// size, which has no use for those bytes.
    #[must_use]
    pub const fn is_early(&self, old_bytes: u32) -> bool {
        matches!(*self, Self::Initial { to, .. } if to >= old_bytes)
    }

    /// Whether it is one of the first group: it writes the state, or says what stays in it.
    pub(crate) const fn writes_state(&self) -> bool {
        !matches!(self, Self::Save { .. } | Self::Reference { .. })
    }

    /// The record.
    #[must_use]
    pub fn record(&self) -> [u8; RECORD_BYTES] {
        let (code, types, from, to, count) = match *self {
            Self::Keep { at, bytes } => (code::KEEP, None, at, at, bytes),
            Self::Copy { from, to, bytes } => (code::COPY, None, from, to, bytes),
            Self::Convert { from, to, count, conversion } => {
                (code::CONVERT, Some(conversion), from, to, count)
            }
            Self::Initial { to, bytes } => (code::INITIAL, None, to, to, bytes),
            Self::Restore { from, to, bytes } => (code::RESTORE, None, from, to, bytes),
            Self::Save { from, to, bytes } => (code::SAVE, None, from, to, bytes),
            Self::Reference { from, to } => (code::REFERENCE, None, from, to, 8),
        };
        let mut record = [0; RECORD_BYTES];
        record[0] = code;
        if let Some(conversion) = types {
            record[1] = conversion.from().code();
            record[2] = conversion.to().code();
        }
        for (at, number) in [(4, from), (8, to), (12, count)] {
            record[at..at + 4].copy_from_slice(&number.to_le_bytes());
        }
        record
    }

    pub(crate) fn read(record: &[u8]) -> Option<Self> {
        let number = |at| u32_at(record, at);
        let (from, to, bytes) = (number(4), number(8), number(12));
        let (first, second) = (*record.get(1)?, *record.get(2)?);
        let code = *record.first()?;
        let plain = first == 0 && second == 0;
        if record.get(3) != Some(&0) || bytes == 0 || (code != code::CONVERT && !plain) {
            return None;
        }
        match code {
            code::KEEP if from == to => Some(Self::Keep { at: from, bytes }),
            code::COPY => Some(Self::Copy { from, to, bytes }),
            code::CONVERT => {
                let (first, second) =
                    (Elementary::from_code(first)?, Elementary::from_code(second)?);
                let conversion = Conversion::between(first, second)?;
                Some(Self::Convert { from, to, count: bytes, conversion })
            }
            code::INITIAL if from == to => Some(Self::Initial { to, bytes }),
            code::RESTORE => Some(Self::Restore { from, to, bytes }),
            code::SAVE => Some(Self::Save { from, to, bytes }),
            code::REFERENCE if bytes == 8 => Some(Self::Reference { from, to }),
            _ => None,
        }
    }
}

pub(crate) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    let found = bytes.get(at..).and_then(|rest| rest.first_chunk());
    found.map_or(0, |four| u32::from_le_bytes(*four))
}

/// Why a plan is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defect {
    /// It is no plan of this version, or not as long as it says.
    Header,
    /// It is for other images.
    Images,
    /// This record is none, or breaks a rule.
    Record(u32),
    /// This record reads or writes outside of a state.
    Range(u32),
    /// This record is not behind the one before it.
    Order(u32),
    /// More bytes are read, or put aside, than there is room for.
    Room,
    /// It takes longer than a commit may.
    Cost {
        /// So many nanoseconds, by the model.
        nanoseconds: u64,
    },
}

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Header => {
                f.write_str("it is no plan of its kind of version 1, or not as long as it says")
            }
            Self::Images => f.write_str("it is for other images"),
            Self::Record(index) => write!(f, "record {index} is none that there is"),
            Self::Range(index) => write!(f, "record {index} leads out of the state"),
            Self::Order(index) => write!(f, "record {index} overlaps one before it"),
            Self::Room => write!(
                f,
                "it moves more than {GATHER_BYTES} bytes or puts more than {SAVED_BYTES} aside"
            ),
            Self::Cost { nanoseconds } => {
                write!(f, "it takes {nanoseconds} ns, the limit is {COMMIT_NS}")
            }
        }
    }
}

/// A plan. There is none that has not been checked: see [`Plan::parse`].
#[derive(Clone, Copy, Debug)]
pub struct Plan<'a> {
    header: Header<'a>,
    cost: Cost,
}

/// What the checks know of the records before one.
struct Before {
    group: u8,
    end: u32,
    gathered: u32,
}

impl<'a> Plan<'a> {
    /// Checks a plan for a change between two images.
    ///
    /// # Errors
    /// The first defect that is found.
    pub fn parse(bytes: &'a [u8], old: &Image<'_>, new: &Image<'_>) -> Result<Self, Defect> {
        let header = Header::read(bytes, IN_PLACE, RECORDS)?;
        if !header.is_of(old, new) {
            return Err(Defect::Images);
        }
        let mut plan = Self { header, cost: Cost::default() };
        if plan.saved_bytes() > SAVED_BYTES {
            return Err(Defect::Room);
        }
        let mut before = Before { group: 0, end: 0, gathered: 0 };
        for index in 0..header.records() {
            let step = header.step(index).ok_or(Defect::Record(index))?;
            plan.check(&step, &mut before).map_err(|defect| defect(index))?;
            plan.cost.add(&step, plan.old_bytes());
        }
        if before.gathered > GATHER_BYTES {
            return Err(Defect::Room);
        }
        match plan.cost.nanoseconds() {
            nanoseconds if nanoseconds > COMMIT_NS => Err(Defect::Cost { nanoseconds }),
            _ => Ok(plan),
        }
    }

    fn check(&self, step: &Step, before: &mut Before) -> Result<(), fn(u32) -> Defect> {
        let (old, new, saved) = (self.old_bytes(), self.new_bytes(), self.saved_bytes());
        let bytes = step.bytes();
        // What is read, from how much; what is written, to how much.
        let (group, source, target) = match *step {
            Step::Keep { at, .. } => (0, Some((at, bytes, old)), (at, new)),
            Step::Copy { from, to, .. } if from == to => return Err(Defect::Record),
            Step::Copy { from, to, .. } => (0, Some((from, bytes, old)), (to, new)),
            Step::Convert { from, to, count, conversion } => {
                let read = count.saturating_mul(conversion.from().bytes());
                (0, Some((from, read, old)), (to, new))
            }
            Step::Initial { to, .. } => {
                // Done before the commit or at it, not partly so.
                if to < old && u64::from(to) + u64::from(bytes) > old.into() {
                    return Err(Defect::Record);
                }
                (0, None, (to, new))
            }
            Step::Restore { from, to, .. } => (0, Some((from, bytes, saved)), (to, new)),
            Step::Save { from, to, .. } => (1, Some((from, bytes, old)), (to, saved)),
            Step::Reference { from, to } => (2, Some((from, 8, old)), (to, new)),
        };
        let inside = |at: u32, bytes: u32, size: u32| {
            bytes < u32::MAX && u64::from(at) + u64::from(bytes) <= u64::from(size)
        };
        let read = source.is_none_or(|(at, bytes, size)| inside(at, bytes, size));
        if !read || !inside(target.0, bytes, target.1) {
            return Err(Defect::Range);
        }
        if group > before.group {
            (before.group, before.end) = (group, 0);
        }
        if group < before.group || target.0 < before.end {
            return Err(Defect::Order);
        }
        before.end = target.0 + bytes;
        if matches!(step, Step::Copy { .. } | Step::Convert { .. } | Step::Reference { .. }) {
            before.gathered = before.gathered.saturating_add(bytes);
        }
        Ok(())
    }

    /// The steps, in the order of the records.
    pub fn steps(&self) -> impl Iterator<Item = Step> + use<'a> {
        let header = self.header;
        (0..header.records()).filter_map(move |index| header.step(index))
    }

    /// Size of the state that is left.
    #[must_use]
    pub fn old_bytes(&self) -> u32 {
        self.header.old_bytes()
    }

    /// Size of the state that is entered.
    #[must_use]
    pub fn new_bytes(&self) -> u32 {
        self.header.new_bytes()
    }

    /// How many bytes it puts aside or takes back.
    #[must_use]
    pub fn saved_bytes(&self) -> u32 {
        self.header.saved_bytes()
    }

    /// What it does at the commit.
    #[must_use]
    pub const fn cost(&self) -> Cost {
        self.cost
    }

    /// Where an address of the old version leads in the new one: 0 for what is gone.
    #[must_use]
    pub fn relocated(&self, target: u64) -> u64 {
        relocate(target, self.old_bytes(), |offset| {
            // The model of the cost counts these records only.
            self.steps().take_while(Step::writes_state).find_map(|step| {
                let (from, to, bytes) = match step {
                    Step::Keep { at, bytes } => (at, at, bytes),
                    Step::Copy { from, to, bytes } => (from, to, bytes),
                    _ => return None,
                };
                offset.checked_sub(from).filter(|inside| *inside < bytes).map(|inside| to + inside)
            })
        })
    }
}
