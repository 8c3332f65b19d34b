//! Fast Fourier transform of 2^n values, in place.
//!
//! `X[k] = Σ x[j] exp(-2πi jk / N)`, without a factor; [`inverse`] has the factor `1 / N`.
//!
//! Radix 2, decimation in time. The factors are products of the roots of order 2, 4, 8, ..., which come
//! from square roots alone: at most `n` roundings each, no table, and no sine (a C program
//! without a mathematical library computes the same).
//!
//! Reference: J. W. Cooley, J. W. Tukey, "An algorithm for the machine calculation of complex Fourier
//! series", *Mathematics of Computation* 19 (1965); A. V. Oppenheim, R. W. Schafer, *Discrete-Time Signal
//! Processing*, 3rd edition, section 9.2.

use crate::math::square_root;
use core::fmt;

/// Why a transform was refused. Nothing was changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FftError {
    /// A length that is no power of two.
    Length(usize),
    /// Real and imaginary parts of different number.
    Parts {
        /// How many real parts.
        real: usize,
        /// How many imaginary parts.
        imaginary: usize,
    },
}

impl fmt::Display for FftError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(length) => {
                write!(f, "{length} values: not a power of two from 1 to 2^31")
            }
            Self::Parts { real, imaginary } => {
                write!(f, "{real} real parts, but {imaginary} imaginary parts")
            }
        }
    }
}

impl core::error::Error for FftError {}

/// A complex number.
#[derive(Clone, Copy)]
struct Complex(f64, f64);

impl Complex {
    const ONE: Self = Self(1.0, 0.0);

    fn times(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }
}

/// Greatest number of stages.
const STAGES: usize = 31;

/// Transforms `real[j] + i imaginary[j]` in place. Its time is proportional to `N log N`, whatever the
/// values; NaN and infinity spread as in any sum.
///
/// # Errors
///
/// If the length is no power of two, or the parts differ in length.
pub fn transform(real: &mut [f64], imaginary: &mut [f64]) -> Result<(), FftError> {
    let length = real.len();
    if imaginary.len() != length {
        return Err(FftError::Parts { real: length, imaginary: imaginary.len() });
    }
    if !length.is_power_of_two() || length.trailing_zeros() as usize > STAGES {
        return Err(FftError::Length(length));
    }
    reverse_bits(real, imaginary);
    let roots = roots();
    for stage in 0..length.trailing_zeros() as usize {
        let half = 1 << stage;
        for turn in 0..half {
            let factor = factor(&roots, turn, stage);
            for low in (turn..length).step_by(2 * half) {
                butterfly(real, imaginary, low, low + half, factor);
            }
        }
    }
    Ok(())
}

/// The inverse of [`transform`].
///
/// # Errors
///
/// As [`transform`].
#[expect(clippy::cast_precision_loss, reason = "at most 2^31")]
pub fn inverse(real: &mut [f64], imaginary: &mut [f64]) -> Result<(), FftError> {
    // Exchanging the parts before and after conjugates both sides of the transform.
    transform(imaginary, real)?;
    let length = real.len() as f64;
    for value in real.iter_mut().chain(imaginary) {
        *value /= length;
    }
    Ok(())
}

/// Puts each value where the bits of its index say when read from the other end.
fn reverse_bits(real: &mut [f64], imaginary: &mut [f64]) {
    let length = real.len();
    let mut reversed = 0;
    for index in 1..length {
        let mut bit = length / 2;
        while reversed & bit != 0 {
            reversed ^= bit;
            bit /= 2;
        }
        reversed |= bit;
        if index < reversed {
            real.swap(index, reversed);
            imaginary.swap(index, reversed);
        }
    }
}

/// `exp(-πi / 2^k)` for each `k`, by halving the angle.
fn roots() -> [Complex; STAGES] {
    let mut roots = [Complex(-1.0, 0.0); STAGES];
    roots[1] = Complex(0.0, -1.0);
    for k in 2..STAGES {
        let Complex(cos, sin) = roots[k - 1];
        let half_cos = square_root((1.0 + cos) / 2.0);
        // From sin 2a = 2 sin a cos a: no difference of near numbers.
        roots[k] = Complex(half_cos, sin / (2.0 * half_cos));
    }
    roots
}

/// `exp(-πi turn / 2^stage)`.
fn factor(roots: &[Complex; STAGES], turn: usize, stage: usize) -> Complex {
    let bits = (0..stage).filter(|bit| turn & (1 << bit) != 0);
    bits.fold(Complex::ONE, |factor, bit| factor.times(roots[stage - bit]))
}

fn butterfly(real: &mut [f64], imaginary: &mut [f64], low: usize, high: usize, factor: Complex) {
    let odd = Complex(real[high], imaginary[high]).times(factor);
    (real[high], imaginary[high]) = (real[low] - odd.0, imaginary[low] - odd.1);
    real[low] += odd.0;
    imaginary[low] += odd.1;
}
