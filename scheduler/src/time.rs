//! Units of time, as types.
//!
//! Three quantities look alike in a debugger and must never be added by accident: a duration in
//! nanoseconds (what people write and the kernel takes), an instant on the processor's time-stamp
//! counter (what host and guests share), and a number of its ticks. Operators that would mix them
//! do not exist.
//!
//! The TSC is the master clock. A release is computed as `epoch + offset`, with the offset
//! converted from nanoseconds in one 128-bit multiplication, so errors do not add up: the
//! millionth release is as exact as the first.

use std::fmt;

/// A duration in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Nanos(pub u64);

impl Nanos {
    /// Nothing.
    pub const ZERO: Nanos = Nanos(0);

    /// `n` microseconds.
    #[must_use]
    pub const fn from_micros(n: u64) -> Nanos {
        Nanos(n * 1_000)
    }

    /// `n` milliseconds.
    #[must_use]
    pub const fn from_millis(n: u64) -> Nanos {
        Nanos(n * 1_000_000)
    }

    /// The sum; saturates, since no duration of the product comes near the type's 584 years.
    #[must_use]
    pub const fn plus(self, other: Nanos) -> Nanos {
        Nanos(self.0.saturating_add(other.0))
    }

    /// `self - other`, or zero if `other` is longer.
    #[must_use]
    pub const fn less(self, other: Nanos) -> Nanos {
        Nanos(self.0.saturating_sub(other.0))
    }
}

/// Prints the longest unit that needs no fraction: `250us`, `1ms`, `1500ns`.
impl fmt::Display for Nanos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let n = self.0;
        let (value, unit) = match n {
            0 => (0, "us"),
            _ if n.is_multiple_of(1_000_000_000) => (n / 1_000_000_000, "s"),
            _ if n.is_multiple_of(1_000_000) => (n / 1_000_000, "ms"),
            _ if n.is_multiple_of(1_000) => (n / 1_000, "us"),
            _ => (n, "ns"),
        };
        f.pad(&format!("{value}{unit}"))
    }
}

/// An instant: a value of the time-stamp counter that host and guests share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Tsc(pub u64);

/// A number of ticks of the time-stamp counter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Ticks(pub u64);

impl Tsc {
    /// Reads the counter. Not a serialising read: a few instructions around it may be reordered.
    #[must_use]
    #[inline]
    pub fn now() -> Tsc {
        // SAFETY: RDTSC exists on every x86-64 processor and has no effect but its result; Takt
        // does not run where CR4.TSD forbids it, as no Linux does by default.
        Tsc(unsafe { core::arch::x86_64::_rdtsc() })
    }

    /// Ticks from `earlier` to `self`; zero if `earlier` is in truth the later one.
    #[must_use]
    pub const fn since(self, earlier: Tsc) -> Ticks {
        Ticks(self.0.saturating_sub(earlier.0))
    }

    /// The instant `ticks` before this one.
    #[must_use]
    pub const fn before(self, ticks: Ticks) -> Tsc {
        Tsc(self.0.saturating_sub(ticks.0))
    }

    /// The instant `ticks` after this one.
    #[must_use]
    pub const fn after(self, ticks: Ticks) -> Tsc {
        Tsc(self.0.saturating_add(ticks.0))
    }
}

/// Frequency of the time-stamp counter; never zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TscFrequency {
    khz: u32,
}

impl TscFrequency {
    /// `None` for 0, which KVM reports where the counter is unusable.
    #[must_use]
    pub const fn from_khz(khz: u32) -> Option<TscFrequency> {
        if khz == 0 { None } else { Some(TscFrequency { khz }) }
    }

    /// In kHz, the resolution in which KVM states it.
    #[must_use]
    pub const fn khz(self) -> u32 {
        self.khz
    }

    /// Ticks in `duration`, rounded down.
    #[must_use]
    pub const fn ticks(self, duration: Nanos) -> Ticks {
        Ticks((duration.0 as u128 * self.khz as u128 / 1_000_000) as u64)
    }

    /// Nanoseconds in `ticks`, rounded down.
    #[must_use]
    pub const fn nanos(self, ticks: Ticks) -> Nanos {
        Nanos((ticks.0 as u128 * 1_000_000 / self.khz as u128) as u64)
    }
}

/// The line on which a schedule lies: its epoch, and the speed of the clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timebase {
    /// Start of major frame 0.
    pub epoch: Tsc,
    /// Speed of the counter.
    pub frequency: TscFrequency,
}

impl Timebase {
    /// The instant that lies `offset` after the epoch, exact to one tick for any offset.
    #[must_use]
    pub const fn instant(&self, offset: Nanos) -> Tsc {
        self.epoch.after(self.frequency.ticks(offset))
    }

    /// How far `instant` lies after the epoch; zero for one before it.
    #[must_use]
    pub const fn offset(&self, instant: Tsc) -> Nanos {
        self.frequency.nanos(instant.since(self.epoch))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_print_in_the_unit_a_person_would_use() {
        let print = |n| Nanos(n).to_string();
        assert_eq!(print(0), "0us");
        assert_eq!(print(1), "1ns");
        assert_eq!(print(1_500), "1500ns");
        assert_eq!(print(250_000), "250us");
        assert_eq!(print(1_000_000), "1ms");
        assert_eq!(print(2_000_000_000), "2s");
    }

    #[test]
    fn a_simulated_day_of_releases_does_not_drift() {
        // A frequency that divides nothing evenly, so that any accumulation would show.
        let frequency = TscFrequency::from_khz(2_399_987).unwrap();
        let base = Timebase { epoch: Tsc(1 << 40), frequency };
        for n in [1u64, 1_000, 1_000_000, 86_400_000] {
            let exact = u128::from(n) * 1_000_000 * 2_399_987 / 1_000_000;
            let instant = base.instant(Nanos::from_millis(n));
            assert_eq!(u128::from(instant.0 - (1 << 40)), exact);
            let back = base.offset(instant);
            assert!(Nanos::from_millis(n).0 - back.0 <= 1, "{n}: {back}");
        }
    }

    #[test]
    fn a_counter_without_frequency_is_refused() {
        assert!(TscFrequency::from_khz(0).is_none());
    }

    #[test]
    fn differences_do_not_wrap() {
        assert_eq!(Tsc(5).since(Tsc(7)), Ticks(0));
        assert_eq!(Nanos(5).less(Nanos(7)), Nanos::ZERO);
        let base = Timebase { epoch: Tsc(10), frequency: TscFrequency::from_khz(1).unwrap() };
        assert_eq!(base.offset(Tsc(3)), Nanos::ZERO);
    }
}
