//! `takt jitter`: from measured wake-ups to a release guard.
//!
//! A guard must be longer than the latest wake-up and the way into the guest together, but every
//! microsecond of it is taken from the background. How late wake-ups are is a property of the host
//! and of its load, which nobody can know without measuring.

use std::fmt::Write;

use takt_scheduler::time::Nanos;

use crate::report::{Partition, Releases, Report};

/// The way from the last look at the clock into the guest's loop: a VM entry, and the loop's first
/// turn. About 1 us in the lab.
const VM_ENTRY: Nanos = Nanos::from_micros(2);
/// Releases below which a proposal would be a guess.
const ENOUGH: u64 = 1_000;

/// The guard that follows from what was measured: the latest wake-up and the slowest entry, twice,
/// since the worst of a run is not the worst there is. In whole microseconds.
#[must_use]
pub fn guard(releases: &Releases) -> Option<Nanos> {
    let (wake_up, entry) = (releases.wake_up_latency_ns?, releases.entry_ns?);
    let needed = Nanos(wake_up.max).plus(Nanos(entry.max)).plus(VM_ENTRY);
    Some(Nanos::from_micros(needed.plus(needed).0.div_ceil(1_000)))
}

/// A line for each partition with releases.
#[must_use]
pub fn proposals(report: &Report) -> String {
    let mut text = String::new();
    for Partition { name, releases, .. } in &report.partitions {
        let Some(releases) = releases else { continue };
        // Writing to a String cannot fail.
        let _ = match (guard(releases), releases.wake_up_latency_ns) {
            (Some(guard), Some(wake_up)) if releases.releases >= ENOUGH => writeln!(
                text,
                "{name}: release_guard = \"{guard}\" (latest of {} wake-ups: {:.1} us; measure under the load and for as long as it matters)",
                releases.releases,
                wake_up.max as f64 / 1e3,
            ),
            _ => writeln!(
                text,
                "{name}: {} releases are too few for a proposal, {ENOUGH} are the least",
                releases.releases
            ),
        };
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Summary;

    fn releases(count: u64) -> Releases {
        let at_most = |max| Some(Summary { min: 0, p50: 0, p99: max, p999: max, max });
        Releases {
            releases: count,
            wake_up_latency_ns: at_most(4_600),
            entry_ns: at_most(900),
            ..Releases::default()
        }
    }

    #[test]
    fn the_guard_is_twice_what_was_needed() {
        assert_eq!(guard(&releases(1)), Some(Nanos::from_micros(15)));
        assert_eq!(guard(&Releases::default()), None);
    }
}
