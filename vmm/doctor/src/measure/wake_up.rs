//! Being a PLC for a while: how late are wake-ups, and how long is the CPU away in a window?
//!
//! A thread does on each CPU with windows what a PLC's thread does there: it sleeps until the guard
//! before a release, and then looks at the counter without a break until its window ends. When it
//! wakes is the wake-up latency; where two readings lie far apart, something has taken the CPU: an
//! interrupt, the firmware, a hypervisor. The kernel's `hwlat` tracer looks for the same with
//! interrupts off, but it needs root and changes the tracer of the host.
//!
//! The thread is of the class that a run's would be, if the kernel admits it, else of SCHED_FIFO,
//! which wakes up as early, else an ordinary one, and then it says so: the time of other programs
//! counts in. It never takes more of the CPU than the partition file does.

use std::io;
use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use takt_scheduler::enforce::{become_deadline, pin_to};
use takt_scheduler::reservation::{KICK_MARGIN, Reservation};
use takt_scheduler::sleep::{Sleeper, WakeUps};
use takt_scheduler::table::GUARD_MAX;
use takt_scheduler::time::{Nanos, Tsc, TscFrequency};

use crate::demand::WindowedCpu;
use crate::finding::Finding;

/// A break between two readings from which on it counts, in ns: above what a reading takes.
const GAP: u64 = 1_000;
/// Windows before those that count: the first ones meet cold caches and pages.
const WARM_UP: u64 = 10;
/// Windows behind them without which nothing is good: a few that were on time may be chance.
const LEAST: u64 = 20;
/// Histograms hold times up to this, in ns.
const LONGEST: u64 = 10_000_000_000;

/// What kind of thread has measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// As in a run.
    Deadline,
    /// Where a deadline thread needs a scheduling domain of its own first.
    Fifo,
    /// Without privileges.
    Ordinary,
}

/// What was measured on one CPU.
#[derive(Debug)]
pub struct Measured {
    /// By which kind of thread.
    pub class: Class,
    /// Time from when the thread should have woken until it did, in ns, for each window.
    pub wake_ups: Histogram<u64>,
    /// Windows that had passed when the thread woke.
    pub lost: u64,
    /// Breaks in windows, in ns.
    pub gaps: Histogram<u64>,
}

impl Measured {
    /// True if there were too few windows to call anything good.
    fn is_short(&self) -> bool {
        self.wake_ups.len() < LEAST
    }
}

/// What a measurement of this CPU takes at least.
pub fn least_time(cpu: &WindowedCpu) -> Duration {
    // The first window begins a period after the start.
    Duration::from_nanos(cpu.period.0.saturating_mul(WARM_UP + LEAST + 1))
}

/// Measures until `end`, on a thread of its own, which is this one.
///
/// # Errors
/// If the thread cannot be pinned, or there is no memory for the histograms.
pub fn measure(cpu: &WindowedCpu, frequency: TscFrequency, end: Instant) -> io::Result<Measured> {
    let histogram = || Histogram::new_with_bounds(1, LONGEST, 3).map_err(io::Error::other);
    pin_to(cpu.cpu)?;
    let (wake_ups, gaps) = (histogram()?, histogram()?);
    let class = take_class(cpu);
    let mut measured = Measured { class, wake_ups, lost: 0, gaps };
    let period = frequency.ticks(cpu.period);
    let length = frequency.ticks(cpu.guard_or_usual().plus(cpu.window));
    let (mut sleeper, passed_over) = (Sleeper::new(frequency), WakeUps::default());
    let mut due = Tsc::now().after(period);
    let mut windows = 0u64;
    while Instant::now() < end {
        sleeper.until(due, &passed_over);
        let woken = Tsc::now();
        let counts = windows >= WARM_UP;
        if counts {
            let late = frequency.nanos(woken.since(due)).0;
            measured.wake_ups.saturating_record(late.max(1));
        }
        let last = watch(woken, due.after(length), |gap| {
            let ns = frequency.nanos(gap).0;
            if counts && ns >= GAP {
                measured.gaps.saturating_record(ns);
            }
        });
        windows += 1;
        due = due.after(period);
        // A window that is over before the thread has come to it is lost, as a PLC's would be.
        while due.after(length) <= last {
            due = due.after(period);
            measured.lost += u64::from(counts);
        }
    }
    Ok(measured)
}

