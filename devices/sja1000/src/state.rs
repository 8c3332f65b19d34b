//! How well a controller gets on with its bus.
//!
//! Each controller counts errors and limits itself as its counters rise (CAN specification 2.0,
//! part B, section 8). The program should know: a warning is a cable going bad, and a controller
//! that is off the bus stays there until it is told to come back.

use core::fmt;

/// Part that a controller takes in the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusState {
    /// Sends, receives, and flags errors.
    Active,
    /// As `Active`, but an error counter has reached the warning limit, 96.
    Warning,
    /// An error counter has reached 128: it does not destroy the faulty frames of others any more.
    Passive,
    /// The transmit error counter has passed 255: off the bus until
    /// [`recover`](crate::Controller::recover).
    BusOff,
    /// Told to come back, and waiting for 128 times 11 recessive bits.
    Recovering,
    /// In reset mode, though it had been started: it was reset from outside.
    Reset,
    /// Does not answer any more.
    Absent,
}

impl fmt::Display for BusState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Active => "error active",
            Self::Warning => "error warning",
            Self::Passive => "error passive",
            Self::BusOff => "bus off",
            Self::Recovering => "recovering",
            Self::Reset => "in reset mode",
            Self::Absent => "absent",
        })
    }
}

/// The error counters of a controller.
///
/// While it recovers, `transmit` counts down what is left of the wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ErrorCounters {
    /// Rises by 8 for most errors in sending, falls by 1 for each frame sent.
    pub transmit: u8,
    /// Rises by 1 for most errors in receiving, falls by 1 for each frame received.
    pub receive: u8,
}

impl ErrorCounters {
    /// Counters from this value on make a controller passive.
    const PASSIVE: u8 = 128;

    pub(crate) const fn are_passive(self) -> bool {
        self.transmit >= Self::PASSIVE || self.receive >= Self::PASSIVE
    }
}
