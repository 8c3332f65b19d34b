//! Does the time-stamp counter keep its rate?
//!
//! It is compared with CLOCK_MONOTONIC, by which the kernel sleeps. Where the kernel's own clock
//! source is the counter, this shows the steering of that clock (NTP) and no more: the two have
//! then no way to differ in rate otherwise, and `tsc` has the kernel's word for it.

use takt_scheduler::time::{Tsc, TscFrequency};

use crate::demand::Demand;
use crate::finding::Finding;
use crate::host::Host;
use crate::steering::{NTP_PPM, Steering};

/// Readings of which the best is taken: the one with the least time around it.
const TRIES: usize = 16;
/// What the measurement itself may be off, in ppm: both clocks are read within a microsecond.
const READINGS_PPM: f64 = 50.0;

/// Time without which two moments tell no rate, in ns: a microsecond is then 100 ppm.
const LEAST: u64 = 10_000_000;

/// Both clocks at one moment.
#[derive(Clone, Copy, Debug)]
struct Moment {
    tsc: u64,
    ns: u64,
}

impl Moment {
    fn now() -> Self {
        let mut best = (u64::MAX, Moment { tsc: 0, ns: 0 });
        for _ in 0..TRIES {
            let before = Tsc::now().0;
            let ns = monotonic();
            let around = Tsc::now().0.saturating_sub(before);
            if around < best.0 {
                best = (around, Moment { tsc: before + around / 2, ns });
            }
        }
        best.1
    }

    fn is_far_from(self, earlier: Moment) -> bool {
        self.ns.saturating_sub(earlier.ns) >= LEAST
    }

    /// Ticks in a second, since another moment.
    fn rate_since(self, earlier: Moment) -> f64 {
        let ns = self.ns.saturating_sub(earlier.ns).max(1);
        self.tsc.saturating_sub(earlier.tsc) as f64 * 1e9 / ns as f64
    }
}

fn monotonic() -> u64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills in a live timespec; cannot fail for this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
}

/// The counter's frequency, from 20 ms.
#[must_use]
pub fn estimate() -> TscFrequency {
    let first = Moment::now();
    std::thread::sleep(std::time::Duration::from_millis(20));
    let khz = Moment::now().rate_since(first) / 1e3;
    TscFrequency::from_khz(khz.round() as u32).unwrap_or(ONE_GIGAHERTZ)
}

/// For a counter that stands still, which is found and told.
const ONE_GIGAHERTZ: TscFrequency = match TscFrequency::from_khz(1_000_000) {
    Some(frequency) => frequency,
    None => unreachable!(),
};

/// The moments of a measurement.
#[derive(Debug)]
pub struct Rate {
    moments: Vec<Moment>,
}

impl Rate {
    /// Looks for the first time.
    #[must_use]
    pub fn start() -> Self {
        Self { moments: vec![Moment::now()] }
    }

    /// Looks once more.
    pub fn look(&mut self) {
        self.moments.push(Moment::now());
    }

    /// The first and the last moment, if they are far enough from each other.
    fn ends(&self) -> Option<(Moment, Moment)> {
        let (first, last) = (*self.moments.first()?, *self.moments.last()?);
        last.is_far_from(first).then_some((first, last))
    }

    /// Says what it means that the counter has changed its rate, or has not.
    #[must_use]
    pub fn finding(&self, host: &Host, demand: &Demand) -> Finding {
        const CHECK: &str = "tsc-rate";
        let source = host.text("sys/devices/system/clocksource/clocksource0/current_clocksource");
        let same = source.is_some_and(|source| source.starts_with("tsc"));
        let Some((first, last)) = self.ends() else { return short(CHECK, demand) };
        let rate = last.rate_since(first);
        // Thirds of the time: long enough that a reading's own error does not matter.
        let third = (self.moments.len() / 3).max(1);
        let parts = self.moments.windows(third + 1).filter_map(|part| {
            let (first, last) = (part.first()?, part.last()?);
            // The last step can be a short one.
            last.is_far_from(*first).then(|| (last.rate_since(*first) / rate - 1.0).abs() * 1e6)
        });
        // One that stands still has no rate to compare with.
        let worst = if rate > 0.0 { parts.fold(0.0, f64::max) } else { f64::INFINITY };
        let beside = if same { ", from which the kernel's clock is made" } else { "" };
        let found = format!(
            "{:.3} MHz, steady within {worst:.1} ppm of the kernel's clock{beside}",
            rate / 1e6
        );
        if worst <= NTP_PPM {
            return Finding::good(CHECK, found);
        }
        Finding::cannot(
            CHECK,
            found,
            "the major frame is as long as the counter says, and wake-ups miss their guards",
            "look for the reason: dmesg | grep -i -e tsc -e clocksource; in a virtual machine: run takt on the machine itself",
        )
    }