/// Reads the counter until `end`, tells each break, and returns the last reading.
fn watch(start: Tsc, end: Tsc, mut tell: impl FnMut(takt_scheduler::time::Ticks)) -> Tsc {
    let mut last = start;
    while last < end {
        let now = Tsc::now();
        tell(now.since(last));
        last = now;
    }
    last
}

/// Becomes what a run's thread would be, or as near to it as the kernel allows.
fn take_class(cpu: &WindowedCpu) -> Class {
    let runtime = cpu.guard_or_usual().plus(cpu.window).plus(KICK_MARGIN).min(cpu.period);
    if become_deadline(Reservation { runtime, period: cpu.period }).is_ok() {
        return Class::Deadline;
    }
    // SAFETY: the pointer is to a live structure, which the kernel reads; 0 is this thread.
    let result = unsafe {
        let highest =
            libc::sched_param { sched_priority: libc::sched_get_priority_max(libc::SCHED_FIFO) };
        libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const highest)
    };
    if result == 0 { Class::Fifo } else { Class::Ordinary }
}

/// Says what it means: the wake-ups, and the gaps.
pub fn findings(
    cpu: &WindowedCpu,
    measured: Option<io::Result<Measured>>,
    interrupts: &str,
) -> Vec<Finding> {
    match measured {
        Some(Ok(measured)) => vec![wake_ups(cpu, &measured), gaps(cpu, &measured, interrupts)],
        Some(Err(error)) => vec![unmeasured(cpu, &error.to_string())],
        None => vec![unmeasured(cpu, "there was no thread for it, or it died")],
    }
}

/// What mends a measurement that was too short.
fn longer(cpu: &WindowedCpu) -> String {
    format!("takt doctor --for {}ms or longer", least_time(cpu).as_millis() + 1)
}

fn unmeasured(cpu: &WindowedCpu, why: &str) -> Finding {
    Finding::unseen(
        "wake-up",
        format!("CPU {}: not measured: {why}", cpu.cpu.0),
        "how late a PLC would be woken is not known",
        "ask again with that CPU online and in this process's cpuset",
    )
}

/// One late wake-up in a thousand makes a release late every second; a single one may be chance.
fn wake_ups(cpu: &WindowedCpu, measured: &Measured) -> Finding {
    const CHECK: &str = "wake-up";
    let (times, guard) = (&measured.wake_ups, cpu.guard_or_usual());
    let found = format!(
        "CPU {}, {} windows: {} at p50, {} at p99.9, {} at most; the guard is {guard}{}",
        cpu.cpu.0,
        times.len(),
        us(times.value_at_quantile(0.5)),
        us(times.value_at_quantile(0.999)),
        us(times.max()),
        beside(measured.class)
    );
    let found = match measured.lost {
        0 => found,
        n => format!("{found}; {n} windows more were slept through"),
    };
    let cost = "a release whose wake-up comes later than the guard is late; one that is slept through is lost";
    let remedy = match guard_for(cpu, times.max()) {
        Some(guard) => {
            format!("mend what stands above, or in the partition file: release_guard = \"{guard}\"")
        }
        None => "mend what stands above: no guard is long enough for this".into(),
    };
    if measured.class == Class::Ordinary {
        Finding::unseen(CHECK, found, cost, "sudo takt doctor")
    } else if measured.lost > 0 || times.value_at_quantile(0.999) > guard.0 {
        Finding::cannot(CHECK, found, cost, remedy)
    } else if times.max() > guard.0 {
        Finding::warning(CHECK, found, cost, remedy)
    } else if measured.is_short() {
        let cost = "how late a PLC would be woken is not known";
        Finding::unseen(CHECK, format!("{found}; too few windows"), cost, longer(cpu))
    } else {
        Finding::good(CHECK, found)
    }
}

