//! The causes of late starts and long scans.

use super::*;
use takt_record::{DETOURS_MAX, Exit};
use takt_scheduler::schedules::ScheduleId;

/// One tick is one nanosecond.
fn frequency() -> TscFrequency {
    TscFrequency::from_khz(1_000_000).unwrap()
}

/// A window with nothing wrong: released at 100 000, guard 20 000, scanned for 50 000.
fn good() -> WindowRecord {
    WindowRecord {
        sequence: 0,
        schedule: ScheduleId(0),
        skipped: 0,
        release: Tsc(100_000),
        end: Tsc(400_000),
        due: Tsc(80_000),
        woken: Tsc(85_000),
        entered: Tsc(86_000),
        left: Tsc(160_000),
        kicked: None,
        claim: Some(Scan { start: Tsc(100_000), done: Tsc(150_000) }),
        last_stamp: Tsc(150_000),
        exits: 1,
        kernel_exits: 1,
        overrun: false,
        unfinished: false,
        has_tasks: false,
        ended: false,
    }
}

fn claiming(start: u64, done: u64) -> WindowRecord {
    WindowRecord { claim: Some(Scan { start: Tsc(start), done: Tsc(done) }), ..good() }
}

fn detour(left: u64, entered: u64) -> Detour {
    Detour { exit: Exit::Port(1), left: Tsc(left), entered: Tsc(entered) }
}

fn start(record: &WindowRecord, detours: &[Detour]) -> Vec<(Cause, u64)> {
    parts(&of_start(record, detours, frequency()).unwrap())
}

fn parts(explanation: &Explanation) -> Vec<(Cause, u64)> {
    explanation.parts().map(|part| (part.cause, part.explains_ns)).collect()
}

fn scan(record: &WindowRecord, detours: &[Detour], usual: u64) -> Vec<(Cause, u64)> {
    parts(&ScanTime::of(record, detours, frequency()).unwrap().explain(Nanos(usual)))
}

#[test]
fn a_start_in_time_needs_no_explanation() {
    let explanation = of_start(&good(), &[], frequency()).unwrap();
    assert_eq!((explanation, explanation.main()), (Explanation::default(), None));
    assert_eq!(explanation.to_string(), "nothing to explain");
    assert_eq!(of_start(&claiming(99_999, 0), &[], frequency()), None);
    assert_eq!(of_start(&WindowRecord { claim: None, ..good() }, &[], frequency()), None);
}

#[test]
fn a_late_start_is_split_among_all_who_had_a_part_in_it() {
    let record = WindowRecord {
        woken: Tsc(110_000),
        entered: Tsc(113_000),
        exits: 2,
        kernel_exits: 2,
        ..claiming(120_000, 150_000)
    };
    let expected = [
        // The way into the guest took until its first exit.
        (Cause::LateWakeUp { after_due_ns: 30_000 }, 11_000),
        (Cause::HostDelay, 3_000),
        (Cause::VmExits { exits: 1 }, 4_500),
        (Cause::GuestComputation, 1_500),
    ];
    let explanation = of_start(&record, &[detour(114_000, 118_500)], frequency()).unwrap();
    assert_eq!(parts(&explanation), expected);
    assert_eq!(
        explanation.to_string(),
        "late wake-up: 30.0 us after due; host delay: 3.0 us from wake-up to entry; \
         VM exits: 4.5 us in 1 exit; guest computation: 1.5 us"
    );
}

#[test]
fn what_the_guard_absorbs_explains_nothing() {
    let in_time = WindowRecord {
        woken: Tsc(96_000),
        entered: Tsc(97_000),
        exits: 2,
        kernel_exits: 2,
        ..claiming(101_000, 0)
    };
    assert_eq!(start(&in_time, &[]), [(Cause::Unknown, 1_000)]);
    // An exit before the release that lasts beyond it, and one after the start.
    let detours = [detour(90_000, 100_400), detour(102_000, 103_000)];
    let record = WindowRecord { exits: 3, kernel_exits: 3, ..claiming(101_000, 0) };
    let expected = [(Cause::VmExits { exits: 1 }, 400), (Cause::GuestComputation, 600)];
    assert_eq!(start(&record, &detours), expected);
}

#[test]
fn the_way_into_the_guest_belongs_to_who_came_late_to_it() {
    let with = |woken, entered, kernel_exits| WindowRecord {
        woken: Tsc(woken),
        entered: Tsc(entered),
        kernel_exits,
        ..claiming(101_500, 150_000)
    };
    let late = Cause::LateWakeUp { after_due_ns: 18_500 };
    assert_eq!(start(&with(98_500, 98_750, 1), &[]), [(late, 1_500)]);
    // Beyond the longest way, it is something else.
    assert_eq!(start(&with(98_000, 98_000, 1), &[])[1..], [(Cause::GuestComputation, 500)]);
    assert_eq!(start(&with(96_000, 97_000, 1), &[]), [(Cause::GuestComputation, 1_500)]);
    assert_eq!(start(&with(85_000, 99_000, 1), &[]), [(Cause::HostDelay, 1_500)]);
    assert_eq!(start(&with(98_500, 98_750, 2), &[]), [(Cause::HostInterrupt { exits: 1 }, 1_500)]);
}

#[test]
fn host_delay_alone() {
    let record = WindowRecord { woken: Tsc(90_000), entered: Tsc(107_000), ..claiming(107_000, 0) };
    assert_eq!(start(&record, &[]), [(Cause::HostDelay, 7_000)]);
}

