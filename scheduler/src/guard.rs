//! A release guard that follows what its host does.
//!
//! A guard that is longer than it has to be is taken from the background in each window: of 20 us a host
//! whose wake-ups take 5 us wastes half. One that is too short makes releases late. How long it has to be is
//! known only from the host itself, so with `release_guard = "auto"` each wake-up is measured, and the guard
//! follows the latest of them.
//!
//! What is measured is the *arrival*: from the instant at which the thread was to wake up to its last look at
//! the clock before it enters the guest. What comes after that cannot be seen from outside of the guest, and
//! has an allowance ([`ENTRY`]).
//!
//! * **Wide at first.** The guard begins with its upper bound. All that is decided before the run (the room
//!   before windows, reservations, quiet times, what is promised to the background) goes by that bound.
//! * **Widened at once.** An arrival for which the guard has less than its margin widens it for the very next
//!   release. One that made the release late, or could have, sets it back to the bound.
//! * **Narrowed slowly.** Only after [`SLOT`] arrivals with their margin, and then by half of what can be
//!   spared. What can be spared goes by the latest arrival of the last [`SLOTS`] such times.
//! * **A mistake is remembered.** Each time that the guard was too short below its bound, the time after
//!   which an arrival is forgotten doubles. A disturbance that comes again and again makes the fewer releases
//!   late the longer the run goes on: the number grows with the logarithm of the time.
//!
//! It is arithmetic over arrivals, without a clock: the same arrivals always make the same guard. What the
//! margin cannot do is foresee: an arrival that is later than all before it by more than the margin makes a
//! release late, which is counted and told like any other.

use std::fmt;

use crate::time::Nanos;

/// The upper bound where the gaps of the file leave room for more: twice the usual guard.
pub const AUTO_MOST: Nanos = Nanos::from_micros(40);
/// The guard never becomes shorter. A host with earlier arrivals gains little by less.
pub const AUTO_LEAST: Nanos = Nanos::from_micros(8);
/// From the last look at the clock until the guest's first instruction: 1.8 us in the lab, and about 1 us on
/// processors.
pub const ENTRY: Nanos = Nanos::from_micros(3);
/// Arrivals after which the guard may become shorter for the first time.
pub const SLOT: u32 = 1024;
/// Spans of that length, and of what it has grown to, of which the latest arrivals are remembered.
pub const SLOTS: usize = 8;
/// Most doublings of the memory: then it lasts for 8 million arrivals, over two hours of releases each 1 ms.
const DOUBLINGS_MAX: u32 = 10;
/// Guards are whole multiples of this, so that not each new nanosecond is a change.
const STEP: u64 = 250;

/// Why a guard has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// All arrivals of a while have left room.
    Narrowed,
    /// An arrival left less than the margin. Its release was in time.
    Widened,
    /// An arrival made its release late, or could have.
    TooShort,
}

/// A change of a guard, which holds from the next release on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuardChange {
    /// Its length before.
    pub from: Nanos,
    /// Its length from now on.
    pub to: Nanos,
    /// Why.
    pub why: Why,
    /// The latest arrival that is remembered.
    pub latest: Nanos,
}

impl fmt::Display for GuardChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let GuardChange { from, to, why, latest } = self;
        match why {
            Why::Narrowed => write!(f, "release guard {to} instead of {from}")?,
            Why::Widened => write!(f, "release guard widened from {from} to {to}")?,
            Why::TooShort => write!(f, "release guard too short, widened from {from} to {to}")?,
        }
        write!(f, ": the latest arrival is {} us after its instant", latest.0 as f64 / 1e3)
    }
}

/// A release guard: as the file has it, or one that follows the host.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ReleaseGuard {
    /// Always this long.
    Fixed(Nanos),
    /// As long as the host needs.
    Auto(AutoGuard),
}

impl ReleaseGuard {
    /// Its length for the next release.
    #[must_use]
    pub fn length(&self) -> Nanos {
        match self {
            ReleaseGuard::Fixed(length) => *length,
            ReleaseGuard::Auto(guard) => guard.length,
        }
    }

    /// A thread has arrived this long after it was to wake up; returns what that changes.
    pub fn arrived(&mut self, arrival: Nanos) -> Option<GuardChange> {
        match self {
            ReleaseGuard::Fixed(_) => None,
            ReleaseGuard::Auto(guard) => guard.arrived(arrival),
        }
    }
}

/// A guard that follows the arrivals of its thread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AutoGuard {
    least: Nanos,
    most: Nanos,
    length: Nanos,
    /// The latest arrival of each span, the running one first.
    latest: [Nanos; SLOTS],
    /// Arrivals of the running span.
    seen: u32,
    doublings: u32,
}

impl AutoGuard {
    /// One that is never longer than `most`, and never shorter than [`AUTO_LEAST`] or `most` itself.
    #[must_use]
    pub fn new(most: Nanos) -> AutoGuard {
        let least = AUTO_LEAST.min(most);
        let latest = [Nanos::ZERO; SLOTS];
        AutoGuard { least, most, length: most, latest, seen: 0, doublings: 0 }
    }

    /// See [`ReleaseGuard::arrived`].
    pub fn arrived(&mut self, arrival: Nanos) -> Option<GuardChange> {
        self.latest[0] = self.latest[0].max(arrival);
        self.seen = self.seen.saturating_add(1);
        let from = self.length;
        let (to, why) = if arrival.plus(ENTRY) > from {
            if from < self.most {
                self.doublings = (self.doublings + 1).min(DOUBLINGS_MAX);
            }
            (self.most, Why::TooShort)
        } else if self.wanted(arrival) > from {
            (self.wanted(arrival), Why::Widened)
        } else if self.seen >= SLOT << self.doublings {
            let wanted = self.wanted(self.remembered());
            self.latest.rotate_right(1);
            self.latest[0] = Nanos::ZERO;
            self.seen = 0;
            (halfway(from, wanted), Why::Narrowed)
        } else {
            return None;
        };
        self.length = to;
        let latest = self.remembered();
        (to != from).then_some(GuardChange { from, to, why, latest })
    }

    /// The latest arrival that is remembered.
    fn remembered(&self) -> Nanos {
        self.latest.into_iter().max().unwrap_or(self.most)
    }

    /// The guard for an arrival: a quarter more, and the way into the guest.
    fn wanted(&self, arrival: Nanos) -> Nanos {
        let with_margin = arrival.plus(Nanos(arrival.0 / 4)).plus(ENTRY);
        on_step(with_margin).max(self.least).min(self.most)
    }
}

/// Half of the way from a guard to a shorter one, or all of it where a half is less than a step.
fn halfway(from: Nanos, wanted: Nanos) -> Nanos {
    let spare = from.less(wanted).0;
    if spare <= STEP { from.min(wanted) } else { on_step(wanted.plus(Nanos(spare / 2))) }
}

/// Rounded up.
fn on_step(Nanos(time): Nanos) -> Nanos {
    Nanos(time.div_ceil(STEP).saturating_mul(STEP))
}

#[cfg(test)]
#[path = "guard_tests.rs"]
mod tests;
