//! Changing from one schedule to another, at the end of a frame.
//!
//! Several threads on several CPUs follow the schedule, each from release to release, and each
//! tells its guest of the window after the next. A switch must therefore be known *before* any of
//! them has planned a frame in which it holds, without one waiting for another. So:
//!
//! * which schedule holds in which frame is one word ([`Switch`]), read with one load;
//! * a request is only noted. A thread that ends windows adopts it the next time it wakes: it is a
//!   deadline thread, and looks at the clock just before the store. The host can stop it between the two all the same,
//!   for longer than is allowed for. So it looks again behind the store, and what came too late is told;
//! * the switch is adopted for the frame *after* the next one. A thread plans frame *n + 1* no
//!   earlier than its guard before frame *n*, and by then the word says what holds there.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use thiserror::Error;

use crate::table::{GUARD_MAX, SCHEDULES_MAX, ScheduleId};
use crate::time::Nanos;

/// How long before a frame begins threads may plan the one after it: the longest guard, and as
/// much again for a delay of the adopting thread between its clock and its store.
const LEAD: Nanos = GUARD_MAX.plus(GUARD_MAX);
/// Bits of the frame's number in the word; at the shortest frame they last for 880 years.
const FRAME_BITS: u32 = 48;
const _: () = assert!(SCHEDULES_MAX <= 1 << 8);

/// Which schedule holds when: `before` until the start of `frame`, from then on `after`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Switch {
    /// The schedule up to the switch.
    pub before: ScheduleId,
    /// The schedule from the switch on.
    pub after: ScheduleId,
    /// The first frame under `after`.
    pub frame: u64,
}

impl Switch {
    /// The schedule of a frame.
    #[must_use]
    pub const fn schedule_of(&self, frame: u64) -> ScheduleId {
        if frame < self.frame { self.before } else { self.after }
    }

    const fn pack(self) -> u64 {
        let frame = self.frame & ((1 << FRAME_BITS) - 1);
        (self.before.0 as u64) << 56 | (self.after.0 as u64) << FRAME_BITS | frame
    }

    const fn unpack(word: u64) -> Switch {
        Switch {
            before: ScheduleId((word >> 56) as usize),
            after: ScheduleId((word >> FRAME_BITS) as usize & 0xff),
            frame: word & ((1 << FRAME_BITS) - 1),
        }
    }
}

/// A request that changes nothing.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SwitchError {
    /// There is no such schedule.
    #[error("there is no such schedule")]
    NoSuchSchedule,
    /// An earlier request has not taken effect yet.
    #[error("a switch of the schedule is under way already")]
    UnderWay,
    /// That schedule holds already (ARINC 653: NO_ACTION).
    #[error("that schedule holds already")]
    NoAction,
}

/// What an operator may know of the schedule (ARINC 653: GET_MODULE_SCHEDULE_STATUS).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// The schedule that holds now.
    pub current: ScheduleId,
    /// The one that will hold; the current one, if no switch is under way.
    pub next: ScheduleId,
    /// When the current one began to hold, since the epoch; `None` before the first switch.
    pub last_switch: Option<Nanos>,
    /// That one was stored so late that threads may already have planned by the schedule before it.
    pub late: bool,
}

/// Where requests are left and threads look which schedule holds.
#[derive(Debug)]
pub struct ScheduleState {
    frame: Nanos,
    schedules: usize,
    word: AtomicU64,
    /// The schedule asked for, plus one; 0 for none.
    wanted: AtomicUsize,
    /// Frame of the last switch that has taken effect; 0 for none. Only the requester's side
    /// uses it.
    last: AtomicU64,
    /// Frame of the last switch that was stored too late; 0 for none.
    late: AtomicU64,
}

impl ScheduleState {
    /// A board on which the first of so many schedules holds.
    #[must_use]
    pub fn new(frame: Nanos, schedules: usize) -> ScheduleState {
        let first = ScheduleId(0);
        let word = Switch { before: first, after: first, frame: 0 }.pack();
        ScheduleState {
            frame,
            schedules,
            word: AtomicU64::new(word),
            wanted: AtomicUsize::new(0),
            last: AtomicU64::new(0),
            late: AtomicU64::new(0),
        }
    }

