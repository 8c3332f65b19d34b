//! Bistable blocks `SR` and `RS`: memory of one bit.
//!
//! They differ in which input wins if both are TRUE.
//!
//! Reference: IEC 61131-3:2013, table 43.

/// Set dominates: `Q1 := S1 OR (NOT R AND Q1)`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sr {
    q1: bool,
}

impl Sr {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { q1: false }
    }

    /// The new output.
    pub const fn update(&mut self, set: bool, reset: bool) -> bool {
        self.q1 = set || (!reset && self.q1);
        self.q1
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q1(&self) -> bool {
        self.q1
    }
}

/// Reset dominates: `Q1 := NOT R1 AND (S OR Q1)`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rs {
    q1: bool,
}

impl Rs {
    /// As after a cold start.
    #[must_use]
    pub const fn new() -> Self {
        Self { q1: false }
    }

    /// The new output.
    pub const fn update(&mut self, set: bool, reset: bool) -> bool {
        self.q1 = !reset && (set || self.q1);
        self.q1
    }

    /// The output of the last update.
    #[must_use]
    pub const fn q1(&self) -> bool {
        self.q1
    }
}
