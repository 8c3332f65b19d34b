//! The clock that all partitions share.

use std::time::Duration;

use takt_channel::{Ticks, Tsc};

/// The time-stamp counter, which has the same value in every partition, and its frequency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    khz: u64,
}

impl Clock {
    /// A counter of this many ticks in a millisecond.
    pub(crate) fn new(khz: u64) -> Clock {
        Clock { khz }
    }

    /// Now. The processor may read the counter a few instructions early or late.
    #[must_use]
    #[allow(unsafe_code)]
    pub fn now(self) -> Tsc {
        // SAFETY: every x86-64 processor has the instruction, and Linux does not disable it for
        // user space unless the process asks for that (PR_SET_TSC).
        Tsc(unsafe { std::arch::x86_64::_rdtsc() })
    }

    /// A number of ticks in nanoseconds, rounded down; the largest number if it does not fit.
    #[must_use]
    pub fn nanoseconds(self, ticks: Ticks) -> u64 {
        let ns = u128::from(ticks.0) * 1_000_000 / u128::from(self.khz.max(1));
        u64::try_from(ns).unwrap_or(u64::MAX)
    }

    /// A time in ticks, rounded down, but at least one.
    pub(crate) fn ticks(self, time: Duration) -> Ticks {
        let ticks = time.as_nanos().saturating_mul(u128::from(self.khz)) / 1_000_000;
        Ticks(u64::try_from(ticks).unwrap_or(u64::MAX).max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_and_nanoseconds_agree_and_never_overflow() {
        let clock = Clock::new(2_500_000);
        assert_eq!(clock.nanoseconds(Ticks(5_000)), 2_000);
        assert_eq!(clock.ticks(Duration::from_micros(2)), Ticks(5_000));
        assert_eq!(clock.ticks(Duration::ZERO), Ticks(1));
        assert_eq!(clock.ticks(Duration::MAX), Ticks(u64::MAX));
        assert_eq!(Clock::new(1).nanoseconds(Ticks(u64::MAX)), u64::MAX);
        assert_eq!(Clock::new(0).nanoseconds(Ticks(1)), 1_000_000);
    }

    #[test]
    fn the_counter_goes_forward() {
        let clock = Clock::new(1);
        let before = clock.now();
        assert!(clock.now() >= before);
    }
}
