//! Sleeping until an instant on the TSC, by a kernel that sleeps on another clock.
//!
//! The schedule lies on the TSC. The kernel sleeps on CLOCK_MONOTONIC, which NTP steers: by 500 ppm as a
//! rule, by 8.3 % while chrony corrects a large error (its `maxslewrate`), by 10 % if somebody sets the
//! length of a tick (`ADJ_TICK` of adjtimex(2)). The rate may change in the middle of a sleep. A sleep by
//! a clock that is fast ends early, and one by a clock that is slow ends late.
//!
//! * **Never early.** A sleep is over when the TSC says so, not when the kernel does.
//! * **Hardly late.** Of a sleep that is divided, each piece but the last is 7/8 of what remains, which
//!   no clock that is slower by 10 % makes longer than the whole. The last piece is short ([`LAST`]), so
//!   the error of its end is small, however the rate changes.
//! * **Few wake-ups.** A sleep of up to [`UNDIVIDED`] under a clock that was not found steered is one call
//!   of the kernel, as it is in each cycle of a millisecond. A clock that is found to be off by more than
//!   NTP's 500 ppm is distrusted for the next [`DISTRUST`] sleeps. So the one thing that can make a
//!   wake-up late by more than the last piece can is the first step of the rate beyond that, in a
//!   sleep that is not divided, once: by a ninth of what was left of it.
//!
//! A divided sleep of a second takes six pieces, one of a millisecond three.
//!
//! To convert by the measured rate instead would save wake-ups under a steered clock, and would be no
//! guard at all against a rate that changes during the sleep.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::time::{Nanos, Ticks, Tsc, TscFrequency};

/// A piece of a sleep that is not divided further. A clock that is slower by 10 % makes it 7.2 us
/// longer, which is well within the usual guard of 20 us.
pub const LAST: Nanos = Nanos::from_micros(64);

/// The longest sleep that is not divided while the clock is trusted. NTP's 500 ppm make it 1 us longer.
pub const UNDIVIDED: Nanos = Nanos::from_millis(2);

/// For so many sleeps a clock that was found steered is not trusted: whoever has changed its rate changes it
/// back.
pub const DISTRUST: u32 = 10_000;

/// What remains is waited for without a sleep if it is shorter than this: a sleep takes longer.
const SPIN: Nanos = Nanos::from_micros(2);

/// Two readings of the counter with one of the clock between them are one moment if they are no
/// further apart; otherwise something has interrupted them.
const MOMENT: Nanos = Nanos::from_micros(1);

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

    /// Sleeps before which the clock was found to be off its rate by more than NTP's 500 ppm.
    #[must_use]
    pub fn steered(&self) -> u64 {
        self.steered.load(Ordering::Relaxed)
    }
}

/// One writer, so that no locked instruction is needed.
fn count(counter: &AtomicU64) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

/// Both clocks at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Moment {
    /// The counter.
    pub tsc: Tsc,
    /// CLOCK_MONOTONIC.
    pub clock: Nanos,
}

impl Moment {
    /// Reads the counter, then the clock. An interrupt between the two would make a sleep end late by
    /// what it takes, so they are read once more if it seems that there was one.
    fn now(frequency: TscFrequency) -> Moment {
        Moment::within(MOMENT, frequency)
            .unwrap_or_else(|| Moment { tsc: Tsc::now(), clock: monotonic() })
    }

    /// Reads the counter, then the clock; `None` if that has taken longer than `time`.
    #[must_use]
    pub fn within(time: Nanos, frequency: TscFrequency) -> Option<Moment> {
        let tsc = Tsc::now();
        let clock = monotonic();
        (Tsc::now().since(tsc) <= frequency.ticks(time)).then_some(Moment { tsc, clock })
    }

    /// How many ns the clock has gone ahead of the counter since an earlier moment, and how long that is
    /// ago by the counter; nothing if the counter has gone back.
    #[must_use]
    pub fn ahead_since(self, earlier: Moment, frequency: TscFrequency) -> (i64, Nanos) {
        let passed = frequency.nanos(self.tsc.since(earlier.tsc));
        let clock = self.clock.less(earlier.clock);
        let ahead = i128::from(clock.0) - i128::from(passed.0);
        let ahead = ahead.clamp(i128::from(i64::MIN), i128::from(i64::MAX));
        (ahead as i64, passed)
    }

    /// Whether the clock has kept within twice NTP's 500 ppm of the counter since an earlier moment, and
    /// what two readings may be off.
    fn agrees_with(self, earlier: Moment, frequency: TscFrequency) -> bool {
        const READINGS: u64 = 2_000;
        let (ahead, Nanos(passed)) = self.ahead_since(earlier, frequency);
        ahead.unsigned_abs() <= (passed >> 10) + READINGS
    }
}

/// CLOCK_MONOTONIC.
fn monotonic() -> Nanos {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a live timespec that the call fills in. It cannot fail for this clock.
    unsafe { libc::clock_gettime(libc::CLOCK_MONOTONIC, &raw mut time) };
    Nanos(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64)
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
    /// The moment at which the last sleep began.
    last: Option<Moment>,
    /// Sleeps for which the clock is not trusted.
    distrust: u32,
}

impl Sleeper {
    /// Of a thread that has not slept yet. It trusts the clock from its second sleep on.
    #[must_use]
    pub fn new(frequency: TscFrequency) -> Sleeper {
        Sleeper { frequency, last: None, distrust: 1 }
    }

    /// Sleeps until the TSC reaches `instant`, never shorter, or until a signal comes.
    pub fn until(&mut self, instant: Tsc, wake_ups: &WakeUps) -> Woken {
        self.sleep(&mut Kernel(self.frequency), instant, wake_ups)
    }

    fn sleep(&mut self, machine: &mut impl Machine, instant: Tsc, wake_ups: &WakeUps) -> Woken {
        let mut moment = machine.moment();
        let trusted = self.trusts(moment, wake_ups);
        let mut divided = !trusted || self.nanos_to(instant, moment.tsc) > UNDIVIDED;
        loop {
            let remaining = self.nanos_to(instant, moment.tsc);
            if remaining <= SPIN {
                while machine.tsc() < instant {
                    std::hint::spin_loop();
                }
                return Woken::OnTime;
            }
            let last = !divided || remaining <= LAST;
            let piece = if last { remaining } else { Nanos(remaining.0 - remaining.0 / 8) };
            if machine.sleep(moment.clock.plus(piece)) == Woken::BySignal {
                return Woken::BySignal;
            }
            if machine.tsc() >= instant {
                return Woken::OnTime;
            }
            count(if last { &wake_ups.early } else { &wake_ups.divided });
            divided = true;
            moment = machine.moment();
        }
    }

    /// Whether the clock has kept its rate for long enough.
    fn trusts(&mut self, now: Moment, wake_ups: &WakeUps) -> bool {
        let last = self.last.replace(now);
        let steered = last.is_some_and(|last| !now.agrees_with(last, self.frequency));
        if steered {
            count(&wake_ups.steered);
            self.distrust = DISTRUST;
        } else {
            self.distrust = self.distrust.saturating_sub(u32::from(last.is_some()));
        }
        self.distrust == 0
    }

    fn nanos_to(&self, instant: Tsc, now: Tsc) -> Nanos {
        let Ticks(ticks) = instant.since(now);
        if ticks == 0 { Nanos::ZERO } else { self.frequency.nanos(Ticks(ticks)) }
    }
}

#[cfg(test)]
#[path = "sleep_tests.rs"]
mod tests;
