//! How the kernel's clock is steered: what NTP has told it, by adjtimex(2).
//!
//! The schedule lies on the time-stamp counter, and the kernel sleeps by a clock that is made from it
//! and steered. Two settings change its rate for good: the frequency (`ADJ_FREQUENCY`, 500 ppm at most,
//! `MAXFREQ` in `include/linux/timex.h`), and the length of a tick (`ADJ_TICK`, 10 % at most), which
//! chrony uses to correct large errors.

/// What a clock that NTP keeps may be off its nominal rate, in ppm (`MAXFREQ`).
pub const NTP_PPM: f64 = 500.0;

/// Nominal length of a tick, in us: that of `USER_HZ`, which is 100 on this processor.
const TICK_US: i64 = 10_000;
/// `STA_UNSYNC`: no daemon keeps the clock.
const UNSYNCHRONISED: i64 = 0x40;

/// The steering of a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Steering {
    /// In units of 2^-16 ppm.
    pub frequency: i64,
    /// In us.
    pub tick: i64,
    /// `STA_` bits.
    pub status: i64,
}

impl Steering {
    /// That of this host's kernel; `None` if it does not tell.
    #[must_use]
    pub fn here() -> Option<Steering> {
        // SAFETY: an all-zero timex is a valid one: it asks for nothing to be changed.
        let mut timex: libc::timex = unsafe { std::mem::zeroed() };
        // SAFETY: the kernel reads and writes the live structure.
        let state = unsafe { libc::adjtimex(&raw mut timex) };
        (state >= 0).then_some(Steering {
            frequency: timex.freq,
            tick: timex.tick,
            status: timex.status.into(),
        })
    }

    /// That which busybox's `adjtimex` has printed.
    #[cfg(test)]
    pub fn recorded(text: &str) -> Option<Steering> {
        let of = |key: &str| {
            let line = text.lines().find_map(|line| line.split_once(key))?;
            line.1.split_whitespace().next()?.parse().ok()
        };
        Some(Steering {
            frequency: of("freq.adjust:")?,
            tick: of("tick:")?,
            status: of("status:")?,
        })
    }

    /// How much faster than nominal the clock runs, in ppm.
    #[must_use]
    pub fn ppm(self) -> f64 {
        self.frequency as f64 / 65_536.0 + self.tick_ppm()
    }

    /// The part of that which the length of the tick has.
    #[must_use]
    pub fn tick_ppm(self) -> f64 {
        (self.tick - TICK_US) as f64 * (1e6 / TICK_US as f64)
    }

    /// Whether a program keeps the clock.
    #[must_use]
    pub fn synchronised(self) -> bool {
        self.status & UNSYNCHRONISED == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn this_hosts_steering_is_told_and_within_what_a_kernel_allows() {
        let steering = Steering::here().unwrap();
        assert!(steering.ppm().abs() <= 100_500.0, "{steering:?}");
    }

    #[test]
    fn frequency_and_tick_add_up() {
        let of = |frequency, tick| Steering { frequency, tick, status: 0 }.ppm();
        assert_eq!(of(0, 10_000), 0.0);
        assert_eq!(of(500 << 16, 10_000), 500.0);
        assert_eq!(of(-(500 << 16), 9_000), -100_500.0);
        assert_eq!(of(0, 10_833), 83_300.0);
    }

    #[test]
    fn what_busybox_prints_is_understood() {
        let text = "    mode:         0\n-f  freq.adjust:  -655360 (65536 = 1ppm)\n    status:       8257 (PLL | UNSYNC)\n-t  tick:         10005\n";
        let steering = Steering::recorded(text).unwrap();
        assert_eq!(steering, Steering { frequency: -655_360, tick: 10_005, status: 8257 });
        assert!((steering.ppm() - 490.0).abs() < 1e-6 && !steering.synchronised());
        assert_eq!(Steering::recorded(""), None);
    }
}