    /// Which schedule holds when. Wait-free.
    #[must_use]
    pub fn switch(&self) -> Switch {
        Switch::unpack(self.word.load(Ordering::SeqCst))
    }

    /// Asks for a switch, at `now` since the epoch. For one requesting thread.
    ///
    /// # Errors
    /// See [`SwitchError`].
    pub fn request(&self, schedule: ScheduleId, now: Nanos) -> Result<(), SwitchError> {
        if schedule.0 >= self.schedules {
            return Err(SwitchError::NoSuchSchedule);
        }
        let switch = self.switch();
        if self.wanted.load(Ordering::SeqCst) != 0 || self.frame_at(now) < switch.frame {
            return Err(SwitchError::UnderWay);
        }
        if switch.after == schedule {
            return Err(SwitchError::NoAction);
        }
        self.last.store(switch.frame, Ordering::SeqCst);
        self.wanted.store(schedule.0 + 1, Ordering::SeqCst);
        Ok(())
    }

    /// Makes a request take effect two frames on. `clock` tells the time since the epoch; see the module. Any
    /// number of threads may call this; it is wait-free. True for the one that made it so.
    pub fn adopt(&self, clock: impl Fn() -> Nanos) -> bool {
        // In this order: a request that came before the word has changed is not taken for one that came after.
        let word = self.word.load(Ordering::SeqCst);
        let Some(wanted) = self.wanted.load(Ordering::SeqCst).checked_sub(1) else { return false };
        let (old, wanted) = (Switch::unpack(word), ScheduleId(wanted));
        let now = clock();
        // No request is for the schedule that holds already: another has adopted this one, and has yet to clear it.
        if old.after == wanted || self.frame_at(now) < old.frame {
            return false;
        }
        let frame = self.frame_at(now.plus(LEAD)) + 2;
        let new = Switch { before: old.after, after: wanted, frame };
        // A thread that loses finds the switch of another, which had the same reason.
        let won = self
            .word
            .compare_exchange(word, new.pack(), Ordering::SeqCst, Ordering::SeqCst)
            .is_ok();
        if won {
            if self.frame_at(clock().plus(GUARD_MAX)) + 2 > frame {
                self.late.store(frame, Ordering::SeqCst);
            }
            self.wanted.store(0, Ordering::SeqCst);
        }
        won
    }

    /// Where the switch stands at `now` since the epoch.
    #[must_use]
    pub fn status(&self, now: Nanos) -> Status {
        let switch = self.switch();
        let wanted = self.wanted.load(Ordering::SeqCst).checked_sub(1).map(ScheduleId);
        let over = switch.frame <= self.frame_at(now);
        let last = if over { switch.frame } else { self.last.load(Ordering::SeqCst) };
        Status {
            current: if over { switch.after } else { switch.before },
            next: wanted.unwrap_or(switch.after),
            last_switch: (last > 0).then(|| Nanos(last * self.frame.0)),
            late: last > 0 && last == self.late.load(Ordering::SeqCst),
        }
    }

