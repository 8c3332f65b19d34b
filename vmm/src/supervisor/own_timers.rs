//! Takt's own timers, set to where they interrupt no window.
//!
//! The supervisor is an ordinary thread, but the timer that wakes it is an interrupt of the CPU
//! that it runs on. So each instant is moved to a gap between the windows of that CPU, if there is one soon: the
//! host's watchdog, the silence of guests and the end of the run wait for no long window. A timer is on
//! CLOCK_MONOTONIC and the windows are on the TSC: therefore none is asked for longer than two ticks of the
//! supervisor's ahead, from a fresh look at both clocks, and at the rate that the clock has had in the last tick.
//! Only a rate that changes in that time leads one astray: by 20 us where it changes by 500 ppm.

use std::io;
use std::os::fd::AsRawFd;

use takt_scheduler::moment::Moment;
use takt_scheduler::quiet::QuietTimes;
use takt_scheduler::switch::Switch;
use takt_scheduler::time::{Nanos, Timebase, Tsc};
use vmm_sys_util::timerfd::TimerFd;

/// How often the rings are emptied. At the shortest major frame a ring of window records fills
/// in a hundred times this.
const TICK: Nanos = Nanos::from_millis(20);
/// How far from any window a timer is set, where there is room.
const ROOM: Nanos = Nanos::from_micros(50);
/// How much later than asked for a timer may be set. A window that is longer than this is interrupted.
const LATEST: Nanos = TICK.plus(TICK);

/// Longest time until a timer goes off. What is asked for lies two ticks ahead at most, and two more where it is moved: only a
/// counter that has gone back makes it look longer.
const AHEAD_MAX: Nanos = LATEST.plus(LATEST).plus(TICK);

/// When the supervisor is to be woken by itself; all times since the epoch.
pub(super) struct OwnTimers {
    /// The windows of the CPU that the supervisor runs on, if it has any.
    quiet: Option<QuietTimes>,
    base: Timebase,
    /// When the last tick was due.
    due: Nanos,
    /// When the run is to end.
    end: Option<Nanos>,
    /// When the timers were last set; before that, an earlier moment.
    set: Option<Moment>,
    /// How far the clock had then gone ahead of the counter since the time before, and in how long.
    gone: (i64, Nanos),
}

impl OwnTimers {
    /// From now on, and until `end`. The clock has had its rate since `earlier`; without that it is taken to run with the
    /// counter until the first tick.
    pub(super) fn new(
        quiet: Option<QuietTimes>,
        base: Timebase,
        now: Nanos,
        end: Option<Nanos>,
        earlier: Option<Moment>,
    ) -> Self {
        Self { quiet, base, due: now, end, set: earlier, gone: (0, TICK) }
    }

    /// The run is to end at another time.
    pub(super) fn end_at(&mut self, end: Nanos) {
        self.end = Some(end);
    }

    /// Sets the timer for the next tick, and [that for the end](Self::arm_end).
    ///
    /// # Errors
    /// What the kernel says of a timer.
    pub(super) fn arm(
        &mut self,
        tick: &TimerFd,
        deadline: &TimerFd,
        switch: Switch,
    ) -> io::Result<()> {
        let now = Moment::now(self.base.frequency);
        if let Some(before) = self.set.replace(now) {
            self.gone = now.ahead_since(before, self.base.frequency);
        }
        self.due = next(self.due, self.base.offset(now.tsc));
        self.set(tick, self.place(self.due, switch))?;
        self.arm_end(deadline, switch)
    }

    /// Sets the timer for the end of the run, if that is near.
    ///
    /// # Errors
    /// What the kernel says of a timer.
    pub(super) fn arm_end(&self, deadline: &TimerFd, switch: Switch) -> io::Result<()> {
        let near = self.base.offset(Tsc::now()).plus(TICK).plus(TICK);
        match self.end.filter(|end| *end <= near) {
            Some(end) => self.set(deadline, self.place(end, switch)),
            None => Ok(()),
        }
    }

    fn place(&self, at: Nanos, switch: Switch) -> Nanos {
        let place = self.quiet.as_ref().and_then(|quiet| quiet.roomy(at, ROOM, switch));
        place.filter(|place| place.less(at) <= LATEST).unwrap_or(at)
    }

    fn set(&self, timer: &TimerFd, at: Nanos) -> io::Result<()> {
        let at = self.base.instant(at);
        let frequency = self.base.frequency;
        // A timer for the instant 0 would be none.
        let now = Moment::now(frequency);
        let at = now.clock_at_rate(self.gone, at, frequency).min(now.clock.plus(AHEAD_MAX));
        let Nanos(ns) = at.max(Nanos(1));
        let time = libc::timespec {
            tv_sec: (ns / 1_000_000_000) as libc::time_t,
            tv_nsec: (ns % 1_000_000_000) as libc::c_long,
        };
        let never = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        let setting = libc::itimerspec { it_interval: never, it_value: time };
        // SAFETY: the descriptor is open, the kernel reads a live structure, and the old setting is not
        // asked for.
        let result = unsafe {
            libc::timerfd_settime(
                timer.as_raw_fd(),
                libc::TFD_TIMER_ABSTIME,
                &raw const setting,
                std::ptr::null_mut(),
            )
        };
        if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
    }
}

