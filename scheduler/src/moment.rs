//! Both clocks at one moment.
//!
//! The schedule lies on the TSC, and the kernel's timers go by CLOCK_MONOTONIC. To set one for an instant
//! of the schedule, a thread needs what both say at the same time. An interrupt between the two readings sets them
//! apart by as much as it takes, so this is the one place that reads them.

use crate::time::{Nanos, Tsc, TscFrequency};

/// Two readings of the counter with one of the clock between them are one moment if they are no
/// further apart; otherwise something has interrupted them.
const APART: Nanos = Nanos::from_micros(1);

/// How far the two clocks may differ, as a part of the time that has passed: more than ADJ_TICK and ADJ_FREQUENCY allow
/// together.
pub const STEERING_PART: u64 = 8;

/// Both clocks at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// The counter.
    pub tsc: Tsc,
    /// CLOCK_MONOTONIC.
    pub clock: Nanos,
}

impl Moment {
    /// Reads the counter, then the clock. An interrupt between the two would make a sleep end late by
    /// what it takes, so they are read once more if it seems that there was one.
    #[must_use]
    pub fn now(frequency: TscFrequency) -> Moment {
        Moment::within(APART, frequency)
            .unwrap_or_else(|| Moment { tsc: Tsc::now(), clock: monotonic() })
    }

    /// Reads the counter, then the clock; `None` if that has taken longer than `time`.
    #[must_use]
    pub fn within(time: Nanos, frequency: TscFrequency) -> Option<Moment> {
        let tsc = Tsc::now();
        let clock = monotonic();
        (Tsc::now().since(tsc) <= frequency.ticks(time)).then_some(Moment { tsc, clock })
    }

    /// What the clock says at an instant from this moment on, as far as it keeps its rate; that of the
    /// moment itself for an instant that has passed.
    #[must_use]
    pub fn clock_at(self, instant: Tsc, frequency: TscFrequency) -> Nanos {
        self.clock.plus(frequency.nanos(instant.since(self.tsc)))
    }

    /// The same of a clock that goes on as it did when it went so many ns ahead of the counter in such a time; of
    /// one that would stand still or go backwards so, as if it kept its rate.
    #[must_use]
    pub fn clock_at_rate(
        self,
        (ahead, Nanos(passed)): (i64, Nanos),
        instant: Tsc,
        frequency: TscFrequency,
    ) -> Nanos {
        let Nanos(wait) = self.clock_at(instant, frequency).less(self.clock);
        let wait = i128::from(wait);
        let astray = wait.saturating_mul(i128::from(ahead)) / i128::from(passed.max(1));
        let there = if astray.abs() < wait { wait + astray } else { wait };
        self.clock.plus(Nanos(u64::try_from(there).unwrap_or(u64::MAX)))
    }

    /// How many ns the clock has gone ahead of the counter since an earlier moment, and how long that is
    /// ago by the counter; nothing if the counter has gone back.
    #[must_use]
    pub fn ahead_since(self, earlier: Moment, frequency: TscFrequency) -> (i64, Nanos) {
        let passed = frequency.nanos(self.tsc.since(earlier.tsc));
        let clock = self.clock.less(earlier.clock);
        let ahead = i128::from(clock.0) - i128::from(passed.0);
        let ahead = ahead.clamp(i128::from(i64::MIN), i128::from(i64::MAX));
        (ahead as i64, passed)
    }

    /// Whether the clock has kept within twice NTP's 500 ppm of the counter since an earlier moment, and
    /// what two readings may be off.
    #[must_use]
    pub fn agrees_with(self, earlier: Moment, frequency: TscFrequency) -> bool {
        const READINGS: u64 = 2_000;
        let (ahead, Nanos(passed)) = self.ahead_since(earlier, frequency);
        ahead.unsigned_abs() <= (passed >> 10) + READINGS
    }
}

/// CLOCK_MONOTONIC.
fn monotonic() -> Nanos {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a live timespec that the call fills in. It cannot fail for this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    Nanos(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One tick is one nanosecond.
    const FREQUENCY: TscFrequency = match TscFrequency::from_khz(1_000_000) {
        Some(frequency) => frequency,
        None => unreachable!(),
    };

    fn at(tsc: u64, clock: u64) -> Moment {
        Moment { tsc: Tsc(tsc), clock: Nanos(clock) }
    }

    #[test]
    fn moments_agree_if_the_clock_keeps_its_rate() {
        let second = 1_000_000_000;
        for (clock, agrees) in [
            (second, true),
            (second + 900_000, true),
            (second - 900_000, true),
            (second + 1_100_000, false),
            (second - 1_100_000, false),
            (0, false),
            (u64::MAX, false),
        ] {
            let agreed = at(second, clock).agrees_with(at(0, 0), FREQUENCY);
            assert_eq!(agreed, agrees, "{clock}");
        }
        // A counter that has gone back has not gone on.
        assert!(!at(0, second).agrees_with(at(second, 0), FREQUENCY));
    }

    #[test]
    fn an_instant_is_farther_on_a_clock_that_is_fast() {
        let frequency = FREQUENCY;
        let of = |ahead, passed| {
            at(1_000, 70).clock_at_rate((ahead, Nanos(passed)), Tsc(1_500), frequency)
        };
        assert_eq!(of(0, 20_000), Nanos(570));
        assert_eq!(of(2_000, 20_000), Nanos(620));
        assert_eq!(of(-2_000, 20_000), Nanos(520));
        // No clock goes like that.
        for (ahead, passed) in [(i64::MIN, 1), (i64::MAX, 1), (1, 0), (-20_000, 20_000)] {
            assert_eq!(of(ahead, passed), Nanos(570), "{ahead} {passed}");
        }
        assert_eq!(
            at(1_000, 70).clock_at_rate((2_000, Nanos(20_000)), Tsc(900), frequency),
            Nanos(70)
        );
    }

    #[test]
    fn an_instant_is_as_far_on_the_clock_as_on_the_counter() {
        assert_eq!(at(1_000, 70).clock_at(Tsc(1_500), FREQUENCY), Nanos(570));
        assert_eq!(at(1_000, 70).clock_at(Tsc(900), FREQUENCY), Nanos(70));
    }
}
