//! Delay by a number of calls: dead time, shift register.
//!
//! Reference: A. V. Oppenheim, R. W. Schafer, *Discrete-Time Signal Processing*, 3rd edition, example
//! 2.2, "ideal delay system".

/// `y[n] = u[n - calls]`, up to `N` calls.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delay<const N: usize> {
    /// How many calls to delay by; more than `N` is `N`. It may be changed while the block runs.
    pub calls: u32,
    newest: u32,
    held: u32,
    history: [f64; N],
}

impl<const N: usize> Default for Delay<N> {
    /// A delay of no calls.
    fn default() -> Self {
        Self::new(0)
    }
}

impl<const N: usize> Delay<N> {
    /// A delay by `calls` that has seen nothing yet.
    #[must_use]
    pub const fn new(calls: u32) -> Self {
        Self { calls, newest: 0, held: 0, history: [0.0; N] }
    }

    /// The input of `calls` calls ago, or the oldest one there is. NaN and infinity are delayed as any
    /// number: they leave again.
    pub fn update(&mut self, input: f64) -> f64 {
        let back = (self.calls as usize).min(N).min(self.held as usize);
        let output = match back {
            0 => input,
            _ => self.history[(self.newest as usize % N + N + 1 - back) % N],
        };
        if N > 0 {
            let place = (self.newest as usize % N + 1) % N;
            self.history[place] = input;
            self.newest = place as u32;
            self.held = (self.held as usize).saturating_add(1).min(N) as u32;
        }
        output
    }
}
