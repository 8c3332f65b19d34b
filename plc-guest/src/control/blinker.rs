//! A lamp that changes state at a fixed interval.
//!
//! An on-delay timer that starts itself again. It carries over what is left of the scan in which
//! it fires: otherwise the blinking would slow down by half a scan time on average.

use core::time::Duration;

/// See the [module](self).
#[derive(Debug)]
pub struct Blinker {
    interval: Duration,
    elapsed: Duration,
    on: bool,
}

impl Blinker {
    /// A lamp that is off and goes on after the first interval.
    #[must_use]
    pub const fn new(interval: Duration) -> Self {
        Self { interval, elapsed: Duration::ZERO, on: false }
    }

    /// Lets time pass; returns whether the lamp is on. A gap longer than an interval counts as one
    /// change, since the lamp did not blink meanwhile.
    pub fn update(&mut self, elapsed: Duration) -> bool {
        self.elapsed += elapsed;
        if self.elapsed >= self.interval {
            self.on = !self.on;
            let rest = self.elapsed - self.interval;
            self.elapsed = if rest < self.interval { rest } else { Duration::ZERO };
        }
        self.on
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HALF: Duration = Duration::from_millis(500);

    #[test]
    fn changes_when_the_interval_has_passed() {
        let mut lamp = Blinker::new(HALF);
        assert!(!lamp.update(Duration::from_millis(499)));
        assert!(lamp.update(Duration::from_millis(1)));
        assert!(lamp.update(Duration::from_millis(499)));
        assert!(!lamp.update(Duration::from_millis(1)));
    }

    #[test]
    fn does_not_drift_with_a_scan_time_that_does_not_divide_the_interval() {
        let mut lamp = Blinker::new(HALF);
        let scan = Duration::from_millis(7);
        let (mut changes, mut last) = (0, false);
        for _ in 0..10_000 {
            let on = lamp.update(scan);
            changes += u32::from(on != last);
            last = on;
        }
        assert_eq!(changes, 70_000 / 500);
    }

    #[test]
    fn a_long_gap_is_one_change() {
        let mut lamp = Blinker::new(HALF);
        assert!(lamp.update(Duration::from_secs(60)));
        assert!(lamp.update(Duration::from_millis(499)));
    }
}
