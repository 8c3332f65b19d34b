//! Scaling: from one range to another along a straight line, such as 4 to 20 mA to 0 to 100 %.
//!
//! The line goes on outside of the ranges: a sensor at 3.8 mA shows -1.25 %, and a [`crate::Limiter`]
//! behind it decides what is to be done about that.
//!
//! Reference: linear interpolation through two points (Lagrange's form of degree 1).

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Scale {
    /// First point of the input's range.
    pub in_low: f64,
    /// Second point of the input's range.
    pub in_high: f64,
    /// Output at `in_low`.
    pub out_low: f64,
    /// Output at `in_high`.
    pub out_high: f64,
}

impl Scale {
    /// Maps `in_low` to `out_low` and `in_high` to `out_high`.
    #[must_use]
    pub const fn new(in_low: f64, in_high: f64, out_low: f64, out_high: f64) -> Self {
        Self { in_low, in_high, out_low, out_high }
    }

    /// The scaled value; NaN is handed on. An input range of no width gives `out_low`.
    #[must_use]
    pub fn update(&self, value: f64) -> f64 {
        let span = self.in_high - self.in_low;
        if value.is_nan() {
            return value;
        }
        if span == 0.0 {
            return self.out_low;
        }
        self.out_low + (value - self.in_low) / span * (self.out_high - self.out_low)
    }
}
