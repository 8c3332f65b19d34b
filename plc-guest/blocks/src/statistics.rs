//! Moving statistics: mean, standard deviation, least and greatest of the last `N` values.
//!
//! Each is computed anew from the values when it is asked for. Sums that are kept up to date by adding
//! the newest and subtracting the oldest drift with every rounding, for as long as the PLC runs.
//!
//! Reference: N. J. Higham, *Accuracy and Stability of Numerical Algorithms*, 2nd edition, section 1.9
//! (the two-pass formula of the variance).

use crate::math::square_root;

/// See the [module](self).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Statistics<const N: usize> {
    newest: u32,
    held: u32,
    values: [f64; N],
}

impl<const N: usize> Default for Statistics<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Statistics<N> {
    /// Without values.
    #[must_use]
    pub const fn new() -> Self {
        Self { newest: 0, held: 0, values: [0.0; N] }
    }

    /// Takes a value in, and drops the oldest if there are `N`. One that is not finite is left out.
    pub fn update(&mut self, value: f64) {
        if N == 0 || !value.is_finite() {
            return;
        }
        let place = self.newest as usize % N;
        self.values[place] = value;
        self.newest = ((place + 1) % N) as u32;
        self.held = (self.held as usize).saturating_add(1).min(N) as u32;
    }

    /// Forgets all values.
    pub fn reset(&mut self) {
        self.held = 0;
        self.newest = 0;
    }

    /// How many values there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.held().len()
    }

    /// Their mean; 0 without values.
    #[must_use]
    pub fn mean(&self) -> f64 {
        match self.held() {
            [] => 0.0,
            held => held.iter().sum::<f64>() / length(held),
        }
    }

    /// Their variance as a sample, with `count - 1` below the line; 0 with fewer than two values.
    #[must_use]
    pub fn variance(&self) -> f64 {
        let held = self.held();
        if held.len() < 2 {
            return 0.0;
        }
        let mean = self.mean();
        let squares = held.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>();
        squares / (length(held) - 1.0)
    }

    /// Root of the [variance](Self::variance).
    #[must_use]
    pub fn standard_deviation(&self) -> f64 {
        square_root(self.variance())
    }

    /// The least value; 0 without values.
    #[must_use]
    pub fn least(&self) -> f64 {
        self.held().iter().copied().reduce(f64::min).unwrap_or(0.0)
    }

    /// The greatest value; 0 without values.
    #[must_use]
    pub fn greatest(&self) -> f64 {
        self.held().iter().copied().reduce(f64::max).unwrap_or(0.0)
    }

    fn held(&self) -> &[f64] {
        // Until there are `N` the values lie at the beginning.
        &self.values[..(self.held as usize).min(N)]
    }
}

#[expect(clippy::cast_precision_loss, reason = "no window has 2^53 values")]
fn length(values: &[f64]) -> f64 {
    values.len() as f64
}