    fn frame_at(&self, now: Nanos) -> u64 {
        now.0 / self.frame.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    const FRAME: Nanos = Nanos::from_millis(10);

    fn ms(n: u64) -> Nanos {
        Nanos::from_millis(n)
    }

    fn id(n: usize) -> ScheduleId {
        ScheduleId(n)
    }

    #[test]
    fn a_request_takes_effect_at_the_end_of_the_next_frame() {
        let board = ScheduleState::new(FRAME, 2);
        board.request(id(1), ms(33)).unwrap();
        assert_eq!(board.switch().schedule_of(1 << 40), id(0), "it has not been adopted");
        board.adopt(|| ms(34));
        let switch = board.switch();
        assert_eq!((switch.schedule_of(4), switch.schedule_of(5)), (id(0), id(1)));
        board.adopt(|| ms(39));
        assert_eq!(board.switch(), switch, "once is enough");
    }

    #[test]
    fn near_a_frames_end_the_guard_before_the_next_one_has_begun() {
        let board = ScheduleState::new(FRAME, 2);
        board.request(id(1), ms(37)).unwrap();
        board.adopt(|| ms(38));
        assert_eq!(board.switch().frame, 6);
    }

    #[test]
    fn a_switch_that_was_stored_too_late_is_told() {
        // From 39 ms on a thread with the longest guard may plan the frame at 50 ms, where the switch is.
        for (stored, late) in [(Nanos(38_999_999), false), (ms(39), true), (ms(57), true)] {
            let board = ScheduleState::new(FRAME, 2);
            board.request(id(1), ms(33)).unwrap();
            let times = RefCell::new([ms(34), stored].into_iter());
            assert!(board.adopt(|| times.borrow_mut().next().unwrap()));
            assert_eq!((board.switch().frame, board.status(ms(50)).late), (5, late), "{stored}");
            assert!(!board.status(ms(49)).late, "it has not taken effect");
            board.request(id(0), ms(60)).unwrap();
            board.adopt(|| ms(61));
            assert!(!board.status(ms(80)).late, "the next one was in time");
        }
    }

    #[test]
    fn no_second_request_while_one_is_under_way() {
        let board = ScheduleState::new(FRAME, 3);
        board.request(id(1), ms(0)).unwrap();
        assert_eq!(board.request(id(2), ms(0)), Err(SwitchError::UnderWay));
        board.adopt(|| ms(1));
        assert_eq!(board.request(id(2), ms(19)), Err(SwitchError::UnderWay));
        assert_eq!(board.request(id(1), ms(20)), Err(SwitchError::NoAction));
        board.request(id(2), ms(20)).unwrap();
        board.adopt(|| ms(21));
        let switch = Switch { before: id(1), after: id(2), frame: 4 };
        assert_eq!(board.switch(), switch);
    }

    /// The thread that has adopted it was stopped before it has cleared the request, for longer than the switch took.
    #[test]
    fn no_request_is_adopted_twice() {
        let board = ScheduleState::new(FRAME, 2);
        board.request(id(1), ms(33)).unwrap();
        assert!(board.adopt(|| ms(34)));
        let switch = board.switch();
        board.wanted.store(2, Ordering::SeqCst);
        assert!(!board.adopt(|| ms(1_000)));
        assert_eq!(board.switch(), switch);
        board.wanted.store(0, Ordering::SeqCst);
        board.request(id(0), ms(1_000)).unwrap();
        assert!(board.adopt(|| ms(1_000)), "the next one is not lost");
    }

    #[test]
    fn only_schedules_that_exist() {
        let board = ScheduleState::new(FRAME, 2);
        assert_eq!(board.request(id(2), ms(0)), Err(SwitchError::NoSuchSchedule));
        assert_eq!(board.request(id(0), ms(0)), Err(SwitchError::NoAction));
    }

    #[test]
    fn status_tells_current_next_and_last() {
        let board = ScheduleState::new(FRAME, 2);
        let status = |now| {
            let s = board.status(ms(now));
            (s.current.0, s.next.0, s.last_switch)
        };
        assert_eq!(status(5), (0, 0, None));
        board.request(id(1), ms(5)).unwrap();
        assert_eq!(status(5), (0, 1, None));
        board.adopt(|| ms(6));
        assert_eq!(status(19), (0, 1, None));
        assert_eq!(status(20), (1, 1, Some(ms(20))));
        board.request(id(0), ms(55)).unwrap();
        assert_eq!(status(56), (1, 0, Some(ms(20))));
        board.adopt(|| ms(56));
        assert_eq!(status(57), (1, 0, Some(ms(20))));
        assert_eq!(status(70), (0, 0, Some(ms(70))));
    }

    #[test]
    fn a_switch_survives_its_word() {
        let switch = Switch { before: id(15), after: id(7), frame: (1 << FRAME_BITS) - 1 };
        assert_eq!(Switch::unpack(switch.pack()), switch);
    }
}
