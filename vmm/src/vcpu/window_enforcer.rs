//! Ending windows.
//!
//! One thread per CPU sleeps from one window's end to the next and kicks a vCPU that is still inside.
//! It is a SCHED_DEADLINE thread with an earlier deadline than any vCPU's, so it preempts the
//! offender at once, also where both share their only CPU. Timers that deliver a signal would be
//! simpler, but on a PREEMPT_RT kernel they expire in a thread that the vCPU itself starves;
//! an absolute sleep of a deadline thread expires in the timer interrupt.
//!
//! It also adopts switches of the schedule, see [`takt_scheduler::switch`].

use std::sync::Arc;

use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::rest::Rest;
use takt_scheduler::sleep::{Sleeper, Steering, Woken};
use takt_scheduler::switch::ScheduleState;
use takt_scheduler::time::{Timebase, Tsc};
use takt_scheduler::timetable::{Slot, Timetable};

use super::Control;
use super::guest_timer::Deadlines;

/// The windows of one CPU, and who owns each.
pub struct Windows {
    /// All windows of the CPU, as one sequence.
    pub timetable: Timetable,
    /// Owner of each window of a frame, in the same order, by schedule.
    pub owners: Vec<Vec<Arc<Control>>>,
    /// Which schedule holds.
    pub board: Arc<ScheduleState>,
    /// In which it does not wake between the pieces of a sleep.
    pub quiet: Option<QuietTimes>,
    /// Whether the clock of its sleeps may be steered.
    pub steering: Steering,
    /// Of all Linuxes, which go by the schedule.
    pub deadlines: Box<[Arc<Deadlines>]>,
}

/// Kicks until it is told to stop.
pub fn run(windows: &Windows, base: &Timebase, own: &Control) {
    let Windows { timetable, owners, board, quiet, steering, deadlines } = windows;
    let mut slot = timetable.first(board.switch());
    // Most of its wake-ups find no vCPU to kick, so it saves those between: of a clock that is steered it is told
    // by a kick, and looks at it again.
    let sleeper = Sleeper::new(base.frequency).lazy();
    let mut sleeper = sleeper.by_a_clock_whose_steering_is(*steering);
    if let Some(quiet) = quiet {
        sleeper = sleeper.resting(Rest::new(quiet.clone(), board.clone(), *base));
    }
    loop {
        let instant = base.instant(match slot {
            Slot::Window(release) => release.end,
            Slot::Idle(idle) => idle.start,
        });
        while sleeper.until(instant, own.wake_ups()) == Woken::BySignal {
            if own.stopping() {
                return;
            }
        }
        // Also for a thread that is never asleep when it is told.
        if own.stopping() {
            return;
        }
        let now = Tsc::now();
        if let Slot::Window(release) = slot {
            owners[release.schedule.0][release.window].end_window(now);
        }
        if board.adopt(|| base.offset(Tsc::now())) {
            deadlines.iter().for_each(|deadlines| deadlines.look_again());
        }
        let next = timetable.after(&slot, board.switch());
        // Never early and never twice, and without a loop to catch up after a long delay: what
        // was missed is over, and a window still running past its end belongs to one of these.
        slot = match next {
            Slot::Window(release) if base.instant(release.end) <= now => {
                for owner in owners.iter().flatten() {
                    owner.end_window(now);
                }
                timetable.catch_up(&slot, base.offset(now), board.switch())
            }
            next => next,
        };
    }
}
