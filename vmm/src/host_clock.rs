//! Noticing that the host's time-stamp counter has turned bad.
//!
//! Everything lies on the counter: releases, the guests' clocks, the figures. Where the kernel finds
//! during a run that it cannot be trusted (another processor's differs, the clock source's watchdog
//! measures another rate), it takes another clock source, and KVM writes the counter's offset for a guest
//! anew each time that it loads the guest's processor (`kvm_arch_vcpu_load` in `arch/x86/kvm/x86.c`,
//! where the TSC is unstable): a PLC's counter then stands while it does not run, and it loses every
//! release. Nothing tells a process so, and it has to look:
//!
//! * at the kernel's clock source, in sysfs, which was a counter's at the start and is none any more;
//! * at the counter itself, against CLOCK_MONOTONIC: the two may differ by what NTP may steer, 10 %.
//!
//! The supervisor thread looks, some times a second: one `pread` of a file that was opened before the
//! sandbox was entered, and two readings of clocks. What follows is a matter of each partition's table
//! (`clock-fault`).

use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

use takt_scheduler::moment::{Moment, STEERING_PART};
use takt_scheduler::time::{Nanos, TscFrequency};

use crate::health::{ClockFault, Text};

/// The clock source that the kernel uses now.
pub(crate) const SOURCE: &str = "/sys/devices/system/clocksource/clocksource0/current_clocksource";
/// How often it is looked at.
const INTERVAL: Nanos = Nanos::from_millis(250);
/// Clock sources that are the counter itself. The early one makes way for the other once the kernel
/// has measured the counter's frequency.
const COUNTERS: [&[u8]; 2] = [b"tsc", b"tsc-early"];
/// What readings may be off when the two clocks are compared.
const READINGS: Nanos = Nanos::from_micros(500);
/// How long it may take to read both clocks for the readings to be one moment. A clock source that is
/// a device takes some microseconds.
const MOMENT: Nanos = Nanos::from_micros(50);

/// The host's clock, as it was when it was last looked at.
#[derive(Debug)]
pub struct HostClock {
    frequency: TscFrequency,
    /// `None` if the clock source was no counter's at the start, or is not told.
    source: Option<File>,
    looked: Nanos,
    last: Option<Moment>,
    bad: bool,
}

impl HostClock {
    /// Opens what is looked at later, and looks at the clock for the first time.
    #[must_use]
    pub fn open(frequency: TscFrequency) -> HostClock {
        let last = Some(Moment::now(frequency));
        HostClock { last, ..HostClock::of(Path::new(SOURCE), frequency) }
    }

    /// Both clocks when they were last looked at.
    #[must_use]
    pub const fn last(&self) -> Option<Moment> {
        self.last
    }

    fn of(path: &Path, frequency: TscFrequency) -> HostClock {
        let source = File::open(path).ok().filter(|file| matches!(foreign(file), Some(None)));
        HostClock { frequency, source, looked: Nanos::ZERO, last: None, bad: false }
    }

    /// Looks, if it is time; `now` counts from the epoch. Returns what has turned bad, once each time
    /// that it does.
    pub fn look(&mut self, now: Nanos) -> Option<ClockFault> {
        // A counter that has gone back leaves `looked` in the future.
        if now >= self.looked && now.less(self.looked) < INTERVAL {
            return None;
        }
        self.looked = now;
        let moment = Moment::within(MOMENT, self.frequency);
        self.judge(moment)
    }

    fn judge(&mut self, moment: Option<Moment>) -> Option<ClockFault> {
        let source = self.source.as_ref().and_then(foreign).flatten();
        let fault = source.map(ClockFault::Source).or_else(|| self.differs(moment?));
        let news = fault.filter(|_| !self.bad);
        self.bad = fault.is_some();
        news
    }

    /// Whether the two clocks have differed by more than any steering since the last moment.
    fn differs(&mut self, now: Moment) -> Option<ClockFault> {
        let last = self.last.replace(now)?;
        let (ahead, Nanos(passed)) = now.ahead_since(last, self.frequency);
        let allowed = (passed / STEERING_PART).saturating_add(READINGS.0);
        (ahead.unsigned_abs() > allowed).then_some(ClockFault::Rate { clock_ahead_ns: ahead })
    }
}

