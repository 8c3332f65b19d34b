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
//!   they leave no room in the last 224 us, a sleep of up to [`LAZY`] under a trusted clock is not
//!   divided, and the first step of the rate is felt once, by a ninth of what is left of the sleep. A
//!   longer sleep, or one by a clock that is not trusted, is rather divided within somebody's window.
//!
//! What has room for some microseconds may be [lazy](Sleeper::lazy): its sleeps of up to [`LAZY`] are one
//! piece while the clock is trusted, and it is told by others when the clock is found steered
//! ([`Rest::on_steered`]). Then it measures the clock's rate, and sleeps the rest by that rate. Under a clock that is not
//! trusted it wakes once in the last [`LAZY`] of a sleep, be it by such
//! a message or between two pieces, and not more often: its budget is that of one end of a window
//! ([`KICKER_RUNTIME`](crate::reservation::KICKER_RUNTIME)), and who has used that up is late by whole periods.
//!
//! Where the clock cannot be steered ([`Steering::Impossible`]) none of that is needed: its rate differs from the
//! counter's by what the two were measured wrong, a millionth. A sleep of up to [`WHOLE`] is one piece then, and
//! if the clock is found steered all the same, sleeps are divided as on any other host.
//!
//! To convert by the measured rate always would save wake-ups under a steered clock, and would be no
//! guard at all against a rate that changes during the sleep.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::moment::{Moment, STEERING_PART};
use crate::quiet::WAKE_UP;
use crate::rest::Rest;
use crate::time::{Nanos, Ticks, Tsc, TscFrequency};

/// The longest last piece under a trusted clock. A clock that is slower by 10 % makes it 12.5 us longer;
/// the usual guard of 20 us has room for that and for a wake-up. It is also what a sleep of a millisecond
/// leaves after its first piece.
pub const SHORT: Nanos = Nanos::from_micros(112);

/// The same under a clock that is not trusted, but for the lazy: 7.2 us longer at worst.
pub const SHORTER: Nanos = Nanos::from_micros(64);

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
const PIECE_MIN: Nanos = Nanos::from_micros(20);

/// What remains is waited for without a sleep if it is shorter than this: a sleep takes longer.
const SPIN: Nanos = Nanos::from_micros(2);

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

    fn sleep(&mut self, machine: &mut impl Machine, instant: Tsc, wake_ups: &WakeUps) -> Woken {
        let mut moment = machine.moment();
        let told = self.lazy && self.woken_for == Some(instant);
        self.distrust = self.distrust.saturating_sub(u32::from(self.last.is_some()));
        loop {
            self.judge(moment, wake_ups);
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

    /// How long to sleep first, if not to the end.
    fn piece(&self, now: Tsc, instant: Tsc, remaining: Nanos) -> Option<Nanos> {
        let trusted = self.distrust == 0;
        let short = if trusted || self.lazy { SHORT } else { SHORTER };
        let whole = match (trusted, self.steering) {
            (true, Steering::Impossible) => WHOLE,
            (true, Steering::Possible) if self.lazy => LAZY,
            _ if self.lazy && self.woken_for == Some(instant) => LAZY,
            _ => short,
        };
        if remaining <= whole {
            return None;
        }
        // What is left must be worth a piece of its own.
        let leave = Nanos(remaining.0.div_ceil(9)).max(Nanos(short.0 / 2));
        let wanted = remaining.less(leave);
        let Some(rest) = &self.rest else { return Some(wanted) };
        let at = now.after(self.frequency.ticks(wanted));
        // Where windows fill the time before the instant, a wake-up before them all would help little.
        let patient = trusted && remaining <= LAZY;
        let last = match (patient, self.lazy && remaining <= LAZY) {
            (true, _) => SHORT.plus(SHORT),
            (false, true) => leave.max(SHORT),
            (false, false) => remaining,
        };
        let useful = |place: Option<Tsc>| {
            let piece = self.frequency.nanos(place.filter(|place| *place > now)?.since(now));
            (piece >= PIECE_MIN && remaining.less(piece) <= last).then_some(piece)
        };
        if !patient {
            return useful(rest.before(at, WAKE_UP)).or(Some(wanted));
        }
        // Only here: a longer sleep would have more pieces by this, for which its budget has no room.
        let clear = useful(rest.before(at, rest.followed));
        // A sleep that is short enough for a last piece is not divided at the price of a second interrupt.
        clear.or_else(|| if remaining <= last { None } else { useful(rest.before(at, WAKE_UP)) })
    }

    /// Looks whether the clock has kept its rate since the last look.
    fn judge(&mut self, now: Moment, wake_ups: &WakeUps) {
        let before = self.last.replace(now);
        if before.is_some_and(|before| !now.agrees_with(before, self.frequency)) {
            count(&wake_ups.steered);
            if let (0, Some(rest)) = (self.distrust, &self.rest) {
                rest.tell_steered();
            }
            self.distrust = DISTRUST;
        }
        wake_ups.distrusting.store(self.distrust > 0, Ordering::Relaxed);
    }

    fn nanos_to(&self, instant: Tsc, now: Tsc) -> Nanos {
        let Ticks(ticks) = instant.since(now);
        if ticks == 0 { Nanos::ZERO } else { self.frequency.nanos(Ticks(ticks)) }
    }
}

#[cfg(test)]
#[path = "sleep_tests.rs"]
mod tests;
