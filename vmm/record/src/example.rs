//! A record for the tests of all crates that read records.

use takt_scheduler::schedules::ScheduleId;
use takt_scheduler::time::Tsc;

use crate::{Scan, WindowRecord};

/// Of a window of 900 ns, which is left after 500, in each frame of 1000. One tick is one
/// nanosecond, and the epoch at tick 1000.
#[must_use]
pub fn example(sequence: u64, latency: u64, execution: u64) -> WindowRecord {
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
        unfinished: false,
        has_tasks: false,
        ended: false,
    }
}
