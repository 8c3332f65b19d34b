//! Second-order section of an IIR filter, for programs with a fixed period.
//!
//! Filters of higher order are chains of sections: each takes the output of the one before it.
//! Coefficients come from [`Coefficients`]'s designs, or from any tool for filters. Unlike the other
//! blocks a section knows no time: its frequencies are those of the period that it was designed for.
//!
//! Reference: A. V. Oppenheim, R. W. Schafer, *Discrete-Time Signal Processing*, 3rd edition, section
//! 6.3 (transposed direct form II); R. Bristow-Johnson, "Audio EQ Cookbook", W3C Working Group Note,
//! 2021 (the designs, by bilinear transform).

use crate::math::sine_and_cosine;
use core::f64::consts::{FRAC_1_SQRT_2, TAU};

/// `H(z) = (b0 + b1 z⁻¹ + b2 z⁻²) / (1 + a1 z⁻¹ + a2 z⁻²)`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[expect(missing_docs, reason = "the names are those of the formula")]
pub struct Coefficients {
    pub b0: f64,
    pub b1: f64,
    pub b2: f64,
    pub a1: f64,
    pub a2: f64,
}

/// Quality of a Butterworth filter of second order.
pub const BUTTERWORTH: f64 = FRAC_1_SQRT_2;

impl Coefficients {
    /// Low-pass: `corner` is the corner frequency divided by the sampling frequency, above 0 and below
    /// 0.5; `quality` is positive. At the corner the gain is `quality`.
    #[must_use]
    pub fn low_pass(corner: f64, quality: f64) -> Self {
        let (cos, alpha) = Self::angle(corner, quality);
        let b1 = 1.0 - cos;
        Self::normalised([b1 / 2.0, b1, b1 / 2.0], cos, alpha)
    }

    /// High-pass, with the arguments of [`Self::low_pass`].
    #[must_use]
    pub fn high_pass(corner: f64, quality: f64) -> Self {
        let (cos, alpha) = Self::angle(corner, quality);
        let b1 = 1.0 + cos;
        Self::normalised([b1 / 2.0, -b1, b1 / 2.0], cos, alpha)
    }

    /// Band-pass with gain 1 at `centre`; its width is `centre / quality`.
    #[must_use]
    pub fn band_pass(centre: f64, quality: f64) -> Self {
        let (cos, alpha) = Self::angle(centre, quality);
        Self::normalised([alpha, 0.0, -alpha], cos, alpha)
    }

    /// Notch with gain 0 at `centre`; its width is `centre / quality`.
    #[must_use]
    pub fn notch(centre: f64, quality: f64) -> Self {
        let (cos, alpha) = Self::angle(centre, quality);
        Self::normalised([1.0, -2.0 * cos, 1.0], cos, alpha)
    }

    fn angle(frequency: f64, quality: f64) -> (f64, f64) {
        let (sin, cos) = sine_and_cosine(TAU * frequency);
        (cos, sin / (2.0 * quality))
    }

    fn normalised(b: [f64; 3], cos: f64, alpha: f64) -> Self {
        let a0 = 1.0 + alpha;
        Self {
            b0: b[0] / a0,
            b1: b[1] / a0,
            b2: b[2] / a0,
            a1: -2.0 * cos / a0,
            a2: (1.0 - alpha) / a0,
        }
    }
}

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Biquad {
    /// The transfer function. It may be changed while the filter runs; the state goes on.
    pub coefficients: Coefficients,
    state: [f64; 2],
    output: f64,
}

impl Biquad {
    /// A section at rest: all inputs before the first were zero.
    #[must_use]
    pub const fn new(coefficients: Coefficients) -> Self {
        Self { coefficients, state: [0.0; 2], output: 0.0 }
    }

    /// The filtered value; to be called once a period.
    pub fn update(&mut self, input: f64) -> f64 {
        let Coefficients { b0, b1, b2, a1, a2 } = self.coefficients;
        let output = b0 * input + self.state[0];
        let state = [b1 * input - a1 * output + self.state[1], b2 * input - a2 * output];
        if output.is_finite() && state[0].is_finite() && state[1].is_finite() {
            self.state = state;
            self.output = output;
        }
        self.output
    }

    /// The output of the last update.
    #[must_use]
    pub const fn output(&self) -> f64 {
        self.output
    }
}
