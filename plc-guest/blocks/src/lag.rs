//! First-order filter: `T dy/dt + y = u` (PT1, RC low-pass).
//!
//! Computed by the backward difference, `y += (u - y) elapsed / (T + elapsed)`. It is stable and
//! without overshoot for every cycle time, and needs no exponential. With a cycle of a tenth of `T` the
//! step response is at most 2 % of the step away from the exact one.
//!
//! Reference: K. J. Åström, B. Wittenmark, *Computer-Controlled Systems*, 3rd edition, section 8.2.

use core::time::Duration;

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lag {
    /// `T` in seconds. At zero or less the output is the input.
    pub time_constant: f64,
    output: f64,
    started: bool,
}

impl Lag {
    /// A filter whose output begins at its first input.
    #[must_use]
    pub const fn new(time_constant: f64) -> Self {
        Self { time_constant, output: 0.0, started: false }
    }

    /// A filter whose output begins at `output`.
    #[must_use]
    pub const fn starting_at(time_constant: f64, output: f64) -> Self {
        Self { time_constant, output, started: true }
    }

    /// The filtered value.
    pub fn update(&mut self, input: f64, elapsed: Duration) -> f64 {
        if !input.is_finite() {
            return self.output;
        }
        let seconds = elapsed.as_secs_f64();
        let next = if self.started && self.time_constant > 0.0 {
            self.output + (input - self.output) * (seconds / (self.time_constant + seconds))
        } else {
            input
        };
        if next.is_finite() {
            self.output = next;
            self.started = true;
        }
        self.output
    }

    /// The output of the last update.
    #[must_use]
    pub const fn output(&self) -> f64 {
        self.output
    }
}