/// What was seen and half as much, in whole steps of 10 us; `None` if the window leaves no time for
/// that.
fn guard_for(cpu: &WindowedCpu, latest: u64) -> Option<Nanos> {
    let guard = Nanos::from_micros(latest.saturating_mul(3).div_ceil(20_000).saturating_mul(10));
    let all = guard.plus(cpu.window).plus(KICK_MARGIN);
    (guard <= GUARD_MAX && all < cpu.period).then_some(guard)
}

/// A break no longer than the guard can make a release late by as much; one that is as long as a
/// window takes the window.
fn gaps(cpu: &WindowedCpu, measured: &Measured, interrupts: &str) -> Finding {
    const CHECK: &str = "latency";
    let (gaps, guard) = (&measured.gaps, cpu.guard_or_usual());
    let meanwhile = if interrupts.is_empty() {
        String::new()
    } else {
        format!("; interrupts there meanwhile: {interrupts}")
    };
    let found = match gaps.len() {
        0 => format!("CPU {}: never away for {} in a window{meanwhile}", cpu.cpu.0, us(GAP)),
        n => format!(
            "CPU {}: {n} times away for {} or more in a window, {} at most{meanwhile}",
            cpu.cpu.0,
            us(GAP),
            us(gaps.max())
        ),
    };
    let cost = "the scan that it falls into is longer by as much, and the release that it falls onto later";
    let remedy = "what is counted here and not above (interrupts, watchdogs) is the firmware's or a hypervisor's: its settings, or another machine";
    if measured.class == Class::Ordinary {
        return Finding::unseen(CHECK, found, cost, "sudo takt doctor");
    }
    match gaps.max() {
        max if max >= cpu.window.0 => Finding::cannot(CHECK, found, cost, remedy),
        max if max > guard.0 => Finding::warning(CHECK, found, cost, remedy),
        _ if measured.is_short() => {
            let found = format!("{found}; {} windows are too few", measured.wake_ups.len());
            Finding::unseen(CHECK, found, "what is away in a window is not known", longer(cpu))
        }
        _ => Finding::good(CHECK, found),
    }
}

fn beside(class: Class) -> &'static str {
    match class {
        Class::Deadline => "",
        Class::Fifo => " (measured with SCHED_FIFO)",
        Class::Ordinary => " (an ordinary thread: other programs' time counts in)",
    }
}