#[test]
fn time_in_the_guest_is_the_hosts_if_its_kernel_saw_more_exits() {
    let with = |kernel_exits| WindowRecord { kernel_exits, ..claiming(103_000, 150_000) };
    assert_eq!(start(&with(1), &[]), [(Cause::GuestComputation, 3_000)]);
    assert_eq!(start(&with(3), &[]), [(Cause::HostInterrupt { exits: 2 }, 3_000)]);
    assert_eq!(start(&with(0), &[]), [(Cause::Unknown, 3_000)]);
    let text = of_start(&with(2), &[], frequency()).unwrap().to_string();
    assert_eq!(text, "host interrupt: 3.0 us, 1 exit to its kernel");
}

#[test]
fn exits_that_are_not_recorded_leave_the_time_after_the_last_one_unexplained() {
    let full: Vec<_> =
        (0..u64::from(DETOURS_MAX)).map(|n| detour(110_000 + 20 * n, 110_010 + 20 * n)).collect();
    let record = WindowRecord { exits: 1_000, kernel_exits: 1_000, ..claiming(105_000, 150_000) };
    assert_eq!(start(&record, &full), [(Cause::GuestComputation, 5_000)]);
    let expected = [(Cause::VmExits { exits: 16 }, 160), (Cause::Unknown, 44_840)];
    assert_eq!(scan(&record, &full, 0), expected);
}

#[test]
fn of_a_scan_only_what_is_beyond_the_usual_is_explained() {
    let record = WindowRecord { exits: 3, kernel_exits: 3, ..good() };
    let detours = [detour(120_000, 127_000), detour(149_000, 155_000)];
    let exits = (Cause::VmExits { exits: 2 }, 8_000);
    assert_eq!(scan(&record, &detours, 42_000), [exits]);
    assert_eq!(scan(&record, &detours, 30_000), [exits, (Cause::GuestComputation, 12_000)]);
    assert_eq!(scan(&good(), &[], 50_000), []);
    let interrupted = WindowRecord { kernel_exits: 2, ..good() };
    assert_eq!(scan(&interrupted, &[], 40_000), [(Cause::HostInterrupt { exits: 1 }, 10_000)]);
}

#[test]
fn a_scan_without_an_end_counts_only_in_an_overrun() {
    for done in [0, 99_999, 160_001, u64::MAX] {
        let record = claiming(100_000, done);
        assert_eq!(ScanTime::of(&record, &[], frequency()), None);
        let overrun = WindowRecord { overrun: true, ..record };
        let time = ScanTime::of(&overrun, &[], frequency()).unwrap();
        assert_eq!((time.finished, time.execution), (false, Nanos(60_000)));
    }
}

#[test]
fn of_equal_parts_the_first_is_the_main_one() {
    let record = WindowRecord {
        woken: Tsc(105_000),
        entered: Tsc(110_000),
        kernel_exits: 1,
        ..claiming(115_000, 0)
    };
    let explanation = of_start(&record, &[], frequency()).unwrap();
    assert_eq!(explanation.parts().count(), 3);
    assert_eq!(explanation.main().unwrap().cause, Cause::LateWakeUp { after_due_ns: 25_000 });
}

#[test]
fn parts_never_explain_more_than_there_is() {
    let bad = [0, 1, 80_000, 100_000, 120_000, 160_000, u64::MAX];
    for (i, a) in bad.into_iter().enumerate() {
        for b in bad {
            let record = WindowRecord {
                due: Tsc(bad[(i + 3) % bad.len()]),
                woken: Tsc(a),
                entered: Tsc(b),
                exits: (a % 5) as u32,
                kernel_exits: b,
                ..claiming(130_000, b)
            };
            let detours = [detour(a, b), detour(b, a), detour(a, a), detour(100_000, b)];
            let total: u64 = start(&record, &detours).iter().map(|(_, ns)| ns).sum();
            assert_eq!(total, 30_000, "{record:?}");
            let overrun = WindowRecord { overrun: true, ..record };
            let time = ScanTime::of(&overrun, &detours, frequency()).unwrap();
            let total: u64 = parts(&time.explain(Nanos(0))).iter().map(|(_, ns)| ns).sum();
            assert_eq!(total, time.execution.0, "{record:?}");
        }
    }
    let never = WindowRecord { release: Tsc(0), left: Tsc(u64::MAX), ..claiming(u64::MAX, 0) };
    let slow = TscFrequency::from_khz(1).unwrap();
    assert!(of_start(&never, &[detour(0, u64::MAX)], slow).is_some());
}

#[test]
fn json_names_a_cause_as_it_names_itself() {
    for cause in [
        Cause::LateWakeUp { after_due_ns: 1 },
        Cause::HostDelay,
        Cause::VmExits { exits: 1 },
        Cause::HostInterrupt { exits: 1 },
        Cause::GuestComputation,
        Cause::Unknown,
    ] {
        let json = serde_json::to_value(Part { cause, explains_ns: 7 }).unwrap();
        assert_eq!(
            (&json["cause"], &json["explains_ns"]),
            (&serde_json::to_value(cause.name()).unwrap(), &7.into())
        );
    }
    let explanation = Explanation::new(&[(Cause::HostDelay, Nanos(0)), (Cause::Unknown, Nanos(2))]);
    let json = serde_json::to_value(explanation).unwrap();
    assert_eq!(json, serde_json::json!([{ "cause": "unknown", "explains_ns": 2 }]));
}