/// The name of a clock source that is no counter's; the outer `None` if it is not told.
fn foreign(file: &File) -> Option<Option<Text>> {
    let mut name = [0; takt_abi::memory::ERROR_TEXT_BYTES];
    let read = file.read_at(&mut name, 0).ok().filter(|read| *read > 0)?;
    let word = name.get(..read)?.trim_ascii_end();
    let length = word.len();
    let counter = COUNTERS.contains(&word);
    name.get_mut(length..)?.fill(0);
    Some((!counter).then_some(Text::new(name)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use takt_scheduler::time::Tsc;

    const FREQUENCY: TscFrequency = match TscFrequency::from_khz(1_000_000) {
        Some(frequency) => frequency,
        None => unreachable!(),
    };

    struct Source(std::path::PathBuf);

    impl Source {
        fn new(test: &str, name: &str) -> Self {
            let path = std::env::temp_dir().join(format!("takt-{test}-{}", std::process::id()));
            fs::write(&path, name).unwrap();
            Self(path)
        }
    }

    impl Drop for Source {
        fn drop(&mut self) {
            let _ = fs::remove_file(&self.0);
        }
    }

    fn moment(tsc: u64, clock: u64) -> Option<Moment> {
        Some(Moment { tsc: Tsc(tsc), clock: Nanos(clock) })
    }

    #[test]
    fn a_clock_source_that_goes_is_told_once_each_time() {
        let source = Source::new("clock-goes", "tsc-early\n");
        let mut clock = HostClock::of(&source.0, FREQUENCY);
        let mut after = |name: &str| {
            fs::write(&source.0, name).unwrap();
            clock.judge(None).map(|fault| fault.to_string())
        };
        let hpet = "the kernel's clock source is \"hpet\" and no longer the TSC";
        assert_eq!(after("tsc\n"), None);
        assert_eq!(after("hpet\n").as_deref(), Some(hpet));
        assert_eq!(after("hpet\n"), None);
        assert_eq!(after("tsc\n"), None);
        let escaped = "the kernel's clock source is \"\\x1b[2J\" and no longer the TSC";
        assert_eq!(after("\x1b[2J").as_deref(), Some(escaped));
        // A longer name than any that there is.
        assert_eq!(after("tsc\n"), None);
        assert!(after(&"x".repeat(5_000)).is_some());
    }

    #[test]
    fn a_host_that_never_had_the_counter_as_its_source_has_not_lost_it() {
        let source = Source::new("clock-never", "kvm-clock\n");
        let mut clock = HostClock::of(&source.0, FREQUENCY);
        assert_eq!(clock.judge(None), None);
        let mut clock = HostClock::of(Path::new("/nowhere"), FREQUENCY);
        assert_eq!(clock.judge(None), None);
    }

    #[test]
    fn a_rate_that_no_steering_explains_is_told_and_every_steering_is_not() {
        let second = 1_000_000_000;
        for (tsc, clock, bad) in [
            (second, second, false),
            (second, second + 100_500_000, false),
            (second, second - 100_500_000, false),
            (second, second + 200_000_000, true),
            (second, second - 200_000_000, true),
            // It stands still, has gone back, or has leapt.
            (0, second, true),
            (u64::MAX, second, true),
        ] {
            let mut judged = HostClock::of(Path::new("/nowhere"), FREQUENCY);
            assert_eq!(judged.judge(moment(10, 10)), None);
            let fault = judged.judge(moment(tsc.saturating_add(10), clock + 10));
            assert_eq!(fault.is_some(), bad, "{tsc} {clock}: {fault:?}");
        }
        let mut gone_back = HostClock::of(Path::new("/nowhere"), FREQUENCY);
        assert_eq!(gone_back.judge(moment(second, 0)), None);
        assert!(gone_back.judge(moment(0, second)).is_some());
    }

    #[test]
    fn this_hosts_clock_is_looked_at_four_times_a_second() {
        let mut clock = HostClock::open(FREQUENCY);
        let opened = clock.last();
        assert!(opened.is_some());
        assert_eq!(clock.look(Nanos::ZERO), None);
        assert_eq!(clock.last(), opened);
        let _ = clock.look(INTERVAL);
        assert_eq!(clock.looked, INTERVAL);
        let _ = clock.look(INTERVAL.plus(Nanos(1)));
        assert_eq!(clock.looked, INTERVAL);
        // A counter that has gone back.
        let _ = clock.look(Nanos(5));
        assert_eq!(clock.looked, Nanos(5));
    }
}
