//! What a record says, and one for the tests of those who read it.

use super::*;

/// Of a window of 900 ns, which is left after 500, in each frame of 1000. One tick is one
/// nanosecond, and the epoch at tick 1000.
pub(crate) fn example(sequence: u64, latency: u64, execution: u64) -> WindowRecord {
    let release = 1_000 + 1_000 * sequence;
    let start = Tsc(release + latency);
    WindowRecord {
        sequence,
        schedule: ScheduleId(0),
        skipped: 0,
        release: Tsc(release),
        end: Tsc(release + 900),
        due: Tsc(release - 20),
        woken: Tsc(release - 10),
        entered: Tsc(release - 5),
        left: Tsc(release + 500),
        kicked: None,
        claim: Some(Scan { start, done: Tsc(start.0 + execution) }),
        last_stamp: start,
        exits: 1,
        kernel_exits: 1,
        overrun: false,
        ended: false,
    }
}

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
fn a_claim_outside_the_window_is_not_believed() {
    assert!(record(100, 95, 200, 100).scan().is_some());
    for impossible in [0, 99, 201, u64::MAX] {
        assert_eq!(record(100, 95, 200, impossible).scan(), None);
    }
}
