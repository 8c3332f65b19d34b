//! Dead band: small values count as zero.
//!
//! Between controller and valve it keeps noise from wearing the valve out. The rest is moved towards
//! zero by the width, so the output has no step at the edge of the band.
//!
//! Reference: H. K. Khalil, *Nonlinear Systems*, 3rd edition, section 1.2.7, "dead zone".

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeadBand {
    /// Half the width of the band, at least 0, in the unit of the value.
    pub width: f64,
}

impl DeadBand {
    /// A dead band from `-width` to `width`.
    #[must_use]
    pub const fn new(width: f64) -> Self {
        Self { width }
    }

    /// 0 inside the band; outside of it, the distance to the band with its sign. NaN is handed on.
    #[must_use]
    pub fn update(&self, value: f64) -> f64 {
        if value > self.width {
            value - self.width
        } else if value < -self.width {
            value + self.width
        } else {
            // NaN is neither above nor below.
            value * 0.0
        }
    }
}
