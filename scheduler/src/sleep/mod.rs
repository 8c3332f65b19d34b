//! Sleeping until an instant on the TSC, by a kernel that sleeps on another clock.
//!
//! The schedule lies on the TSC. The kernel sleeps on CLOCK_MONOTONIC, which NTP steers: by 500 ppm as a
//! rule, by 8.3 % while chrony corrects a large error (its `maxslewrate`), by 10 % if somebody sets the
//! length of a tick (`ADJ_TICK` of adjtimex(2)). The rate may change in the middle of a sleep. A sleep by
//! a clock that is fast ends early, and one by a clock that is slow ends late.
//!
//! * **Never early.** A sleep is over when the TSC says so, not when the kernel does.
//! * **Hardly late.** A sleep is divided. Each piece but the last leaves a ninth of what remains, so that no
//!   clock that is slower by 10 % makes it longer than the whole. The last piece is short ([`SHORT`] at
//!   most), so the error of its end is small, however the rate changes.
//! * **Few wake-ups.** Under a clock that was not found steered a sleep of up to a millisecond is two
//!   pieces, and one of 10 ms is four. A clock that is found to be off by more than NTP's 500 ppm is
//!   distrusted for the next [`DISTRUST`] sleeps, and last pieces are shorter then ([`SHORTER`]).
//! * **Not in the way.** A wake-up between two pieces is an interrupt and some microseconds of processor.
//!   With a [`Rest`] it comes outside of the windows of the CPU, which may make the last piece longer. So does
//!   the interrupt by which the kernel takes the thread's bandwidth back, if the sleep is a short one. Where
//!   a window leaves no room, wake-ups come before it and behind it, and the window enforcer looks at the clock
//!   meanwhile ([`crate::close`]). A sleep by a clock that is not trusted is rather divided within another's window.
//!
//! What has room for some microseconds may be [lazy](Sleeper::lazy): its sleeps of up to [`LAZY`] are one
//! piece while the clock is trusted, and it is told by others when the clock is found steered
//! ([`Rest::on_steered`]). Then it measures the clock's rate, and sleeps the rest by that rate. Under a clock that
//! is not trusted it wakes once in the last [`LAZY`] of a sleep, be it by such a message or between two pieces, and
//! not more often: its budget is that of one end of a window
//! ([`KICKER_RUNTIME`](crate::reservation::KICKER_RUNTIME)), and who has used that up is late by whole periods.
//! Before an instant that must not be late it looks under a clock that is trusted, too ([`Sleeper::until_end`]).
//!
//! Where the clock cannot be steered ([`Steering::Impossible`]) none of that is needed: its rate differs from the
//! counter's by what the two were measured wrong, a millionth. A sleep of up to [`WHOLE`] is one piece then, and
//! if the clock is found steered all the same, sleeps are divided as on any other host.
//!
//! To convert by the measured rate always would save wake-ups under a steered clock, and would be no
//! guard at all against a rate that changes during the sleep.

mod pieces;

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::moment::{Moment, STEERING_PART};
use crate::rest::Rest;
use crate::time::{Nanos, Ticks, Tsc, TscFrequency};

/// The longest last piece under a trusted clock. A clock that is slower by 10 % makes it 12.5 us longer;
/// the usual guard of 20 us has room for that and for a wake-up. It is also what a sleep of a millisecond
/// leaves after its first piece.
pub const SHORT: Nanos = Nanos::from_micros(112);

/// The same under a clock that is not trusted, but for the lazy: 7.2 us longer at worst.
pub const SHORTER: Nanos = Nanos::from_micros(64);

/// The longest last piece that is reached by a wake-up before a window of another, and the longest that no second
/// wake-up follows: a ninth of it is less than `KICK_TIME` less the end of a quiet time.
pub const CLOSE: Nanos = SHORT.plus(SHORT);

/// The longest last piece of a lazy sleeper before an instant that must not be late: 20 us longer at worst, for
/// which there is room behind each window ([`KICK_TIME`](crate::table::KICK_TIME)).
pub const SURE: Nanos = Nanos::from_micros(180);

/// The longest sleep of a lazy sleeper that is not divided while the clock is trusted. NTP's 500 ppm make it
/// 1 us longer.
pub const LAZY: Nanos = Nanos::from_millis(2);

/// The longest sleep that is not divided where the clock cannot be steered: 0.1 us of error at a millionth.
pub const WHOLE: Nanos = Nanos::from_millis(100);

/// Whether the rate of the clock by which the kernel sleeps may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Steering {
    /// Some process may change it at any time.
    Possible,
    /// No process has the privilege, and none can get it.
    Impossible,
}

/// For so many sleeps a clock that was found steered is not trusted: a daemon that has changed its rate changes
/// it back.
pub const DISTRUST: u32 = 10_000;