/// A time in us, with the digits that matter.
fn us(ns: u64) -> String {
    let ns = Nanos(ns).0;
    format!("{}.{} us", ns / 1000, ns % 1000 / 100)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demand::Demand;
    use crate::finding::Severity::{self, Cannot, Good, Unseen, Warning};
    use crate::host::Host;

    /// A guard of 20 us, a window of 300 us.
    fn usual() -> WindowedCpu {
        Demand::usual(&Host::recorded("/none".as_ref(), String::new())).windowed.remove(0)
    }

    fn measured(class: Class, wake_ups: &[(u64, u64)], lost: u64, away: &[u64]) -> Measured {
        let histogram = || Histogram::new_with_bounds(1, LONGEST, 3).unwrap();
        let mut it = Measured { class, wake_ups: histogram(), lost, gaps: histogram() };
        wake_ups.iter().for_each(|&(ns, times)| it.wake_ups.record_n(ns, times).unwrap());
        away.iter().for_each(|&ns| it.gaps.record(ns).unwrap());
        it
    }

    fn severities(measured: Measured) -> [Severity; 2] {
        let findings = findings(&usual(), Some(Ok(measured)), "");
        [findings[0].severity, findings[1].severity]
    }

    #[test]
    fn wake_ups_are_held_against_the_guard() {
        let class = Class::Deadline;
        assert_eq!(severities(measured(class, &[(5_000, 3000)], 0, &[])), [Good, Good]);
        let rarely = measured(class, &[(5_000, 2999), (25_000, 1)], 0, &[]);
        let found = findings(&usual(), Some(Ok(rarely)), "");
        assert_eq!(found[0].severity, Warning);
        assert!(found[0].remedy.as_ref().unwrap().ends_with("release_guard = \"40us\""));
        let too_late = measured(class, &[(5_000, 9), (700_000, 1)], 0, &[]);
        let found = findings(&usual(), Some(Ok(too_late)), "");
        assert!(found[0].remedy.as_ref().unwrap().ends_with("no guard is long enough for this"));
        let often = measured(class, &[(5_000, 2990), (25_000, 10)], 0, &[]);
        assert_eq!(severities(often), [Cannot, Good]);
        assert_eq!(severities(measured(class, &[(5_000, 3000)], 1, &[])), [Cannot, Good]);
    }

    #[test]
    fn gaps_are_held_against_guard_and_window() {
        let of = |away: &[u64]| severities(measured(Class::Fifo, &[(5_000, 3000)], 0, away))[1];
        assert_eq!(
            [of(&[4_000; 50]), of(&[4_000, 40_000]), of(&[310_000])],
            [Good, Warning, Cannot]
        );
    }

    #[test]
    fn nothing_is_good_after_too_few_windows() {
        let of = |times, lost, away: &[u64]| {
            severities(measured(Class::Deadline, &[(5_000, times)], lost, away))
        };
        assert_eq!(of(LEAST, 0, &[]), [Good, Good]);
        assert_eq!(of(LEAST - 1, 0, &[]), [Unseen, Unseen]);
        assert_eq!(severities(measured(Class::Deadline, &[], 0, &[])), [Unseen, Unseen]);
        // What is bad is so after the first.
        assert_eq!(of(1, 1, &[310_000]), [Cannot, Cannot]);
        let slow = WindowedCpu { period: Nanos::from_millis(4_190), ..usual() };
        let measured = measured(Class::Deadline, &[], 0, &[]);
        let found = findings(&slow, Some(Ok(measured)), "");
        let remedies = found.iter().filter_map(|it| it.remedy.as_deref());
        assert_eq!(remedies.collect::<Vec<_>>(), ["takt doctor --for 129891ms or longer"; 2]);
    }

    #[test]
    fn an_ordinary_thread_proves_nothing() {
        let slow = measured(Class::Ordinary, &[(50_000, 9)], 3, &[900_000]);
        assert_eq!(severities(slow), [Unseen, Unseen]);
        assert_eq!(severities(measured(Class::Ordinary, &[(1, 9)], 0, &[])), [Unseen, Unseen]);
        assert_eq!(findings(&usual(), None, "")[0].severity, Unseen);
    }

    #[test]
    fn a_measurement_that_takes_its_least_time_has_windows_enough() {
        let frequency = super::super::rate::estimate();
        let cpu = takt_scheduler::table::Cpu(0);
        let cpu = WindowedCpu { cpu, period: Nanos::from_millis(20), ..usual() };
        let measured = measure(&cpu, frequency, Instant::now() + least_time(&cpu)).unwrap();
        // A machine that is busy with other things makes this thread lose some.
        assert!(measured.wake_ups.len() + measured.lost >= LEAST, "{measured:?}");
    }

    #[test]
    fn a_measurement_watches_windows_and_ends() {
        let frequency = super::super::rate::estimate();
        let begun = Instant::now();
        let end = begun + std::time::Duration::from_millis(100);
        let cpu = WindowedCpu { cpu: takt_scheduler::table::Cpu(0), ..usual() };
        let measured = measure(&cpu, frequency, end).unwrap();
        let windows = measured.wake_ups.len() + measured.lost;
        // One each millisecond; a machine that is busy with other things may give this thread more of them.
        let most = begun.elapsed().as_millis() as u64 + 1;
        assert!((50..=most).contains(&windows), "{windows} of {most}");
    }
}