/// The tick after one that was due at `due`; those that have passed are left out.
fn next(due: Nanos, now: Nanos) -> Nanos {
    let late = now.less(due).0 / TICK.0;
    due.plus(Nanos((late + 1) * TICK.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::schedules::{ScheduleId, Schedules};
    use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Window};
    use takt_scheduler::time::TscFrequency;

    const STAY: Switch = Switch { before: ScheduleId(0), after: ScheduleId(0), frame: 0 };

    fn ms(n: u64) -> Nanos {
        Nanos::from_millis(n)
    }

    fn quiet(duration: Nanos, period: Nanos) -> Option<QuietTimes> {
        let plc = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::from_micros(20) } };
        let window = Window { partition: PartitionId(0), offset: Nanos::ZERO, duration, period };
        Schedules::new(period, &[plc], &[&[window]]).unwrap().quiet_on(Cpu(0), None)
    }

    #[test]
    fn ticks_keep_their_rate_and_leave_out_what_has_passed() {
        assert_eq!(next(ms(40), ms(41)), ms(60));
        assert_eq!(next(ms(40), ms(59)), ms(60));
        assert_eq!(next(ms(40), ms(60)), ms(80));
        assert_eq!(next(ms(40), ms(1_005)), ms(1_020));
    }

    #[test]
    fn a_counter_that_has_gone_back_stops_no_tick() {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let hour = ms(3_600_000);
        let base = Timebase { epoch: Tsc::now().after(frequency.ticks(hour)), frequency };
        let mut timers = OwnTimers::new(None, base, hour, None, None);
        let [tick, end] = [(); 2].map(|()| TimerFd::new().unwrap());
        timers.arm(&tick, &end, STAY).unwrap();
        let zero = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        let mut left = libc::itimerspec { it_interval: zero, it_value: zero };
        // SAFETY: the kernel writes the live structure.
        let result = unsafe { libc::timerfd_gettime(tick.as_raw_fd(), &raw mut left) };
        let left = left.it_value;
        assert!(result == 0 && left.tv_sec == 0, "{} s", left.tv_sec);
        assert!(left.tv_nsec as u64 <= AHEAD_MAX.0, "{} ns", left.tv_nsec);
    }

    #[test]
    fn the_first_timer_goes_by_the_rate_that_the_clock_had_before() {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let now = Moment::now(frequency);
        let base = Timebase { epoch: now.tsc, frequency };
        let earlier =
            Moment { tsc: Tsc(now.tsc.0 - 10_000_000_000), clock: now.clock.less(ms(11_000)) };
        let mut timers = OwnTimers::new(None, base, Nanos::ZERO, None, Some(earlier));
        let [tick, end] = [(); 2].map(|()| TimerFd::new().unwrap());
        timers.arm(&tick, &end, STAY).unwrap();
        let (ahead, passed) = timers.gone;
        // A second in ten; what passes meanwhile counts too, by a counter that is faster than that.
        assert!((500_000_000..1_500_000_000).contains(&ahead), "{ahead} ns in {passed}");
    }

    #[test]
    fn no_timer_is_set_into_a_window() {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let base = Timebase { epoch: Tsc::now(), frequency };
        let quiet = quiet(Nanos::from_micros(300), ms(1));
        let timers = OwnTimers::new(quiet, base, Nanos::ZERO, None, None);
        assert_eq!(timers.place(ms(20), STAY), Nanos(20_355_000));
        let beside = OwnTimers::new(None, base, Nanos::ZERO, None, None);
        assert_eq!(beside.place(ms(20), STAY), ms(20));
    }

    #[test]
    fn a_long_window_holds_up_no_tick() {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let base = Timebase { epoch: Tsc::now(), frequency };
        let timers = OwnTimers::new(quiet(ms(3_000), ms(4_000)), base, Nanos::ZERO, None, None);
        let mut last = Nanos::ZERO;
        let mut due = Nanos::ZERO;
        while last < ms(12_000) {
            due = next(due, last);
            let tick = timers.place(due, STAY);
            assert!(tick >= due && tick <= due.plus(ms(40)), "{due}: {tick}");
            assert!(tick.less(last) <= ms(60), "{last}: {tick}");
            last = tick;
        }
        assert_eq!(timers.place(ms(2_900), STAY), ms(2_900));
        assert_eq!(timers.place(ms(2_980), STAY), Nanos(3_000_055_000), "its end is near");
    }

    #[test]
    fn the_timer_for_the_end_is_set_when_it_is_near() {
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let base = Timebase { epoch: Tsc::now(), frequency };
        let (tick, deadline) = (TimerFd::new().unwrap(), TimerFd::new().unwrap());
        let is_armed = |timer: &TimerFd| timer.is_armed().unwrap();
        let mut timers = OwnTimers::new(None, base, Nanos::ZERO, Some(ms(3_600_000)), None);
        timers.arm(&tick, &deadline, STAY).unwrap();
        assert_eq!((is_armed(&tick), is_armed(&deadline)), (true, false));
        timers.end = Some(Nanos::ZERO);
        let mut deadline = deadline;
        timers.arm(&tick, &deadline, STAY).unwrap();
        assert_eq!(deadline.wait().unwrap(), 1);
    }
}
