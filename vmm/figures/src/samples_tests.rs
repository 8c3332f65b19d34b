//! Samples of releases: what a point holds, and that memory does not grow.

use super::*;
use takt_record::Scan;
use takt_record::example as record;
use takt_scheduler::time::TscFrequency;

/// One tick is one nanosecond.
fn base() -> Timebase {
    Timebase { epoch: Tsc(1_000), frequency: TscFrequency::from_khz(1_000_000).unwrap() }
}

fn recorder() -> Recorder {
    Recorder::new(base()).unwrap()
}

fn course(recorder: &Recorder) -> Course {
    recorder.course("plc", &Releases::new(base()).unwrap())
}

#[test]
fn a_release_is_a_point_with_all_that_is_known_of_it() {
    let mut recorder = recorder();
    recorder.add(&record(0, 3, 100));
    recorder.add(&record(1, 7, 200));
    let course = course(&recorder);
    let second = Point {
        release: 1,
        at_ns: 1_000,
        releases: 1,
        latency_ns: Range(7, 7),
        execution_ns: Some(Range(200, 200)),
        interval_ns: Some(Range(1_004, 1_004)),
        donated_ns: Range(400, 400),
    };
    assert_eq!((course.points[0].interval_ns, course.points[1]), (None, second));
    assert_eq!((course.interval_ns, course.donated_ns), (vec![(1_004, 1)], vec![(400, 2)]));
}

#[test]
fn a_lost_release_makes_the_interval_longer_and_a_restart_makes_none() {
    let mut recorder = recorder();
    recorder.add(&record(0, 0, 100));
    recorder.add(&WindowRecord { claim: None, ..record(1, 0, 0) });
    recorder.add(&record(2, 0, 100));
    recorder.restarted();
    recorder.add(&record(9, 0, 100));
    recorder.add(&record(10, 0, 100));
    let points = course(&recorder).points;
    let intervals: Vec<_> = points.iter().map(|p| p.interval_ns.map(|r| r.1)).collect();
    assert_eq!(intervals, [None, Some(2_000), None, Some(1_000)]);
}

#[test]
fn a_scan_without_an_end_has_no_execution_time_and_an_overrun_donates_nothing() {
    let mut recorder = recorder();
    recorder.add(&WindowRecord { left: Tsc(2_500), overrun: true, ..record(0, 0, u64::MAX / 2) });
    let point = course(&recorder).points[0];
    assert_eq!((point.execution_ns, point.donated_ns), (None, Range(0, 0)));
}

#[test]
fn points_are_merged_in_pairs_and_the_worst_stays() {
    let mut recorder = recorder();
    let count = 5 * POINTS_MAX as u64 + 3;
    let outlier = 4_321;
    for n in 0..count {
        let latency = if n == outlier { 450 } else { 1 + n % 3 };
        recorder.add(&record(n, latency, 20 + n % 5));
    }
    let course = course(&recorder);
    assert_eq!(course.releases_per_point, 8);
    assert_eq!(course.points.iter().map(|p| p.releases).sum::<u64>(), count);
    assert!(course.points.iter().all(|p| p.release % 8 == 0 && p.at_ns == p.release * 1_000));
    let worst = course.points.iter().max_by_key(|p| p.latency_ns.1).unwrap();
    assert_eq!(worst.latency_ns, Range(1, 450));
    assert!((worst.release..worst.release + worst.releases).contains(&outlier));
    assert_eq!(worst.interval_ns.unwrap().1, 1_000 + 450 - 1 - (outlier - 1) % 3);
}

#[test]
fn memory_does_not_grow() {
    let mut recorder = recorder();
    let capacity = recorder.points.capacity();
    for n in 0..100_000 {
        recorder.add(&record(n, n % 300, 10));
        assert!(recorder.points.len() <= POINTS_MAX);
    }
    assert_eq!(recorder.points.capacity(), capacity);
}

#[test]
fn claims_that_cannot_be_true_are_left_out() {
    let mut recorder = recorder();
    for start in [0, 999, 1_501, u64::MAX] {
        let claim = Some(Scan { start: Tsc(start), done: Tsc(u64::MAX) });
        recorder.add(&WindowRecord { claim, ..record(0, 0, 0) });
    }
    assert_eq!(course(&recorder).points, []);
}

#[test]
fn the_file_can_be_read_back() {
    let mut recorder = recorder();
    (0..3).for_each(|n| recorder.add(&record(n, n, 100)));
    let samples = Samples {
        schema_version: SCHEMA_VERSION,
        partitions: vec![course(&recorder)],
        loads: Vec::new(),
    };
    let json = serde_json::to_value(&samples).unwrap();
    assert_eq!(json["partitions"][0]["points"][2]["latency_ns"], serde_json::json!([2, 2]));
    assert_eq!(serde_json::from_value::<Samples>(json).unwrap(), samples);
}
