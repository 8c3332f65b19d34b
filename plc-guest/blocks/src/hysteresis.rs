//! Hysteresis: a switch with two thresholds (Schmitt trigger).
//!
//! Between the thresholds the output stays as it is, so noise smaller than their distance cannot make
//! it chatter.
//!
//! Reference: O. H. Schmitt, "A thermionic trigger", *Journal of Scientific Instruments* 15 (1938);
//! H. K. Khalil, *Nonlinear Systems*, 3rd edition, section 1.2.7, "relay with hysteresis".

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hysteresis {
    /// The output goes to FALSE below this.
    pub low: f64,
    /// The output goes to TRUE above this.
    pub high: f64,
    output: bool,
}

impl Hysteresis {
    /// A switch that is off.
    #[must_use]
    pub const fn new(low: f64, high: f64) -> Self {
        Self { low, high, output: false }
    }

    /// The new output. NaN changes nothing; infinity is above or below as any number. If `low` is above
    /// `high` and the value is between them, the output goes to TRUE.
    pub fn update(&mut self, value: f64) -> bool {
        if value > self.high {
            self.output = true;
        } else if value < self.low {
            self.output = false;
        }
        self.output
    }

    /// The output of the last update.
    #[must_use]
    pub const fn output(&self) -> bool {
        self.output
    }
}
