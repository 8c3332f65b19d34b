//! A simulated tank: the plant of the demonstration program.
//!
//! Water enters through a valve and leaves through a hole in the bottom as fast as Torricelli
//! says, sqrt(2 g h). The root makes the plant nonlinear, so that a controller has to work.

use core::arch::x86_64::{_mm_cvtsd_f64, _mm_set_sd, _mm_sqrt_sd};
use core::time::Duration;

/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.806_65;
/// Cross-section of the tank, m^2.
const AREA: f64 = 0.1;
/// Cross-section of the outflow, m^2.
const HOLE: f64 = 0.002;
/// Inflow with the valve open, m^3/s.
const INFLOW: f64 = 0.03;
/// Height of the tank, m; what is above runs over.
const HEIGHT: f64 = 3.0;

/// See the [module](self).
#[derive(Debug, Default)]
pub struct Tank {
    level: f64,
}

impl Tank {
    /// Height of the water in metres.
    #[must_use]
    pub const fn level(&self) -> f64 {
        self.level
    }

    /// Lets time pass with the valve at a position from 0 to 1.
    pub fn update(&mut self, valve: f64, elapsed: Duration) {
        let inflow = INFLOW * valve.clamp(0.0, 1.0);
        let outflow = HOLE * square_root(2.0 * GRAVITY * self.level);
        let change = (inflow - outflow) / AREA * elapsed.as_secs_f64();
        self.level = (self.level + change).clamp(0.0, HEIGHT);
    }
}

/// `core` has no square root on this toolchain; the processor has.
fn square_root(value: f64) -> f64 {
    // SAFETY: the instructions are SSE2, which every x86-64 processor has and the build's target
    // takes for granted.
    unsafe {
        let value = _mm_set_sd(value);
        _mm_cvtsd_f64(_mm_sqrt_sd(value, value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::pid::{Gains, Pid};

    const STEP: Duration = Duration::from_millis(1);

    #[test]
    fn settles_where_inflow_equals_outflow() {
        let mut tank = Tank::default();
        for _ in 0..600_000 {
            tank.update(0.4, STEP);
        }
        // (0.4 * INFLOW / HOLE)^2 / 2g = 36 / 19.6133 m
        assert!((tank.level() - 1.835_489).abs() < 1e-4, "{}", tank.level());
    }

    #[test]
    fn neither_runs_below_empty_nor_above_full() {
        let mut tank = Tank::default();
        tank.update(1.0, Duration::from_secs(1_000));
        assert_eq!(tank.level(), HEIGHT);
        tank.update(0.0, Duration::from_secs(1_000));
        assert_eq!(tank.level(), 0.0);
        tank.update(-1.0, STEP);
        assert_eq!(tank.level(), 0.0);
    }

    #[test]
    fn the_controller_holds_the_level_even_when_cycles_are_lost() {
        let mut tank = Tank::default();
        let mut pid = Pid::new(Gains { proportional: 4.0, integral: 0.5, derivative: 0.2 });
        let mut valve = 0.0;
        for cycle in 0..60_000 {
            let elapsed = if cycle % 100 == 0 { STEP * 20 } else { STEP };
            tank.update(valve, elapsed);
            valve = pid.update(1.2, tank.level(), elapsed);
        }
        assert!((tank.level() - 1.2).abs() < 1e-3, "{}", tank.level());
    }
}
