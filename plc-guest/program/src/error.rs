//! What is wrong with an image.

use core::fmt;

/// The first defect that was found in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageError {
    /// Where the field's record begins, in bytes from the image's start.
    pub offset: u64,
    /// What kind of record: `header`, `section`, `task`, ...
    pub record: &'static str,
    /// The record's place in its table, from 0.
    pub index: u32,
    /// The field.
    pub field: &'static str,
    /// What is wrong with it.
    pub defect: Defect,
}

/// What is wrong with a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Defect {
    /// The file is shorter than that.
    Truncated {
        /// Bytes that are needed.
        needed: u64,
        /// Bytes that are there.
        found: u64,
    },
    /// A number outside of what is allowed.
    Value {
        /// The number.
        found: u64,
        /// What is allowed, in words.
        allowed: &'static str,
    },
    /// A number above its limit.
    Above {
        /// The number.
        found: u64,
        /// The largest allowed.
        limit: u64,
    },
    /// A rule between fields is broken.
    Rule(&'static str),
}

impl fmt::Display for ImageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { offset, record, index, field, defect } = self;
        write!(f, "at byte {offset:#x}, {record} {index}, {field}: {defect}")
    }
}

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated { needed, found } => {
                write!(f, "{needed} bytes are needed, the file has {found}")
            }
            Self::Value { found, allowed } => write!(f, "found {found}, allowed is {allowed}"),
            Self::Above { found, limit } => write!(f, "found {found}, the limit is {limit}"),
            Self::Rule(rule) => f.write_str(rule),
        }
    }
}

impl core::error::Error for ImageError {}

/// Which record is being checked: what an error needs to say where it is.
#[derive(Clone, Copy)]
pub(crate) struct Where {
    pub offset: u64,
    pub record: &'static str,
    pub index: u32,
}

impl Where {
    pub const fn new(offset: u64, record: &'static str, index: u32) -> Self {
        Self { offset, record, index }
    }

    pub const fn error(self, field: &'static str, defect: Defect) -> ImageError {
        ImageError { offset: self.offset, record: self.record, index: self.index, field, defect }
    }

    pub fn rule(
        self,
        holds: bool,
        field: &'static str,
        rule: &'static str,
    ) -> Result<(), ImageError> {
        if holds { Ok(()) } else { Err(self.error(field, Defect::Rule(rule))) }
    }

    pub fn zero(self, field: &'static str, found: u64) -> Result<(), ImageError> {
        match found {
            0 => Ok(()),
            found => Err(self.value(field, found, "0")),
        }
    }

    pub fn at_most(self, field: &'static str, found: u64, limit: u64) -> Result<(), ImageError> {
        if found <= limit { Ok(()) } else { Err(self.error(field, Defect::Above { found, limit })) }
    }

    pub fn value(self, field: &'static str, found: u64, allowed: &'static str) -> ImageError {
        self.error(field, Defect::Value { found, allowed })
    }
}
