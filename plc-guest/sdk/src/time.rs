//! TIME of IEC 61131-3.

use core::time::Duration;

/// A span of time as points have it: nanoseconds, which may be negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(transparent)]
pub struct Time(i64);

impl Time {
    /// No time.
    pub const ZERO: Self = Self(0);

    /// So many nanoseconds.
    #[must_use]
    pub const fn from_nanos(nanoseconds: i64) -> Self {
        Self(nanoseconds)
    }

    /// So many milliseconds; what is too long is the longest time.
    #[must_use]
    pub const fn from_millis(milliseconds: i64) -> Self {
        Self(milliseconds.saturating_mul(1_000_000))
    }

    /// The nanoseconds.
    #[must_use]
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// The same as function blocks and `core` want it; a negative time is none.
    #[must_use]
    pub const fn duration(self) -> Duration {
        Duration::from_nanos(if self.0 < 0 { 0 } else { self.0 as u64 })
    }
}

impl From<Duration> for Time {
    /// What is too long is the longest time, 292 years.
    fn from(duration: Duration) -> Self {
        Self(i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_made_of_durations_and_back() {
        let time = Time::from(Duration::from_micros(1_500));
        assert_eq!((time, time.as_nanos()), (Time::from_nanos(1_500_000), 1_500_000));
        assert_eq!(time.duration(), Duration::from_micros(1_500));
        assert_eq!(Time::from_millis(-2).as_nanos(), -2_000_000);
        assert_eq!(Time::from_millis(-2).duration(), Duration::ZERO);
        assert_eq!(Time::from(Duration::MAX), Time::from_nanos(i64::MAX));
        assert_eq!(Time::from_millis(i64::MAX).as_nanos(), i64::MAX);
        assert!(Time::from_millis(-1) < Time::ZERO);
    }
}
