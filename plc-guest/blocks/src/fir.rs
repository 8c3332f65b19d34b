//! FIR filter: a weighted sum of the last `N` inputs, for programs with a fixed period.
//!
//! Reference: A. V. Oppenheim, R. W. Schafer, *Discrete-Time Signal Processing*, 3rd edition, section
//! 6.5 (direct form).

/// `y[n] = c[0] u[n] + c[1] u[n-1] + ... + c[N-1] u[n-N+1]`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fir<const N: usize> {
    /// The impulse response.
    pub coefficients: [f64; N],
    history: [f64; N],
    output: f64,
    newest: u32,
}

impl<const N: usize> Default for Fir<N> {
    /// All coefficients zero: the output stays zero.
    fn default() -> Self {
        Self::new([0.0; N])
    }
}

impl<const N: usize> Fir<N> {
    /// A filter at rest: all inputs before the first were zero.
    #[must_use]
    pub const fn new(coefficients: [f64; N]) -> Self {
        Self { coefficients, history: [0.0; N], output: 0.0, newest: 0 }
    }

    /// A moving average over `N` inputs.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "no filter has 2^53 coefficients")]
    pub const fn average() -> Self {
        Self::new([1.0 / N as f64; N])
    }

    /// The filtered value; to be called once a period. An input that is not finite is left out, as if
    /// there had been no call.
    pub fn update(&mut self, input: f64) -> f64 {
        if N == 0 || !input.is_finite() {
            return self.output;
        }
        // The newest goes before the last one, so the history read on from it is in order of age.
        let newest = (self.newest as usize).min(N).checked_sub(1).unwrap_or(N - 1);
        self.history[newest] = input;
        self.newest = newest as u32;
        let (after, before) = self.history.split_at(newest);
        let by_age = before.iter().chain(after);
        let output = self.coefficients.iter().zip(by_age).map(|(c, u)| c * u).sum::<f64>();
        if output.is_finite() {
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