/// A piece that is shorter than this is not worth its wake-up.
pub(crate) const PIECE_MIN: Nanos = Nanos::from_micros(20);

/// What remains is waited for without a sleep if it is shorter than this: a sleep takes longer.
const SPIN: Nanos = Nanos::from_micros(2);

/// Longer than a wake-up of the window enforcer takes: 7 us in the lab, and 4 us to measure the clock's rate.
const OFF_A_RELEASE: Nanos = Nanos::from_micros(15);

/// How long the lazy measure the clock's rate when they are told that it is steered: readings that are 20 ns off make
/// an error of 0.5 %. The kicker's budget has room for it ([`KICKER_PIECE`](crate::reservation::KICKER_PIECE)).
const MEASURED: Nanos = Nanos::from_micros(4);

/// How a sleep ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Woken {
    /// The instant has come, or had already passed.
    OnTime,
    /// A signal arrived first.
    BySignal,
}

/// How the wake-ups of a thread went; written by that thread, read by any.
#[derive(Debug, Default)]
pub struct WakeUps {
    early: AtomicU64,
    divided: AtomicU64,
    steered: AtomicU64,
    distrusting: AtomicBool,
}

impl WakeUps {
    /// Wake-ups that the kernel made before their instant, each of which was slept through again.
    #[must_use]
    pub fn early(&self) -> u64 {
        self.early.load(Ordering::Relaxed)
    }

    /// Wake-ups between the pieces of divided sleeps.
    #[must_use]
    pub fn divided(&self) -> u64 {
        self.divided.load(Ordering::Relaxed)
    }

    /// Sleeps and pieces before which the clock was found to be off its rate by more than NTP's 500 ppm.
    #[must_use]
    pub fn steered(&self) -> u64 {
        self.steered.load(Ordering::Relaxed)
    }

    /// Whether the thread knows already that the clock cannot be trusted.
    #[must_use]
    pub fn distrusting(&self) -> bool {
        self.distrusting.load(Ordering::Relaxed)
    }
}

/// One writer, so that no locked instruction is needed.
fn count(counter: &AtomicU64) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// What a sleep needs of the machine.
trait Machine {
    fn tsc(&mut self) -> Tsc;
    fn moment(&mut self) -> Moment;
    /// Sleeps until the clock says so, at the earliest.
    fn sleep(&mut self, until: Nanos) -> Woken;
}

/// The machine that this process runs on.
struct Kernel(TscFrequency);

impl Machine for Kernel {
    fn tsc(&mut self) -> Tsc {
        Tsc::now()
    }

    fn moment(&mut self) -> Moment {
        Moment::now(self.0)
    }

    fn sleep(&mut self, Nanos(until): Nanos) -> Woken {
        let at = libc::timespec {
            tv_sec: (until / 1_000_000_000) as libc::time_t,
            tv_nsec: (until % 1_000_000_000) as libc::c_long,
        };
        // SAFETY: `at` is a live, normalised timespec; no remainder is asked for.
        let result = unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const at,
                std::ptr::null_mut(),
            )
        };
        if result == libc::EINTR { Woken::BySignal } else { Woken::OnTime }
    }
}

/// A thread's sleeps.
#[derive(Debug)]
pub struct Sleeper {
    frequency: TscFrequency,
    /// Where wake-ups between pieces are wanted.
    rest: Option<Rest>,
    lazy: bool,
    /// The release of the window at whose end this sleep ends.
    release: Option<Tsc>,
    /// Whether that end must be in time, and the clock is trusted.
    surely: bool,
    steering: Steering,
    /// The moment at which the last sleep or piece began.
    last: Option<Moment>,
    /// Sleeps for which the clock is not trusted.
    distrust: u32,
    /// The end of the last sleep that had a piece within its last [`LAZY`].
    woken_for: Option<Tsc>,
}

impl Sleeper {
    /// Of a thread that has not slept yet. It trusts a clock that may be steered from its second sleep on.
    #[must_use]
    pub fn new(frequency: TscFrequency) -> Sleeper {
        let steering = Steering::Possible;
        Sleeper {
            frequency,
            rest: None,
            lazy: false,
            release: None,
            surely: false,
            steering,
            last: None,
            distrust: 1,
            woken_for: None,
        }
    }

    /// One whose wake-ups between pieces come where `rest` wants them.
    #[must_use]
    pub fn resting(self, rest: Rest) -> Sleeper {
        Sleeper { rest: Some(rest), ..self }
    }

    /// One whose sleeps of up to [`LAZY`] are one piece while the clock is trusted.
    #[must_use]
    pub fn lazy(self) -> Sleeper {
        Sleeper { lazy: true, ..self }
    }

