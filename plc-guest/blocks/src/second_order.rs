//! Second-order filter: `y'' + 2 D w y' + w² y = w² u` (PT2).
//!
//! Computed by the backward difference of both states, which is stable for every cycle time. It adds
//! damping of about `w elapsed / 2`, so take `w` times the cycle time below 0.1 where overshoot counts.
//!
//! Reference: G. F. Franklin, J. D. Powell, A. Emami-Naeini, *Feedback Control of Dynamic Systems*, 7th
//! edition, section 3.3 (the form and its step response); K. J. Åström, B. Wittenmark,
//! *Computer-Controlled Systems*, 3rd edition, section 8.2 (backward difference).

use core::time::Duration;

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SecondOrder {
    /// Natural angular frequency `w` in rad/s. At zero or less the output is the input.
    pub frequency: f64,
    /// Damping ratio `D`: 1 is critical damping, 0.707 is Butterworth's, below 1 the output overshoots.
    pub damping: f64,
    output: f64,
    rate: f64,
    started: bool,
}

impl SecondOrder {
    /// A filter whose output begins at its first input, at rest.
    #[must_use]
    pub const fn new(frequency: f64, damping: f64) -> Self {
        Self { frequency, damping, output: 0.0, rate: 0.0, started: false }
    }

    /// A filter whose output begins at `output`, at rest.
    #[must_use]
    pub const fn starting_at(frequency: f64, damping: f64, output: f64) -> Self {
        Self { frequency, damping, output, rate: 0.0, started: true }
    }

    /// The filtered value.
    pub fn update(&mut self, input: f64, elapsed: Duration) -> f64 {
        if !input.is_finite() {
            return self.output;
        }
        let seconds = elapsed.as_secs_f64();
        let (rate, output) = if self.started && self.frequency > 0.0 {
            let turn = self.frequency * seconds;
            let pull = turn * self.frequency * (input - self.output);
            let rate = (self.rate + pull) / (1.0 + 2.0 * self.damping * turn + turn * turn);
            (rate, self.output + rate * seconds)
        } else {
            (0.0, input)
        };
        if rate.is_finite() && output.is_finite() {
            (self.rate, self.output, self.started) = (rate, output, true);
        }
        self.output
    }

    /// The output of the last update.
    #[must_use]
    pub const fn output(&self) -> f64 {
        self.output
    }

    /// Change of the output in units per second.
    #[must_use]
    pub const fn rate(&self) -> f64 {
        self.rate
    }
}
