//! Ramp: the output follows the input no faster than it may (rate limiter).
//!
//! Reference: K. J. Åström, T. Hägglund, *PID Controllers: Theory, Design, and Tuning*, 2nd edition,
//! chapter 3, "rate limiter"; the ramp block of PuffinPLC's dsp module.

use core::time::Duration;

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ramp {
    /// Fastest rise in units per second, at least 0.
    pub up: f64,
    /// Fastest fall in units per second, at least 0.
    pub down: f64,
    output: f64,
}

impl Ramp {
    /// A ramp that stands at `output`.
    #[must_use]
    pub const fn new(up: f64, down: f64, output: f64) -> Self {
        Self { up, down, output }
    }

    /// The new output: `input`, or as near to it as the rates allow. A rate below zero, or NaN, is one
    /// of zero; one of infinity is none.
    pub fn update(&mut self, input: f64, elapsed: Duration) -> f64 {
        let seconds = elapsed.as_secs_f64();
        let distance = input - self.output;
        let reach = if distance > 0.0 { self.up } else { self.down } * seconds;
        if !distance.is_finite() {
            return self.output;
        }
        if distance.abs() <= reach {
            self.output = input;
        } else if reach > 0.0 {
            self.output += if distance > 0.0 { reach } else { -reach };
        }
        self.output
    }

    /// The output of the last update.
    #[must_use]
    pub const fn output(&self) -> f64 {
        self.output
    }

    /// Stands at `output` from now on, for a start without a jump.
    pub fn set(&mut self, output: f64) {
        if output.is_finite() {
            self.output = output;
        }
    }
}
