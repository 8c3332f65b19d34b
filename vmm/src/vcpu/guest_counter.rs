//! Noticing that a guest's time-stamp counter is no longer the host's.
//!
//! A PLC finds its releases on its own counter, which is the host's ([`share_tsc`](crate::machine::share_tsc)). KVM moves it if
//! the host's counter has turned bad, with each load of the processor, and tells no one. A guest can move its own by a register. So
//! the PLC's thread asks KVM, some times a second, after a window: another thread would wait for the guest.

use kvm_ioctls::VcpuFd;
use takt_scheduler::time::{Nanos, Ticks, Timebase, Tsc};

use crate::health::ClockFault;
use crate::machine;

/// How often KVM is asked.
const INTERVAL: Nanos = Nanos::from_millis(250);

/// The guest's counter, as it was when KVM was last asked.
#[derive(Debug)]
pub struct GuestCounter {
    base: Timebase,
    next: Tsc,
    moved: bool,
}

impl GuestCounter {
    /// Of a guest that runs from the epoch on.
    #[must_use]
    pub fn new(base: Timebase) -> Self {
        Self { base, next: base.epoch, moved: false }
    }

    /// The guest was started anew, with the host's counter. If KVM has moved that by now, it is no news.
    pub fn restarted(&mut self, vcpu: &VcpuFd) {
        self.began_with(machine::tsc_offset(vcpu).unwrap_or(0));
    }

    fn began_with(&mut self, offset: i64) {
        self.moved = offset != 0;
    }

    /// Asks, if it is time. Returns what is wrong once each time that the counter is found moved after it was not.
    pub fn look(&mut self, vcpu: &VcpuFd, now: Tsc) -> Option<ClockFault> {
        if now < self.next {
            return None;
        }
        self.next = now.after(self.base.frequency.ticks(INTERVAL));
        self.judge(machine::tsc_offset(vcpu)?)
    }

    fn judge(&mut self, offset: i64) -> Option<ClockFault> {
        let was_moved = std::mem::replace(&mut self.moved, offset != 0);
        (self.moved && !was_moved).then(|| {
            let Nanos(ns) = self.base.frequency.nanos(Ticks(offset.unsigned_abs()));
            let ns = i64::try_from(ns).unwrap_or(i64::MAX);
            ClockFault::Offset { guest_ahead_ns: if offset < 0 { -ns } else { ns } }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use takt_scheduler::time::TscFrequency;

    #[test]
    fn a_counter_that_is_moved_is_told_once_each_time() {
        let frequency = TscFrequency::from_khz(2_000_000).unwrap();
        let mut counter = GuestCounter::new(Timebase { epoch: Tsc(5), frequency });
        let mut after = |offset| counter.judge(offset).map(|fault| fault.to_string());
        let moved = |ms: &str| Some(format!("the guest's TSC is {ms} ms ahead of the host's"));
        assert_eq!(after(0), None);
        assert_eq!(after(-3_000_000), moved("-1.500"));
        assert_eq!(after(i64::MIN), None);
        assert_eq!(after(0), None);
        assert_eq!(after(2_000_000), moved("1.000"));
    }

    #[test]
    fn a_guest_that_was_started_anew_can_move_its_counter_again() {
        let frequency = TscFrequency::from_khz(2_000_000).unwrap();
        let mut counter = GuestCounter::new(Timebase { epoch: Tsc(5), frequency });
        assert!(counter.judge(1_000).is_some());
        counter.began_with(0);
        assert!(counter.judge(1_000).is_some());
        // Where KVM moves it with each load, the first word of it is enough.
        counter.began_with(-7);
        assert!(counter.judge(-9).is_none());
    }
}
