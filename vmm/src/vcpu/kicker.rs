//! Ending windows.
//!
//! One thread per CPU sleeps from one window's end to the next and kicks whoever is still inside.
//! It is a SCHED_DEADLINE thread with an earlier deadline than any vCPU's, so it preempts the
//! offender at once, also where both share their only CPU. Timers that deliver a signal would be
//! simpler, but on a PREEMPT_RT kernel they expire in a thread that the vCPU itself starves;
//! an absolute sleep of a deadline thread expires in the timer interrupt.

use std::sync::Arc;

use takt_scheduler::enforce::{Woken, sleep_until};
use takt_scheduler::table::Releases;
use takt_scheduler::time::{Timebase, Tsc};

use super::Control;

/// The windows of one CPU, and who owns each.
pub struct Windows {
    /// All windows of the CPU, as one sequence.
    pub releases: Releases,
    /// Owner of each window of a frame, in the same order.
    pub owners: Vec<Arc<Control>>,
}

/// Kicks until it is told to stop.
pub fn run(windows: &Windows, base: &Timebase, own: &Control) {
    let mut release = windows.releases.nth(0);
    loop {
        let end = base.instant(release.end);
        while sleep_until(end, base.frequency) == Woken::BySignal {
            if own.stopping() {
                return;
            }
        }
        // Also for a thread that is never asleep when it is told.
        if own.stopping() {
            return;
        }
        let now = Tsc::now();
        windows.owners[release.sequence as usize % windows.owners.len()].end_window(now);
        // Never early and never twice, and without a loop to catch up after a long delay: what
        // was missed is over, and a window still running past its end belongs to one of these.
        let next = windows.releases.nth(release.sequence + 1);
        release = if base.instant(next.end) > now {
            next
        } else {
            for owner in &windows.owners {
                owner.end_window(now);
            }
            windows.releases.first_ending_after(base.offset(now))
        };
    }
}
