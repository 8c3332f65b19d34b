//! Limits that make a measurement a test.
//!
//! They hold for every partition that has releases. A measurement without figures keeps no limit:
//! one release that was not recorded may be the one that was too late. Nor does one whose load is not
//! proved: what it says was not asked. Nor does one of a partition that was started anew or ended before the
//! run did: releases that it should have had meanwhile are counted nowhere. Nor does one in which the schedule has
//! changed, for the same reason: it may have left out a partition.

use serde::Serialize;
use takt_scheduler::time::Nanos;

use crate::proof::Proof;
use takt_figures::report::{Partition, STOPPED};

/// What is asked for; `None` for what is not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// Latest start after a release.
    pub latency: Option<Nanos>,
    /// Most releases later than the guard can absorb.
    pub late: Option<u64>,
    /// Most releases that never happened. Where there is another limit, `None` means none: such a release has no
    /// latency that could be held against that one.
    pub lost: Option<u64>,
}

/// What a breach is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A limit was exceeded, or can be kept by no such measurement.
    Limit,
    /// The load that was asked for is not proved.
    Load,
}

/// Why the limits are not kept.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Breach {
    /// Of what.
    pub kind: Kind,
    /// The partition that broke it; empty if it is not about one.
    pub partition: String,
    /// What was found, and what was allowed.
    pub text: String,
}

impl Limits {
    /// True if there is none.
    pub fn none(&self) -> bool {
        *self == Self::default()
    }

    /// Limits that were exceeded, in the order of the partitions, and a load that is not proved.
    pub fn breaches(&self, partitions: &[Partition], proof: Option<&Proof>) -> Vec<Breach> {
        let mut breaches = Vec::new();
        if self.none() {
            return breaches;
        }
        let mut measured = false;
        for Partition { name, releases, failed, end, restarts, .. } in partitions {
            let mut breach = |text| {
                breaches.push(Breach { kind: Kind::Limit, partition: name.clone(), text });
            };
            if *failed {
                breach(format!("it has failed: {end}"));
            }
            let Some(r) = releases else { continue };
            measured = true;
            if !failed && end != STOPPED {
                breach(format!("it did not run until the end: {end}"));
            }
            if *restarts > 0 {
                breach(format!("it was started anew {restarts} times, without releases meanwhile"));
            }
            if r.unrecorded > 0 {
                breach(format!("{} windows are in no figure", r.unrecorded));
            }
            match (self.latency, r.release_latency_ns) {
                (Some(limit), Some(latency)) if latency.max > limit.0 => breach(format!(
                    "the latest release was {} late, {limit} are allowed",
                    Nanos(latency.max)
                )),
                (_, None) => breach("there was no release".into()),
                _ => {}
            }
            for (limit, found, what) in
                [(self.late, r.late_releases, "late"), (self.lost.or(Some(0)), r.lost, "lost")]
            {
                if let Some(limit) = limit.filter(|limit| found > *limit) {
                    breach(format!("{found} releases were {what}, {limit} are allowed"));
                }
            }
        }
        if !measured {
            let text = "no partition has releases that could be measured".into();
            breaches.push(Breach { kind: Kind::Limit, partition: String::new(), text });
        }
        if let Some(Proof { reason: Some(reason), partition, .. }) = proof {
            let (partition, text) = (partition.clone(), reason.clone());
            breaches.push(Breach { kind: Kind::Load, partition, text });
        }
        breaches
    }

    /// That a run was ended before it had lasted as long as was asked for, as by Ctrl-C: what would have come then is
    /// not measured. Takt itself ends none earlier, by the same clock; and one whose partitions have all ended goes by
    /// what is said of them.
    pub fn cut_short(
        &self,
        partitions: &[Partition],
        duration: Nanos,
        asked: Option<Nanos>,
    ) -> Option<Breach> {
        let asked = asked.filter(|asked| !self.none() && duration < *asked)?;
        partitions.iter().find(|partition| partition.end == STOPPED)?;
        let text = format!("the run ended after {:.3} s of {asked}", duration.0 as f64 / 1e9);
        Some(Breach { kind: Kind::Limit, partition: String::new(), text })
    }

    /// That another schedule was active for a part of the run. A report does not tell which partitions have windows in it,
    /// and one without any has no release that could be late or lost.
    pub fn schedule_changed(&self, last_switch_ns: Option<u64>) -> Option<Breach> {
        let at = last_switch_ns.filter(|_| !self.none())?;
        let text = format!(
            "the schedule has changed, at {:.3} s for the last time, and a partition may have had no windows meanwhile",
            at as f64 / 1e9
        );
        Some(Breach { kind: Kind::Limit, partition: String::new(), text })
    }
}

#[cfg(test)]
mod tests {
    use takt_figures::report::Summary;

    use super::*;
    use takt_figures::report::Releases;

    fn partitions(max: u64, late: u64, lost: u64) -> [Partition; 2] {
        let summary = Summary { min: 0, p50: 1, p99: 2, p999: 2, max };
        let releases = Releases {
            releases: 10,
            late_releases: late,
            lost,
            release_latency_ns: Some(summary),
            ..Releases::default()
        };
        let plc = Partition {
            name: "plc".into(),
            end: STOPPED.into(),
            releases: Some(releases),
            ..Partition::default()
        };
        [plc, Partition { name: "linux".into(), ..Partition::default() }]
    }

    fn texts(limits: Limits, partitions: &[Partition]) -> Vec<String> {
        limits.breaches(partitions, None).into_iter().map(|b| b.text).collect()
    }

    const STRICT: Limits = Limits { latency: Some(Nanos(10)), late: Some(0), lost: Some(2) };