    /// Says how far the kernel's clock, by which it sleeps, runs from the counter, on which releases lie,
    /// and which part of that is NTP's. `khz` is the counter's rate as KVM has it, by which Takt counts.
    #[must_use]
    pub fn clock(&self, host: &Host, demand: &Demand, khz: Option<u32>) -> Finding {
        const CHECK: &str = "clock-rate";
        let Some(khz) = khz else {
            return Finding::unseen(
                CHECK,
                "KVM does not tell the counter's rate",
                "it is not known how far the kernel's clock runs from it",
                "see kvm",
            );
        };
        let Some((first, last)) = self.ends() else { return short(CHECK, demand) };
        let rate = last.rate_since(first);
        let ahead =
            if rate > 0.0 { (f64::from(khz) * 1e3 / rate - 1.0) * 1e6 } else { f64::INFINITY };
        let ntp = host.steering().map_or(0.0, Steering::ppm);
        let found = format!(
            "the kernel's clock runs {ahead:+.1} ppm from the counter at KVM's {:.3} MHz; NTP's part is {ntp:+.1} ppm",
            f64::from(khz) / 1e3
        );
        let own = (ahead - ntp).abs();
        if own > NTP_PPM + READINGS_PPM {
            // Steering that has ended or begun meanwhile is no more than NTP's and found below.
            return Finding::cannot(
                CHECK,
                found,
                "the kernel and KVM have measured the counter differently: the major frame has another length than its file says",
                "start the machine again; look for the reason: dmesg | grep -i tsc",
            );
        }
        if ahead.abs() > NTP_PPM + READINGS_PPM {
            return Finding::warning(
                CHECK,
                found,
                "takt divides each sleep, at the cost of some microseconds of Linux's time",
                "see clock-steering",
            );
        }
        Finding::good(CHECK, found)
    }
}

/// A measurement from which no rate can be told.
fn short(check: &'static str, demand: &Demand) -> Finding {
    Finding::unseen(
        check,
        "not measured for long enough",
        "it is not known whether the counter keeps its rate to the kernel's clock",
        format!("{} --for 3s", demand.command()),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::finding::Severity;

    fn rate(moments: &[(u64, u64)]) -> Finding {
        let moments = moments.iter().map(|&(tsc, ns)| Moment { tsc, ns }).collect();
        let host = host(None);
        Rate { moments }.finding(&host, &Demand::usual(&host))
    }

    fn clock(rate: &Rate, host: &Host, khz: Option<u32>) -> Finding {
        rate.clock(host, &Demand::usual(host), khz)
    }

    fn host(steering: Option<Steering>) -> Host {
        Host::recorded(std::path::Path::new("/none"), String::new()).steered(steering)
    }

    #[test]
    fn the_clocks_distance_from_the_counter_is_told_with_ntps_part() {
        // The clock's ppm by NTP and by itself.
        let of = |ntp: i64, own: f64| {
            let fast = 1.0 + ntp as f64 / 1e6 + own / 1e6;
            let second =
                |i: u64| Moment { tsc: i * 1_000_000_000, ns: (i as f64 * 1e9 * fast) as u64 };
            let rate = Rate { moments: (0..4).map(second).collect() };
            let tick = 10_000 + ntp / 100;
            let steering = Steering { frequency: ntp % 100 * 65_536, tick, status: 0 };
            clock(&rate, &host(Some(steering)), Some(1_000_000))
        };
        let good = of(12, 0.0);
        assert_eq!(good.severity, Severity::Good);
        assert!(good.found.contains("runs +12.0 ppm") && good.found.ends_with("part is +12.0 ppm"));
        assert_eq!(of(-500, 30.0).severity, Severity::Good);
        for ntp in [833, -100_000, 100_000] {
            assert_eq!(of(ntp, 0.0).severity, Severity::Warning, "{ntp}");
        }
        assert_eq!(of(0, 600.0).severity, Severity::Cannot);
        assert_eq!(of(100_000, -100_000.0).severity, Severity::Cannot);
        let moments = vec![Moment { tsc: 5, ns: 0 }, Moment { tsc: 5, ns: 1_000_000_000 }];
        let still = clock(&Rate { moments }, &host(None), Some(1_000_000));
        assert_eq!(still.severity, Severity::Cannot);
        let unknown = clock(&Rate { moments: Vec::new() }, &host(None), None);
        assert_eq!(unknown.severity, Severity::Unseen);
    }

    #[test]
    fn a_steady_counter_is_good() {
        let moments: Vec<_> = (0..30).map(|i| (i * 250_000_000, i * 100_000_000)).collect();
        let finding = rate(&moments);
        assert_eq!(finding.severity, Severity::Good);
        assert!(
            finding.found.starts_with("2500.000 MHz, steady within 0.0 ppm"),
            "{}",
            finding.found
        );
    }

    #[test]
    fn a_counter_that_stops_for_a_while_is_not() {
        let tick = |i: u64| if i < 15 { i } else { i - 1 };
        let moments: Vec<_> = (0..30).map(|i| (tick(i) * 250_000_000, i * 100_000_000)).collect();
        assert_eq!(rate(&moments).severity, Severity::Cannot);
        assert_eq!(rate(&[(5, 0), (5, 1_000_000_000)]).severity, Severity::Cannot);
    }

    #[test]
    fn what_was_not_measured_for_long_enough_is_not_judged() {
        let far = Moment { tsc: 20_000_000, ns: 10_000_000 };
        let near = Moment { tsc: 9_999_999, ns: 9_999_999 };
        for last in [None, Some(near)] {
            let moments: Vec<_> = [Moment { tsc: 0, ns: 0 }].into_iter().chain(last).collect();
            let (rate, host) = (Rate { moments }, host(None));
            let demand = Demand::usual(&host);
            for finding in [rate.finding(&host, &demand), clock(&rate, &host, Some(1_000_000))] {
                assert_eq!(finding.severity, Severity::Unseen);
                assert_eq!(finding.remedy.unwrap(), "takt doctor --for 3s");
            }
        }
        assert_eq!(rate(&[(0, 0), (far.tsc, far.ns)]).severity, Severity::Good);
        // The last step is 50 us long, and a reading in it was 1 us late.
        let steps = [(0, 0), (100_000_000, 100_000_000), (100_051_000, 100_050_000)];
        assert_eq!(rate(&steps).severity, Severity::Good);
    }
}
