//! From measured wake-ups to a release guard.
//!
//! A guard must be longer than the latest wake-up and the way into the guest together, but every
//! microsecond of it is taken from the background. How late wake-ups are is a property of the host
//! and of its load, and can only be measured.

use takt_scheduler::table::GUARD_MAX;
use takt_scheduler::time::Nanos;

use takt_figures::report::{Partition, Releases};

/// The way from the last look at the clock into the guest's loop: a VM entry, and the loop's first
/// turn. About 1 us in the lab.
const VM_ENTRY: Nanos = Nanos::from_micros(2);
/// Releases below which a proposal would be a guess.
const ENOUGH: u64 = 1_000;

/// The guard that follows from what was measured: the latest wake-up and the slowest entry, twice,
/// since the worst of a run is not the worst there is. In whole microseconds.
fn guard(releases: &Releases) -> Option<Nanos> {
    let (wake_up, entry) = (releases.wake_up_latency_ns?, releases.entry_ns?);
    let needed = Nanos(wake_up.max).plus(Nanos(entry.max)).plus(VM_ENTRY);
    Some(Nanos(needed.plus(needed).0.div_ceil(1_000).saturating_mul(1_000)))
}

/// A line for a partition with releases.
pub fn proposal(partition: &Partition) -> Option<String> {
    let releases = partition.releases.as_ref()?;
    let count = releases.releases;
    Some(match (guard(releases), releases.wake_up_latency_ns) {
        (Some(guard), Some(wake_up)) if count >= ENOUGH && guard > GUARD_MAX => format!(
            "no release_guard is long enough for the latest of {count} wake-ups, which was {:.1} us late: {GUARD_MAX} is the longest",
            wake_up.max as f64 / 1e3,
        ),
        (Some(guard), Some(wake_up)) if count >= ENOUGH => format!(
            "release_guard = \"{guard}\" (latest of {count} wake-ups: {:.1} us; measure under the load and for as long as it matters)",
            wake_up.max as f64 / 1e3,
        ),
        _ => format!("{count} releases are too few to propose a guard, {ENOUGH} are the least"),
    })
}

#[cfg(test)]
mod tests {
    use takt_figures::report::Summary;

    use super::*;

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
        let immense = Some(Summary { min: 0, p50: 0, p99: 0, p999: 0, max: u64::MAX });
        assert!(guard(&Releases { wake_up_latency_ns: immense, ..releases(1) }).is_some());
    }

    #[test]
    fn no_guard_is_proposed_that_a_file_cannot_have() {
        let proposal = |wake_up| {
            let wake_up = Some(Summary { min: 0, p50: 0, p99: 0, p999: 0, max: wake_up });
            let releases = Releases { wake_up_latency_ns: wake_up, ..releases(ENOUGH) };
            let plc = Partition { releases: Some(releases), ..Partition::default() };
            super::proposal(&plc).unwrap()
        };
        assert!(proposal(497_100).starts_with("release_guard = \"1ms\""));
        let none = proposal(497_101);
        assert!(none.starts_with("no release_guard is long enough"), "{none}");
        assert!(none.contains("497.1 us late: 1ms is the longest"), "{none}");
    }

    #[test]
    fn few_releases_are_no_proposal() {
        let proposal = |count| {
            let releases = Some(releases(count));
            proposal(&Partition { releases, ..Partition::default() }).unwrap()
        };
        assert!(proposal(ENOUGH).starts_with("release_guard = \"15us\""));
        assert!(proposal(ENOUGH - 1).contains("too few"));
    }
}
