//! What a record says.

use super::*;

fn record(release: u64, entered: u64, left: u64, start: u64) -> WindowRecord {
    WindowRecord {
        release: Tsc(release),
        entered: Tsc(entered),
        left: Tsc(left),
        claim: Some(Scan { start: Tsc(start), done: Tsc(0) }),
        ..example(0, 0, 0)
    }
}

#[test]
fn a_wake_up_later_than_the_guard_makes_a_late_release() {
    assert!(!record(100, 95, 200, 100).is_late());
    assert!(!record(100, 100, 200, 100).is_late());
    assert!(record(100, 101, 200, 101).is_late());
}

#[test]
fn a_scan_is_finished_if_it_ended_after_its_start_and_in_its_window() {
    let until = |done| {
        let claim = Some(Scan { start: Tsc(100), done: Tsc(done) });
        WindowRecord { claim, ..record(100, 95, 200, 100) }.finished_scan().is_some()
    };
    assert!(until(100) && until(200));
    assert!(!until(99) && !until(201) && !until(0));
}

#[test]
fn a_claim_outside_the_window_is_not_believed() {
    assert!(record(100, 95, 200, 100).scan().is_some());
    for impossible in [0, 99, 201, u64::MAX] {
        assert_eq!(record(100, 95, 200, impossible).scan(), None);
    }
}
