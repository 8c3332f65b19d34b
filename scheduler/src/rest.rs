//! Where a thread of the schedule may wake between the pieces of a sleep.
//!
//! Such a wake-up serves no window, so it must not fall into one: it would interrupt a program between its
//! guard and its "done". It is moved to the last instant before, from which it is over in time.
//!
//! So is, where there is room, the kernel's interrupt that follows it: some time after a thread with a reservation
//! has gone to sleep, its bandwidth is taken back ([`Reservation::taken_back_after`]). Of a thread that has
//! little of a long period it comes long after the wake-up.

use std::fmt;
use std::sync::Arc;

use crate::quiet::{QuietTimes, WAKE_UP};
use crate::reservation::Reservation;
use crate::switch::ScheduleState;
use crate::time::{Nanos, Timebase, Tsc};

/// Called when the clock is found steered.
pub type Listener = Box<dyn Fn() + Send>;

/// What a sleeping thread knows of its CPU.
pub struct Rest {
    quiet: QuietTimes,
    board: Arc<ScheduleState>,
    base: Timebase,
    /// From a wake-up until the interrupt that follows it is over.
    pub(crate) followed: Nanos,
    on_steered: Option<Listener>,
}

impl Rest {
    /// Outside of these times, under the schedule that the board shows.
    #[must_use]
    pub fn new(quiet: QuietTimes, board: Arc<ScheduleState>, base: Timebase) -> Rest {
        Rest { quiet, board, base, followed: WAKE_UP, on_steered: None }
    }

    /// Of a thread with this reservation.
    #[must_use]
    pub fn reserved(self, reservation: &Reservation) -> Rest {
        Rest { followed: reservation.taken_back_after(WAKE_UP).plus(WAKE_UP), ..self }
    }

    /// Has another thread told, at once, when this one finds the clock steered for the first time in
    /// long.
    #[must_use]
    pub fn on_steered(self, listener: Listener) -> Rest {
        Rest { on_steered: Some(listener), ..self }
    }

    pub(crate) fn tell_steered(&self) {
        if let Some(listener) = &self.on_steered {
            listener();
        }
    }

    /// The last instant up to `at` from which `room` is over before any quiet time; `None` if there is no gap
    /// before it.
    pub(crate) fn before(&self, at: Tsc, room: Nanos) -> Option<Tsc> {
        // Before the epoch there are no windows.
        if at < self.base.epoch {
            return Some(at);
        }
        let offset = self.base.offset(at);
        let placed = self.quiet.before(offset, room, self.board.switch())?;
        Some(if placed == offset { at } else { self.base.instant(placed) })
    }

    /// The first instant from `at` on that is in no quiet time; `None` if there is no gap.
    pub(crate) fn after(&self, at: Tsc) -> Option<Tsc> {
        if at < self.base.epoch {
            return Some(at);
        }
        let next = self.quiet.next(self.base.offset(at), self.board.switch())?;
        Some(self.base.instant(next).max(at))
    }
}

impl fmt::Debug for Rest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Rest").field("quiet", &self.quiet).finish_non_exhaustive()
    }
}
