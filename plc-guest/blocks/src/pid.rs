//! PID controller for cycles of unequal length.
//!
//! `u = P (w - y) + I ∫(w - y) dt - D dy/dt`, limited, with these modifications, all of the reference:
//!
//! - Integral and derivative use the time that really passed. A lost cycle changes the result by what
//!   the plant did meanwhile, and not by an assumption.
//! - The derivative is taken of the measured value: a step of the set value must not kick the actuator.
//!   A first-order filter limits its gain at high frequencies. After a value that is not finite there is no
//!   difference to take for one call.
//! - Anti-windup by conditional integration: the integral does not move further out while the output is
//!   at its limit, and does not leave the output's range. It would have to be unwound again, which
//!   shows as an overshoot.
//! - Bumpless transfer: under manual control the integral follows, so that automatic control begins at
//!   the manual value. The integral holds `I` times the deviation, so a change of `I` makes no jump either.
//!
//! Reference: K. J. Åström, T. Hägglund, *PID Controllers: Theory, Design, and Tuning*, 2nd edition,
//! chapter 3: "Modifications of the PID algorithm", "Integrator windup", "Digital implementation",
//! "Operational aspects".

use crate::limit::limit;
use core::time::Duration;

/// What is set by the engineer. It may be changed while the controller runs.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tuning {
    /// `P`, output per unit of deviation. Negative for a plant that works the other way; then `I` and
    /// `D` are negative too.
    pub proportional: f64,
    /// `I`, output per unit of deviation and second.
    pub integral: f64,
    /// `D`, output per unit per second.
    pub derivative: f64,
    /// Time constant of the derivative's filter in seconds; 0 is none. Usual is `D / P / 10`.
    pub derivative_filter: f64,
    /// Least output; NaN is no limit.
    pub low: f64,
    /// Greatest output; NaN is no limit.
    pub high: f64,
}

impl Tuning {
    /// No gain, and an output from 0 to 1.
    pub const DEFAULT: Self = Self {
        proportional: 0.0,
        integral: 0.0,
        derivative: 0.0,
        derivative_filter: 0.0,
        low: 0.0,
        high: 1.0,
    };
}

impl Default for Tuning {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pid {
    /// Gains and limits.
    pub tuning: Tuning,
    integral: f64,
    slope: f64,
    last_measured: f64,
    output: f64,
    started: bool,
}

impl Pid {
    /// A controller at rest.
    #[must_use]
    pub const fn new(tuning: Tuning) -> Self {
        Self { tuning, integral: 0.0, slope: 0.0, last_measured: 0.0, output: 0.0, started: false }
    }

    /// One step under automatic control; returns the new output. If `set` or `measured` is not finite
    /// nothing changes, and the next step takes no new slope.
    pub fn update(&mut self, set: f64, measured: f64, elapsed: Duration) -> f64 {
        if !set.is_finite() || !measured.is_finite() {
            return self.miss();
        }
        let seconds = elapsed.as_secs_f64();
        let direct = self.direct(set, measured, seconds);
        let Tuning { integral: gain, low, high, .. } = self.tuning;
        let change = gain * (set - measured) * seconds;
        // An integral that came from manual control may be out of range: it may return, not go further.
        // Not `f64::min` and `f64::max`: of a limit that is NaN, which is none, they would make one.
        let least = if self.integral < low { self.integral } else { low };
        let most = if self.integral > high { self.integral } else { high };
        let integral = limit(least, self.integral + change, most);
        let output = direct + integral;
        let at_stop = (output > high && change > 0.0) || (output < low && change < 0.0);
        if !at_stop && integral.is_finite() {
            self.integral = integral;
        }
        self.keep(limit(low, output, high))
    }

    /// One step under manual control: the output is `manual`, limited. The integral follows, so that
    /// the next [`Self::update`] begins there. If an argument is not finite nothing changes, and the
    /// next step takes no new slope.
    pub fn track(&mut self, manual: f64, set: f64, measured: f64, elapsed: Duration) -> f64 {
        if !manual.is_finite() || !set.is_finite() || !measured.is_finite() {
            return self.miss();
        }
        let direct = self.direct(set, measured, elapsed.as_secs_f64());
        let output = limit(self.tuning.low, manual, self.tuning.high);
        let integral = output - direct;
        if integral.is_finite() {
            self.integral = integral;
        }
        self.keep(output)
    }

    /// The output of the last step.
    #[must_use]
    pub const fn output(&self) -> f64 {
        self.output
    }

    /// The integral part of the output.
    #[must_use]
    pub const fn integral(&self) -> f64 {
        self.integral
    }

    /// A step that changes nothing. Its time is in no slope: from the last measured value to the next one
    /// more passes than `elapsed` will say then.
    const fn miss(&mut self) -> f64 {
        self.started = false;
        self.output
    }

    /// Proportional and derivative part.
    fn direct(&mut self, set: f64, measured: f64, seconds: f64) -> f64 {
        if self.started && seconds > 0.0 {
            let slope = (measured - self.last_measured) / seconds;
            let filter = self.tuning.derivative_filter;
            // Backward difference of the filter, as in `lag`.
            let next = if filter > 0.0 {
                self.slope + (slope - self.slope) * (seconds / (filter + seconds))
            } else {
                slope
            };
            if next.is_finite() {
                self.slope = next;
            }
        } else if self.tuning.derivative_filter <= 0.0 {
            self.slope = 0.0;
        }
        self.last_measured = measured;
        self.started = true;
        self.tuning.proportional * (set - measured) - self.tuning.derivative * self.slope
    }

    fn keep(&mut self, output: f64) -> f64 {
        if output.is_finite() {
            self.output = output;
        }
        self.output
    }
}
