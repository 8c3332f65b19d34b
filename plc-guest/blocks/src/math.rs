//! What `core` lacks: square root, sine and cosine.
//!
//! The crate has no dependencies, so that a project that `takt plc new` made needs nothing of the network.

use core::arch::x86_64::{_mm_cvtsd_f64, _mm_set_sd, _mm_sqrt_sd};

/// Square root, rounded to the nearest as IEEE 754 asks.
pub(crate) fn square_root(value: f64) -> f64 {
    // SAFETY: the instructions are SSE2, which every x86-64 processor has.
    unsafe {
        let value = _mm_set_sd(value);
        _mm_cvtsd_f64(_mm_sqrt_sd(value, value))
    }
}

/// How often the angle is halved before the series.
const HALVINGS: i32 = 4;

/// Sine and cosine of an angle from 0 to pi, within 2e-15: their Taylor series at a sixteenth of the angle, then the
/// formulas of the double angle.
pub(crate) fn sine_and_cosine(angle: f64) -> (f64, f64) {
    let small = angle / f64::from(1 << HALVINGS);
    let square = small * small;
    // The least terms first: x^13 / 13! is below 1e-18 here.
    let (mut sine, mut versine) = (1.0, 1.0);
    for k in (1..=6).rev() {
        let k = f64::from(k);
        sine = 1.0 - square / (2.0 * k * (2.0 * k + 1.0)) * sine;
        versine = 1.0 - square / ((2.0 * k + 1.0) * (2.0 * k + 2.0)) * versine;
    }
    sine *= small;
    // 1 - cos, which keeps its digits where cos is near 1.
    versine *= square / 2.0;
    for _ in 0..HALVINGS {
        (sine, versine) = (2.0 * sine * (1.0 - versine), 2.0 * sine * sine);
    }
    (sine, 1.0 - versine)
}

#[cfg(test)]
mod tests {
    use super::sine_and_cosine;

    #[test]
    fn sine_and_cosine_are_those_of_the_standard_library() {
        extern crate std;
        for step in 0..=10_000 {
            let angle = core::f64::consts::PI * f64::from(step) / 10_000.0;
            let (sine, cosine) = sine_and_cosine(angle);
            assert!((sine - angle.sin()).abs() < 2e-15, "sin {angle}: {sine}");
            assert!((cosine - angle.cos()).abs() < 2e-15, "cos {angle}: {cosine}");
        }
    }
}