    /// One by a clock of which that is known. One that cannot be steered is trusted from the first sleep on.
    #[must_use]
    pub fn by_a_clock_whose_steering_is(self, steering: Steering) -> Sleeper {
        Sleeper { steering, distrust: u32::from(steering == Steering::Possible), ..self }
    }

    /// Sleeps until the TSC reaches `instant`, never shorter, or until a signal comes.
    pub fn until(&mut self, instant: Tsc, wake_ups: &WakeUps) -> Woken {
        self.sleep(&mut Kernel(self.frequency), instant, wake_ups)
    }

    /// The same of one who is lazy, until the end of a window with this release, at which it does not wake between two
    /// pieces. If it must be `in_time`, not even the first step of the clock's rate makes it late by more than a ninth of
    /// [`SURE`].
    pub fn until_end(
        &mut self,
        release: Tsc,
        end: Tsc,
        in_time: bool,
        wake_ups: &WakeUps,
    ) -> Woken {
        self.sleep_to_end(&mut Kernel(self.frequency), (release, end), in_time, wake_ups)
    }

    fn sleep_to_end(
        &mut self,
        machine: &mut impl Machine,
        (release, end): (Tsc, Tsc),
        in_time: bool,
        wake_ups: &WakeUps,
    ) -> Woken {
        self.release = Some(release);
        self.surely = in_time && self.steering == Steering::Possible;
        let woken = self.sleep(machine, end, wake_ups);
        (self.release, self.surely) = (None, false);
        woken
    }

    fn sleep(&mut self, machine: &mut impl Machine, instant: Tsc, wake_ups: &WakeUps) -> Woken {
        let mut moment = machine.moment();
        let mut told = self.lazy && self.woken_for == Some(instant);
        if told || self.distrust > 1 {
            self.surely = false;
        }
        self.distrust = self.distrust.saturating_sub(u32::from(self.last.is_some()));
        loop {
            self.judge(moment, wake_ups);
            // It has found out by itself.
            if self.surely && self.distrust == DISTRUST {
                (told, self.surely) = (true, false);
            }
            let remaining = self.nanos_to(instant, moment.tsc);
            if remaining <= SPIN {
                while machine.tsc() < instant {
                    std::hint::spin_loop();
                }
                return Woken::OnTime;
            }
            let piece = self.piece(moment.tsc, instant, remaining);
            let until = match piece {
                None if told && remaining > SHORT => self.at_rate_of_now(machine, instant),
                _ => moment.clock.plus(piece.unwrap_or(remaining)),
            };
            let woken = machine.sleep(until);
            if remaining <= LAZY {
                self.woken_for = Some(instant);
            }
            if woken == Woken::BySignal {
                // Who is told believes it, and is not told again.
                if self.lazy {
                    self.distrust = DISTRUST;
                    wake_ups.distrusting.store(true, Ordering::Relaxed);
                }
                return Woken::BySignal;
            }
            if machine.tsc() >= instant {
                return Woken::OnTime;
            }
            count(if piece.is_none() { &wake_ups.early } else { &wake_ups.divided });
            moment = machine.moment();
        }
    }

    /// What the clock says at `instant` if it goes on as in the next moments. A rate that no steering explains is a reading
    /// that something has interrupted: then what it says somewhat earlier, so that the rate is measured again.
    fn at_rate_of_now(&self, machine: &mut impl Machine, instant: Tsc) -> Nanos {
        // The first reading after a sleep takes longer, with cold caches. This is the second.
        let first = machine.moment();
        loop {
            let now = machine.moment();
            let (ahead, passed) = now.ahead_since(first, self.frequency);
            // A counter that has gone back is not waited for.
            if passed < MEASURED && now.tsc > first.tsc {
                continue;
            }
            if ahead.unsigned_abs() <= passed.0 / STEERING_PART {
                return now.clock_at_rate((ahead, passed), instant, self.frequency);
            }
            let remaining = self.nanos_to(instant, now.tsc);
            return now.clock.plus(remaining.less(Nanos(remaining.0.div_ceil(9))));
        }
    }

    /// Looks whether the clock has kept its rate since the last look.
    fn judge(&mut self, now: Moment, wake_ups: &WakeUps) {
        let before = self.last.replace(now);
        let steered = before.is_some_and(|before| !now.agrees_with(before, self.frequency));
        if steered {
            self.distrust = DISTRUST;
        }
        // Before others are told: they may look whether this one knows.
        wake_ups.distrusting.store(self.distrust > 0, Ordering::Relaxed);
        if steered {
            count(&wake_ups.steered);
            self.rest.iter().for_each(Rest::tell_steered);
        }
    }

    fn nanos_to(&self, instant: Tsc, now: Tsc) -> Nanos {
        let Ticks(ticks) = instant.since(now);
        if ticks == 0 { Nanos::ZERO } else { self.frequency.nanos(Ticks(ticks)) }
    }
}

#[cfg(test)]
mod tests;
