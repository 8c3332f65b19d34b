//! Instants and spans of the partition's own time.
//!
//! The kernel reckons in nanoseconds since the instant at which the partition's tasks began, because
//! the periods of tasks are whole nanoseconds: release *k* of a task is then `offset + k * period`
//! without rounding, for ever. Ticks of the time stamp counter appear only in [`Clock`].

/// Nanoseconds since the tasks began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant(pub u64);

/// Nanoseconds between two instants.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span(pub u64);

impl Instant {
    /// An instant that never comes.
    pub const NEVER: Self = Self(u64::MAX);

    /// The instant that is `span` later.
    #[must_use]
    pub const fn after(self, span: Span) -> Self {
        Self(self.0.saturating_add(span.0))
    }

    /// How long it has been since `earlier`; nothing if that is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Span {
        Span(self.0.saturating_sub(earlier.0))
    }
}

impl Span {
    /// No time.
    pub const ZERO: Self = Self(0);

    /// Both together.
    #[must_use]
    pub const fn plus(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }

    /// `count` of them.
    #[must_use]
    pub const fn times(self, count: u64) -> Self {
        Self(self.0.saturating_mul(count))
    }
}

/// Converts between the time stamp counter and [`Instant`].
///
/// Both directions multiply and shift, so that neither costs a division, and each is exact to 2 ns for a
/// hundred days.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clock {
    /// Time stamp of instant 0.
    base: u64,
    /// Nanoseconds in 2^56 ticks.
    nanoseconds: u64,
    /// Ticks in 2^56 ns.
    ticks: u64,
}

impl Clock {
    const TO_NANOSECONDS: u32 = 56;
    const TO_TICKS: u32 = 56;

    /// A clock that shows 0 at the time stamp `base`. A frequency of 0 is taken for 1 kHz.
    #[must_use]
    pub const fn new(base: u64, tsc_khz: u64) -> Self {
        let khz = if tsc_khz == 0 { 1 } else { tsc_khz as u128 };
        let nanoseconds = (1_000_000u128 << Self::TO_NANOSECONDS) / khz;
        let ticks = (khz << Self::TO_TICKS) / 1_000_000;
        let limit = u64::MAX as u128;
        Self {
            base,
            nanoseconds: if nanoseconds > limit { u64::MAX } else { nanoseconds as u64 },
            ticks: if ticks > limit { u64::MAX } else { ticks as u64 },
        }
    }

    /// The instant of a time stamp; 0 for one before the base.
    #[must_use]
    pub const fn instant(&self, tsc: u64) -> Instant {
        Instant(self.span(tsc.saturating_sub(self.base)).0)
    }

    /// How long so many ticks last.
    #[must_use]
    pub const fn span(&self, ticks: u64) -> Span {
        Span(((ticks as u128 * self.nanoseconds as u128) >> Self::TO_NANOSECONDS) as u64)
    }

    /// The time stamp of an instant.
    #[must_use]
    pub const fn tsc(&self, instant: Instant) -> u64 {
        let ticks = (instant.0 as u128 * self.ticks as u128) >> Self::TO_TICKS;
        self.base.saturating_add(if ticks > u64::MAX as u128 { u64::MAX } else { ticks as u64 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_is_exact_to_two_nanoseconds_for_a_hundred_days() {
        for khz in [999_999, 1_000_000, 2_994_374, 5_700_000] {
            let clock = Clock::new(1_000, khz);
            for seconds in [0u64, 1, 3_600, 8_640_000] {
                let ticks = seconds * khz * 1_000;
                let instant = clock.instant(1_000 + ticks);
                assert!(instant.0.abs_diff(seconds * 1_000_000_000) <= 2, "{khz} {seconds}");
                let back = clock.tsc(Instant(seconds * 1_000_000_000));
                assert!(back.abs_diff(1_000 + ticks) <= 2 * khz / 1_000_000 + 2, "{khz} {seconds}");
            }
        }
    }

    #[test]
    fn what_lies_before_the_base_is_its_start() {
        assert_eq!(Clock::new(1_000, 1_000_000).instant(999), Instant(0));
    }

    #[test]
    fn frequencies_that_cannot_be_do_no_harm() {
        let none = Clock::new(0, 0);
        assert!(none.instant(1).0 > 0);
        assert_eq!(Clock::new(0, u64::MAX).tsc(Instant::NEVER), u64::MAX);
    }
}
