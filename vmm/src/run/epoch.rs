//! Where the epoch lies to the host's tick.
//!
//! The host's tick interrupts a busy CPU at multiples of its period on CLOCK_MONOTONIC
//! (`tick_init_jiffy_update`, kernel/time/tick-sched.c; not before Linux 6.4 and what was taken from it
//! for older ones). It cannot be moved, so the epoch is: by less than a frame, to where the tick is
//! farthest from all windows ([`tick_phase`]). Where it then goes is the clock's doing. That
//! clock runs with the TSC unless a daemon steers it, and a steered one creeps over the margin sooner or
//! later; how far it has crept, the report tells.

use takt_scheduler::moment::Moment;
use takt_scheduler::quiet::{QuietTimes, TickPhase, tick_phase};
use takt_scheduler::time::{Nanos, Timebase, TscFrequency};

use crate::report;

/// How often the host's tick comes: the coarse clock moves once in each. Asked before the sandbox is entered: the call is in no
/// thread's list, and not every kernel spares it by its vDSO.
pub(super) fn tick_of_host() -> Nanos {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: fills in a live structure. Every Linux has this clock, so that it cannot fail.
    unsafe { libc::clock_getres(libc::CLOCK_MONOTONIC_COARSE, &raw mut time) };
    Nanos(time.tv_sec.unsigned_abs() * 1_000_000_000 + time.tv_nsec.unsigned_abs())
}

/// The epoch that was chosen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Epoch {
    /// When it is, and the speed of its clock.
    pub base: Timebase,
    /// How long that is from when it was chosen.
    pub delay: Nanos,
    /// Of that: until the tick is at its place.
    pub aligning: Nanos,
    chosen: Moment,
    tick: Nanos,
    phase: Option<TickPhase>,
}

impl Epoch {
    /// Chooses one at least so far ahead, on a host with this tick.
    pub(super) fn choose(
        least: Nanos,
        tick: Nanos,
        frequency: TscFrequency,
        quiet: &[QuietTimes],
    ) -> Epoch {
        let chosen = Moment::now(frequency);
        let phase = tick_phase(quiet, tick);
        let delay = match phase {
            Some(phase) => delay(chosen.clock, least, phase),
            None => least,
        };
        let base = Timebase { epoch: chosen.tsc.after(frequency.ticks(delay)), frequency };
        Epoch { base, delay, aligning: delay.less(least), chosen, tick, phase }
    }

    /// What a report says of the tick, at the end of a run.
    pub(super) fn told(&self) -> report::Tick {
        let frequency = self.base.frequency;
        let (ahead, _) = Moment::now(frequency).ahead_since(self.chosen, frequency);
        report::Tick {
            period_ns: self.tick.0,
            clear: self.phase.map(|phase| phase.clear.into()),
            margin_ns: self.phase.map_or(0, |phase| phase.margin.0),
            crept_ns: ahead.unsigned_abs(),
        }
    }
}

/// From `now` to the first epoch, at least so far ahead, from which a tick is at its place.
fn delay(now: Nanos, least: Nanos, phase: TickPhase) -> Nanos {
    let earliest = now.plus(least);
    let past = earliest.plus(phase.offset).0 % phase.step.0;
    let wait = if past == 0 { 0 } else { phase.step.0 - past };
    least.plus(Nanos(wait))
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::quiet::Clear;

    #[test]
    fn an_epoch_is_at_most_a_step_later_and_at_its_place() {
        let step = Nanos::from_millis(1);
        let phase = |offset| TickPhase {
            offset: Nanos(offset),
            margin: Nanos(1),
            step,
            clear: Clear::Windows,
        };
        let least = Nanos::from_micros(1300);
        for now in [0, 1, 4_000_000, 123_456_789, 999_999_999_999] {
            for offset in [0, 1, 642_500, 999_999] {
                let delay = delay(Nanos(now), least, phase(offset));
                assert!(delay >= least && delay < least.plus(step), "{delay}");
                assert_eq!((now + delay.0 + offset) % step.0, 0);
            }
        }
    }

    #[test]
    fn the_tick_of_this_host_is_known() {
        let tick = tick_of_host();
        assert!((Nanos::from_micros(900)..=Nanos::from_millis(10)).contains(&tick), "{tick}");
    }
}
