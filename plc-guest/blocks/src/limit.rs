//! Limits of a value: saturation.
//!
//! Reference: `LIMIT` of IEC 61131-3:2013, table 32; H. K. Khalil, *Nonlinear Systems*, 3rd edition,
//! section 1.2.7, "saturation".

/// `value`, but at least `low` and at most `high`: `MIN(MAX(value, low), high)`.
///
/// If `low` is above `high`, `high` wins. NaN is handed on; a limit that is NaN is none. (The function
/// of `core` panics in these cases, which a control program must not.)
#[must_use]
pub fn limit(low: f64, value: f64, high: f64) -> f64 {
    let raised = if value < low { low } else { value };
    if raised > high { high } else { raised }
}

/// A limiter that says at which of its limits it is.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limiter {
    /// Least output.
    pub low: f64,
    /// Greatest output.
    pub high: f64,
    at_low: bool,
    at_high: bool,
}

impl Limiter {
    /// A limiter from `low` to `high`.
    #[must_use]
    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high, at_low: false, at_high: false }
    }

    /// The limited value. NaN is handed on, and is at no limit.
    pub fn update(&mut self, value: f64) -> f64 {
        self.at_high = value > self.high;
        self.at_low = value < self.low && !self.at_high;
        limit(self.low, value, self.high)
    }

    /// Whether the last value was below the range.
    #[must_use]
    pub const fn at_low(&self) -> bool {
        self.at_low
    }

    /// Whether the last value was above the range.
    #[must_use]
    pub const fn at_high(&self) -> bool {
        self.at_high
    }
}
