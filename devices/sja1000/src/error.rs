//! Why an operation did not do what was asked.

use core::fmt;

/// The controller does not change its mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModeError {
    /// It stays on the bus although reset mode is requested.
    StaysOperating,
    /// It stays in reset mode although it is released.
    StaysReset,
}

impl fmt::Display for ModeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::StaysOperating => "the controller does not enter reset mode",
            Self::StaysReset => "the controller does not leave reset mode",
        })
    }
}

impl core::error::Error for ModeError {}

/// Why a controller does not start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StartError {
    /// Every bit of the mode register is set: nothing is at these addresses, or the partition may
    /// not reach them.
    Absent,
    /// It does not change its mode.
    Mode(ModeError),
    /// It does not enter PeliCAN mode; this is what its clock divider register says instead.
    NotPeliCan(u8),
    /// An acceptance register does not keep what is written: this is not an SJA1000, or its
    /// registers are further apart or nearer together than assumed.
    NotStored {
        /// Number of the register.
        register: u8,
        /// What was written.
        written: u8,
        /// What it reads as.
        read: u8,
    },
}

impl From<ModeError> for StartError {
    fn from(error: ModeError) -> Self {
        Self::Mode(error)
    }
}

impl fmt::Display for StartError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("no controller answers"),
            Self::Mode(error) => error.fmt(f),
            Self::NotPeliCan(read) => {
                write!(f, "the controller has no PeliCAN mode (clock divider {read:#04x})")
            }
            Self::NotStored { register, written, read } => {
                write!(
                    f,
                    "register {register} reads as {read:#04x} after {written:#04x} was written"
                )
            }
        }
    }
}

impl core::error::Error for StartError {}

/// Why a frame was not taken for transmission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TransmitError {
    /// The frame before it is not on the bus yet.
    Busy,
    /// The controller is off the bus because of errors.
    BusOff,
}

impl fmt::Display for TransmitError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Busy => "the transmit buffer is busy",
            Self::BusOff => "the controller is off the bus",
        })
    }
}

impl core::error::Error for TransmitError {}

/// Why there is no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReceiveError {
    /// None has come.
    Empty,
    /// The controller is off the bus because of errors, or gone.
    BusOff,
}

impl fmt::Display for ReceiveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Empty => "no frame has come",
            Self::BusOff => "the controller is off the bus",
        })
    }
}

impl core::error::Error for ReceiveError {}
