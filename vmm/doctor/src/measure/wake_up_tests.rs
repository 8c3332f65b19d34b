//! What is said of measurements that are made up, and of two that are made.

use super::*;
use crate::finding::Severity::{self, Cannot, Good, Unseen, Warning};
use crate::recorded::Recorded;

fn no_host() -> Host {
    Host::recorded("/none".as_ref(), String::new())
}

/// A guard of 20 us, a window of 300 us.
fn usual() -> WindowedCpu {
    Demand::usual(&no_host()).windowed.remove(0)
}

fn judged(cpu: &WindowedCpu, measured: Option<Measured>) -> Vec<Finding> {
    let host = no_host();
    findings(&host, &Demand::usual(&host), cpu, measured.map(Ok), "")
}

fn measured(class: Class, wake_ups: &[(u64, u64)], lost: u64, away: &[u64]) -> Measured {
    let histogram = || Histogram::new_with_bounds(1, LONGEST, 3).unwrap();
    let mut it = Measured { class, wake_ups: histogram(), lost, gaps: histogram() };
    wake_ups.iter().for_each(|&(ns, times)| it.wake_ups.record_n(ns, times).unwrap());
    away.iter().for_each(|&ns| it.gaps.record(ns).unwrap());
    it
}

fn severities(measured: Measured) -> [Severity; 2] {
    let findings = judged(&usual(), Some(measured));
    [findings[0].severity, findings[1].severity]
}

#[test]
fn wake_ups_are_held_against_the_guard() {
    let class = Class::Deadline;
    assert_eq!(severities(measured(class, &[(5_000, 3000)], 0, &[])), [Good, Good]);
    let rarely = measured(class, &[(5_000, 2999), (25_000, 1)], 0, &[]);
    let found = judged(&usual(), Some(rarely));
    assert_eq!(found[0].severity, Warning);
    assert!(found[0].remedy.as_ref().unwrap().ends_with("release_guard = \"40us\""));
    let too_late = measured(class, &[(5_000, 9), (700_000, 1)], 0, &[]);
    let found = judged(&usual(), Some(too_late));
    assert!(found[0].remedy.as_ref().unwrap().ends_with("no guard is long enough for this"));
    let often = measured(class, &[(5_000, 2990), (25_000, 10)], 0, &[]);
    assert_eq!(severities(often), [Cannot, Good]);
    assert_eq!(severities(measured(class, &[(5_000, 3000)], 1, &[])), [Cannot, Good]);
}

#[test]
fn a_guard_is_proposed_only_if_it_is_longer() {
    let remedy = |guard, latest, lost| {
        let cpu = WindowedCpu { guard: Some(Nanos::from_micros(guard)), ..usual() };
        let measured = measured(Class::Deadline, &[(latest, 3000)], lost, &[]);
        judged(&cpu, Some(measured)).remove(0).remedy.unwrap()
    };
    assert!(remedy(20, 25_000, 0).ends_with("release_guard = \"40us\""));
    // Windows were slept through, and what woke came early enough.
    for latest in [5_000, 13_000] {
        let told = remedy(20, latest, 1);
        assert!(!told.contains("release_guard"), "{told}");
    }
    assert!(remedy(20, 19_000, 1).contains("release_guard = \"30us\""));
    assert!(!remedy(40, 19_000, 1).contains("release_guard"));
    // No longer guard would fit, but none is needed.
    let full = WindowedCpu {
        guard: Some(Nanos::from_micros(10)),
        window: Nanos::from_micros(945),
        period: Nanos::from_millis(1),
        ..usual()
    };
    let measured = measured(Class::Deadline, &[(5_000, 3000)], 1, &[]);
    let told = judged(&full, Some(measured)).remove(0).remedy.unwrap();
    assert_eq!(told, "mend what stands above: no wake-up was later than the guard");
}

#[test]
fn ticks_that_only_a_run_has_are_told_to_be_missing() {
    let of = |class, nohz_full: &str| {
        let host = Recorded::named("workstation");
        let host = host.with("sys/devices/system/cpu/nohz_full", nohz_full).unpack();
        let demand = Demand::usual(&host.host);
        let measured = measured(class, &[(5_000, 3000)], 0, &[]);
        let cpu = &demand.windowed[0];
        let told = findings(&host.host, &demand, cpu, Some(Ok(measured)), "");
        told[1].found.contains("ticks of a run are missing")
    };
    assert!(of(Class::Fifo, "6-7"));
    assert!(!of(Class::Fifo, "6") && !of(Class::Deadline, "6-7"));
}

#[test]
fn gaps_are_held_against_guard_and_window() {
    let of = |away: &[u64]| severities(measured(Class::Fifo, &[(5_000, 3000)], 0, away))[1];
    assert_eq!([of(&[4_000; 50]), of(&[4_000, 40_000]), of(&[310_000])], [Good, Warning, Cannot]);
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
    let found = judged(&slow, Some(measured));
    let remedies = found.iter().filter_map(|it| it.remedy.as_deref());
    assert_eq!(remedies.collect::<Vec<_>>(), ["takt doctor --for 129891ms # or longer"; 2]);
}

#[test]
fn an_ordinary_thread_proves_nothing() {
    let slow = measured(Class::Ordinary, &[(50_000, 9)], 3, &[900_000]);
    assert_eq!(severities(slow), [Unseen, Unseen]);
    assert_eq!(severities(measured(Class::Ordinary, &[(1, 9)], 0, &[])), [Unseen, Unseen]);
    assert_eq!(judged(&usual(), None)[0].severity, Unseen);
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
