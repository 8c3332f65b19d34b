//! Why an end does not open.

use core::fmt;

use crate::code::ReturnCode;

/// A field of a region's header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Field {
    /// [`MAGIC`](crate::MAGIC).
    Magic,
    /// [`VERSION`](crate::VERSION).
    Version,
    /// [`Kind`](crate::Kind).
    Kind,
    /// [`Policy`](crate::Policy).
    Policy,
    /// Longest message in bytes.
    Maximum,
    /// Depth in messages.
    Depth,
    /// Number of slots.
    Slots,
    /// Nothing yet: 0.
    Reserved,
}

/// Why an end does not open: the region is not the one of the partition file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OpenError {
    /// The region is shorter than the channel needs; both in bytes.
    TooSmall {
        /// What the channel needs.
        needed: usize,
        /// What the region has.
        given: usize,
    },
    /// A header field is not what the partition file says.
    Header {
        /// Which one.
        field: Field,
        /// Its value by the partition file.
        expected: u32,
        /// Its value in the region.
        found: u32,
    },
    /// The refresh period is zero.
    Refresh,
    /// A sampling end of a queuing channel.
    NotSampling,
    /// A queuing end of a sampling channel.
    NotQueuing,
}

impl OpenError {
    /// INVALID_CONFIG, whatever it is.
    #[must_use]
    pub const fn code(self) -> ReturnCode {
        ReturnCode::InvalidConfig
    }
}

impl fmt::Display for OpenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooSmall { needed, given } => {
                write!(f, "the region has {given} bytes, the channel needs {needed}")
            }
            Self::Header { field, expected, found } => {
                write!(
                    f,
                    "header field {field:?} is {found:#x}, by the partition file {expected:#x}"
                )
            }
            Self::Refresh => f.write_str("the refresh period must be positive"),
            Self::NotSampling => f.write_str("this is a queuing channel"),
            Self::NotQueuing => f.write_str("this is a sampling channel"),
        }
    }
}

impl core::error::Error for OpenError {}