    #[test]
    fn what_is_exactly_at_a_limit_keeps_it() {
        assert!(texts(STRICT, &partitions(10, 0, 2)).is_empty());
        assert!(texts(Limits::default(), &partitions(u64::MAX, 9, 9)).is_empty());
    }

    #[test]
    fn each_limit_is_told_on_its_own() {
        let expected = [
            "the latest release was 11ns late, 10ns are allowed",
            "1 releases were late, 0 are allowed",
            "3 releases were lost, 2 are allowed",
        ];
        assert_eq!(texts(STRICT, &partitions(11, 1, 3)), expected);
        let only_lost = Limits { lost: Some(2), ..Limits::default() };
        assert_eq!(texts(only_lost, &partitions(11, 1, 3)), expected[2..]);
    }

    #[test]
    fn a_release_that_is_missing_keeps_no_limit_unless_it_is_allowed() {
        let latency = Limits { latency: Some(Nanos(10)), ..Limits::default() };
        let late = Limits { late: Some(0), ..Limits::default() };
        for limits in [latency, late] {
            assert!(texts(limits, &partitions(10, 0, 0)).is_empty());
            let missing = texts(limits, &partitions(10, 0, 9_999));
            assert_eq!(missing, ["9999 releases were lost, 0 are allowed"]);
            let allowed = Limits { lost: Some(9_999), ..limits };
            assert!(texts(allowed, &partitions(10, 0, 9_999)).is_empty());
        }
    }

    #[test]
    fn a_partition_that_was_not_there_all_the_time_keeps_no_limit() {
        let latency = Limits { latency: Some(Nanos(10)), ..Limits::default() };
        let late = Limits { late: Some(0), ..Limits::default() };
        let lost = Limits { lost: Some(0), ..Limits::default() };
        let changed = |change: fn(&mut Partition)| {
            let mut partitions = partitions(1, 0, 0);
            change(&mut partitions[0]);
            partitions
        };
        let ended = changed(|plc| plc.end = "ended itself with code 0".into());
        let failed =
            changed(|plc| (plc.failed, plc.end) = (true, "ended itself with code 1".into()));
        let restarted = changed(|plc| plc.restarts = 2);
        let mut linux_failed = partitions(1, 0, 0);
        (linux_failed[1].failed, linux_failed[1].end) = (true, "triple fault".into());
        for (partitions, expected) in [
            (ended, "it did not run until the end: ended itself with code 0"),
            (failed, "it has failed: ended itself with code 1"),
            (restarted, "it was started anew 2 times, without releases meanwhile"),
            (linux_failed, "it has failed: triple fault"),
        ] {
            for limits in [latency, late, lost] {
                assert_eq!(texts(limits, &partitions), [expected]);
            }
            assert!(texts(Limits::default(), &partitions).is_empty());
        }
    }

    #[test]
    fn a_load_that_is_not_proved_keeps_no_limit() {
        let reason = Some("the load stood still".to_owned());
        let missing = Proof { proved: false, reason, partition: "linux".into() };
        let given = Proof { proved: true, reason: None, ..missing.clone() };
        for limits in [STRICT, Limits { lost: Some(9), ..Limits::default() }] {
            let [breach] = &limits.breaches(&partitions(1, 0, 0), Some(&missing))[..] else {
                panic!("one breach")
            };
            let told = (breach.kind, breach.partition.as_str(), breach.text.as_str());
            assert_eq!(told, (Kind::Load, "linux", "the load stood still"));
            assert!(limits.breaches(&partitions(1, 0, 0), Some(&given)).is_empty());
        }
        let none = Limits::default();
        assert!(none.breaches(&partitions(1, 0, 0), Some(&missing)).is_empty());
    }

    #[test]
    fn a_run_that_was_cut_short_keeps_no_limit() {
        let (partitions, day) = (partitions(1, 0, 0), Some(Nanos::from_millis(86_400_000)));
        let text = |limits: Limits, ms, asked| {
            let breach = limits.cut_short(&partitions, Nanos::from_millis(ms), asked)?;
            Some((breach.partition, breach.text))
        };
        let told = (String::new(), "the run ended after 3.000 s of 86400s".to_owned());
        assert_eq!(text(STRICT, 3_000, day), Some(told));
        assert_eq!(text(STRICT, 86_400_000, day), None);
        assert_eq!(text(STRICT, 3_000, None), None);
        assert_eq!(text(Limits::default(), 3_000, day), None);
        let mut ended = partitions.clone();
        ended[0].end = "ended itself with code 0".into();
        assert_eq!(STRICT.cut_short(&ended, Nanos::from_millis(3_000), day), None);
    }

    #[test]
    fn a_run_in_which_the_schedule_has_changed_keeps_no_limit() {
        let told = STRICT.schedule_changed(Some(1_500_000_000)).unwrap();
        assert!(told.text.starts_with("the schedule has changed, at 1.500 s "), "{}", told.text);
        assert_eq!((told.kind, told.partition.as_str()), (Kind::Limit, ""));
        assert_eq!(STRICT.schedule_changed(None), None);
        assert_eq!(Limits::default().schedule_changed(Some(1)), None);
    }

    #[test]
    fn what_was_not_measured_keeps_no_limit() {
        let mut unseen = partitions(1, 0, 0);
        if let Some(releases) = &mut unseen[0].releases {
            (releases.unrecorded, releases.release_latency_ns) = (4, None);
        }
        assert_eq!(texts(STRICT, &unseen), ["4 windows are in no figure", "there was no release"]);
        assert_eq!(texts(STRICT, &unseen[1..]).len(), 1);
        assert_eq!(texts(STRICT, &[]).len(), 1);
    }
}
