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
use std::sync::atomic::{AtomicUsize, Ordering};

use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::rest::Rest;
use takt_scheduler::sleep::{Sleeper, Steering, Woken};
use takt_scheduler::switch::{ScheduleState, Switch};
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use takt_scheduler::timetable::{Release, Slot, Timetable};

use super::Control;
use super::guest_timer::Deadlines;

/// The windows of one CPU, and who owns each.
pub struct Windows {
    /// All windows of the CPU, as one sequence.
    pub timetable: Timetable,
    /// Owner of each window of a frame, in the same order, by schedule.
    pub owners: Vec<Vec<Arc<Control>>>,
    /// Whether it must end in time whatever the clock does, in the same order
    /// ([`takt_scheduler::schedules::Schedules::must_end_in_time_on`]).
    pub must_end_in_time: Vec<Vec<bool>>,
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
    let Windows { timetable, owners, must_end_in_time, board, quiet, steering, deadlines } =
        windows;
    let mut slot = timetable.first(board.switch());
    let mut all: Vec<Arc<Control>> = owners.iter().flatten().cloned().collect();
    all.sort_unstable_by_key(Arc::as_ptr);
    all.dedup_by_key(|owner| Arc::as_ptr(owner));
    let told = Arc::new(Told { all: all.clone(), next: Default::default() });
    // Most of its wake-ups find no vCPU to kick, so it saves those between: of a clock that is steered it is told
    // by a kick, and looks at it again.
    let sleeper = Sleeper::new(base.frequency).lazy();
    let mut sleeper = sleeper.by_a_clock_whose_steering_is(*steering);
    if let Some(quiet) = quiet {
        let rest = Rest::new(quiet.clone(), board.clone(), *base);
        let told = told.clone();
        sleeper = sleeper.resting(rest.on_steered(Box::new(move || told.tell())));
    }
    loop {
        let owner = |slot: &Slot| match slot {
            Slot::Window(release) => Some(&owners[release.schedule.0][release.window]),
            Slot::Idle(_) => None,
        };
        told.are([owner(&slot), owner(&timetable.after(&slot, board.switch()))]);
        let mut sleep = || match slot {
            Slot::Window(Release { start, end, schedule, window, .. }) => sleeper.until_end(
                base.instant(start),
                base.instant(end),
                must_end_in_time[schedule.0][window],
                own.wake_ups(),
            ),
            Slot::Idle(idle) => sleeper.until(base.instant(idle.start), own.wake_ups()),
        };
        while sleep() == Woken::BySignal {
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
        let (next, late) = next(timetable, &slot, base.offset(now), board.switch());
        if late {
            // What was missed is over, and a window still running past its end belongs to one of these.
            all.iter().for_each(|owner| owner.end_window(now));
        }
        slot = next;
    }
}

/// The threads that are told when the window enforcer finds the clock steered: the owners of the window that ends next,
/// and of the one after it. No other thread sleeps to an instant before the enforcer's next look, and its budget has
/// no room to tell all of many.
struct Told {
    all: Vec<Arc<Control>>,
    /// Places of those two. One that is none is out of `all`.
    next: [AtomicUsize; 2],
}

impl Told {
    fn are(&self, owners: [Option<&Arc<Control>>; 2]) {
        for (next, owner) in self.next.iter().zip(owners) {
            let place =
                owner.and_then(|owner| self.all.iter().position(|it| Arc::ptr_eq(it, owner)));
            next.store(place.unwrap_or(usize::MAX), Ordering::Relaxed);
        }
    }

    fn owners(&self) -> impl Iterator<Item = &Arc<Control>> {
        let places = self.next.iter().map(|place| place.load(Ordering::Relaxed));
        places.filter_map(|place| self.all.get(place))
    }

    fn tell(&self) {
        self.owners().for_each(|owner| owner.tell_steered());
    }
}

/// The slot after this one, never early and never twice; after a long delay the first that is not over, without a loop to
/// get there. Whether there was one.
fn next(timetable: &Timetable, slot: &Slot, now: Nanos, switch: Switch) -> (Slot, bool) {
    let next = timetable.after(slot, switch);
    let over = match next {
        Slot::Window(release) => release.end,
        Slot::Idle(idle) => idle.start,
    };
    if over <= now { (timetable.catch_up(slot, now, switch), true) } else { (next, false) }
}

#[cfg(test)]
mod tests {
    use takt_scheduler::schedules::{ScheduleId, Schedules};
    use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Window};

    use super::*;

    const FRAME: Nanos = Nanos::from_millis(1);

    #[test]
    fn the_owners_of_the_next_two_windows_are_told_and_no_other() {
        let all: Vec<Arc<Control>> = (0..3).map(|_| Arc::default()).collect();
        let told = Told { all: all.clone(), next: Default::default() };
        for (next, expected) in [
            ([Some(&all[1]), Some(&all[2])], vec![1, 2]),
            ([Some(&all[2]), None], vec![2]),
            ([None, None], vec![]),
        ] {
            told.are(next);
            let place = |owner: &Arc<Control>| all.iter().position(|it| Arc::ptr_eq(it, owner));
            let found: Vec<usize> = told.owners().filter_map(place).collect();
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_long_delay_takes_one_step_with_windows_and_without() {
        let plc = |cpu| Placement { cpu: Cpu(cpu), role: Role::Windowed { guard: Nanos::ZERO } };
        let window = |partition| Window {
            partition: PartitionId(partition),
            offset: Nanos::ZERO,
            duration: Nanos::from_micros(300),
            period: FRAME,
        };
        // In the second schedule only the other CPU has one.
        let tables: [&[Window]; 2] = [&[window(0), window(1)], &[window(1)]];
        let schedules = Schedules::new(FRAME, &[plc(0), plc(1)], &tables).unwrap();
        let timetable = schedules.timetable_on(Cpu(0)).unwrap();
        let board = ScheduleState::new(FRAME, 2);
        let with = board.switch();
        let without = Switch { before: ScheduleId(1), after: ScheduleId(1), ..with };
        for switch in [with, without] {
            let first = timetable.first(switch);
            let (second, late) = next(&timetable, &first, Nanos(1), switch);
            assert!(!late && second == timetable.after(&first, switch));
            // A night.
            let now = Nanos(40_000_000 * FRAME.0 + 400_000);
            let (slot, late) = next(&timetable, &first, now, switch);
            assert!(late);
            let reached = match slot {
                Slot::Window(release) => release.frame,
                Slot::Idle(idle) => idle.frame,
            };
            assert!((40_000_000..=40_000_001).contains(&reached), "{reached}");
        }
    }
}
