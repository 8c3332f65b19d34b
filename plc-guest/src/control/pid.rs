//! A PID controller for cycles of unequal length.
//!
//! The integral and the derivative use the time that really passed, so that a lost cycle changes
//! the result by what the plant did meanwhile and not by an assumption. The integral is clamped to
//! the output range and does not move further while the output is at its stop anyway (it would have
//! to be unwound again, which shows as an overshoot). The derivative is taken of the measured value
//! (a step of the set value must not kick the valve).

use core::time::Duration;

/// Gains: per unit of deviation, per unit and second, per unit per second.
#[derive(Clone, Copy, Debug)]
pub struct Gains {
    /// Proportional gain.
    pub proportional: f64,
    /// Integral gain, 1/s.
    pub integral: f64,
    /// Derivative gain, s.
    pub derivative: f64,
}

/// A controller with an output from 0 to 1.
#[derive(Debug)]
pub struct Pid {
    gains: Gains,
    integral: f64,
    last_measured: Option<f64>,
}

impl Pid {
    /// A controller at rest.
    #[must_use]
    pub const fn new(gains: Gains) -> Self {
        Self { gains, integral: 0.0, last_measured: None }
    }

    /// One step; returns the new output, 0 to 1.
    pub fn update(&mut self, set: f64, measured: f64, elapsed: Duration) -> f64 {
        let seconds = elapsed.as_secs_f64();
        let deviation = set - measured;
        let slope = match self.last_measured {
            Some(last) if seconds > 0.0 => (measured - last) / seconds,
            _ => 0.0,
        };
        self.last_measured = Some(measured);
        let direct = self.gains.proportional * deviation - self.gains.derivative * slope;
        let change = self.gains.integral * deviation * seconds;
        let integral = (self.integral + change).clamp(0.0, 1.0);
        let output = direct + integral;
        let at_stop = (output > 1.0 && change > 0.0) || (output < 0.0 && change < 0.0);
        if !at_stop {
            self.integral = integral;
        }
        output.clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: Duration = Duration::from_millis(10);

    fn pid(proportional: f64, integral: f64, derivative: f64) -> Pid {
        Pid::new(Gains { proportional, integral, derivative })
    }

    #[test]
    fn the_output_stays_in_its_range() {
        let mut high = pid(100.0, 0.0, 0.0);
        assert_eq!(high.update(1.0, 0.0, STEP), 1.0);
        assert_eq!(high.update(0.0, 1.0, STEP), 0.0);
    }

    #[test]
    fn the_integral_depends_on_time_and_not_on_the_number_of_steps() {
        let (mut fine, mut coarse) = (pid(0.0, 0.1, 0.0), pid(0.0, 0.1, 0.0));
        let mut after_fine = 0.0;
        for _ in 0..100 {
            after_fine = fine.update(1.0, 0.0, STEP);
        }
        let after_coarse = coarse.update(1.0, 0.0, STEP * 100);
        assert!((after_fine - 0.1).abs() < 1e-9);
        assert!((after_coarse - 0.1).abs() < 1e-9);
    }

    #[test]
    fn the_integral_does_not_wind_up() {
        let mut pid = pid(0.0, 1.0, 0.0);
        for _ in 0..100_000 {
            pid.update(1.0, 0.0, STEP);
        }
        // From the stop it must come back at once, one second per unit.
        let output = pid.update(0.0, 1.0, Duration::from_millis(500));
        assert!((output - 0.5).abs() < 1e-9, "{output}");
    }

    #[test]
    fn the_integral_stands_still_while_the_output_is_at_its_stop() {
        let mut pid = pid(2.0, 0.1, 0.0);
        for _ in 0..500 {
            assert_eq!(pid.update(1.0, 0.0, STEP), 1.0);
        }
        assert!(pid.update(1.0, 1.0, STEP) < 1e-9);
    }

    #[test]
    fn a_step_of_the_set_value_gives_no_derivative_kick() {
        let mut pid = pid(0.1, 0.0, 10.0);
        pid.update(0.0, 0.0, STEP);
        assert!((pid.update(1.0, 0.0, STEP) - 0.1).abs() < 1e-9);
    }

    #[test]
    fn no_time_is_no_division() {
        let mut pid = pid(0.5, 1.0, 1.0);
        pid.update(1.0, 0.0, Duration::ZERO);
        let output = pid.update(1.0, 0.2, Duration::ZERO);
        assert!((output - 0.4).abs() < 1e-9, "{output}");
    }
}
