//! Why a release started late, or a scan took long.
//!
//! A worst case without an explanation is of little use. The stamps of a window cut the time that
//! is to be explained into stretches, each of which has its cause:
//!
//! ```text
//!      release      woken       entered    left   entered       start
//! --------|-----------|------------|---------|-------|------------|----
//!         | late      | delay of   | guest   | VM    | guest      |
//!         | wake-up   | the host   |         | exit  |            |
//! ```
//!
//! What the guard absorbs lies before the release and needs no explanation. The time in the guest
//! is harder: a host interrupt stops the guest too, and no stamp shows it. KVM's own count of exits
//! does: if it is higher than the number of exits that came to the thread, the host's kernel took
//! the processor away at least once. That count is of the whole window, so this cause says that
//! an interrupt can have done it, not when it came. Only if there was none is it the guest's own
//! doing, but for the way into the guest ([`ENTRY`]): it takes its time in each window, and what of it is left at
//! the release belongs to the one who came late to it.
//!
//! A start has nothing to do but to happen, so all of its latency is explained. Of a scan only
//! what is beyond the usual: the least time that any scan of this partition spent in the guest.
//!
//! When a scan started and ended is the guest's claim. A lying guest spoils only its own explanations.

use std::fmt;

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use takt_scheduler::guard::ENTRY;
use takt_scheduler::time::{Nanos, Ticks, Tsc, TscFrequency};

use takt_record::{Detour, Scan, WindowRecord};

/// What took time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "cause", rename_all = "snake_case")]
pub enum Cause {
    /// The thread slept longer than the guard allows for: what was left of it is shorter than the way into the
    /// guest.
    LateWakeUp {
        /// From when it was to wake up to when it did, the guard included.
        after_due_ns: u64,
    },
    /// The thread was awake, but had not entered the guest.
    HostDelay,
    /// The guest was left and entered again.
    VmExits {
        /// How often.
        exits: u32,
    },
    /// The host's kernel answered exits by itself, as it does for its own interrupts.
    HostInterrupt {
        /// How many in the whole window.
        exits: u64,
    },
    /// The guest ran, and no other cause explains the time.
    GuestComputation,
    /// KVM does not count exits here, or not all exits are recorded.
    Unknown,
}

/// A cause without its figures; in JSON, its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CauseName {
    /// As [`Cause::LateWakeUp`].
    LateWakeUp,
    /// As [`Cause::HostDelay`].
    HostDelay,
    /// As [`Cause::VmExits`].
    VmExits,
    /// As [`Cause::HostInterrupt`].
    HostInterrupt,
    /// As [`Cause::GuestComputation`].
    GuestComputation,
    /// As [`Cause::Unknown`].
    Unknown,
}

impl Cause {
    /// Which cause it is.
    #[must_use]
    pub const fn name(&self) -> CauseName {
        match self {
            Cause::LateWakeUp { .. } => CauseName::LateWakeUp,
            Cause::HostDelay => CauseName::HostDelay,
            Cause::VmExits { .. } => CauseName::VmExits,
            Cause::HostInterrupt { .. } => CauseName::HostInterrupt,
            Cause::GuestComputation => CauseName::GuestComputation,
            Cause::Unknown => CauseName::Unknown,
        }
    }
}

/// A cause, and how much it explains.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// What took time.
    #[serde(flatten)]
    pub cause: Cause,
    /// How much, of what is to be explained.
    pub explains_ns: u64,
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = self.explains_ns as f64 / 1e3;
        let s = |count| if count == 1 { "" } else { "s" };
        match self.cause {
            Cause::LateWakeUp { after_due_ns } => {
                write!(f, "late wake-up: {:.1} us after due", after_due_ns as f64 / 1e3)
            }
            Cause::HostDelay => write!(f, "host delay: {us:.1} us from wake-up to entry"),
            Cause::VmExits { exits } => {
                write!(f, "VM exits: {us:.1} us in {exits} exit{}", s(u64::from(exits)))
            }
            Cause::HostInterrupt { exits } => {
                write!(f, "host interrupt: {us:.1} us, {exits} exit{} to its kernel", s(exits))
            }
            Cause::GuestComputation => write!(f, "guest computation: {us:.1} us"),
            Cause::Unknown => write!(f, "unknown: {us:.1} us in the guest or its exits"),
        }
    }
}

/// An explanation: its parts in the order in which they happen, each of at least a nanosecond.
/// They add up to what is explained, but for the rounding of each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Explanation([Option<Part>; 4]);

impl Explanation {
    /// These parts, of which there are at most four; those of no length are left out.
    #[must_use]
    pub fn new(parts: &[(Cause, Nanos)]) -> Self {
        let mut this = Self::default();
        for (place, (cause, time)) in this.0.iter_mut().zip(parts) {
            *place = (time.0 > 0).then_some(Part { cause: *cause, explains_ns: time.0 });
        }
        this
    }

    /// The parts; none if there was nothing to explain.
    pub fn parts(&self) -> impl Iterator<Item = &Part> {
        self.0.iter().flatten()
    }

    /// The part that explains most; of several, the one that happened first.
    #[must_use]
    pub fn main(&self) -> Option<&Part> {
        self.parts().reduce(|a, b| if b.explains_ns > a.explains_ns { b } else { a })
    }
}

impl Serialize for Explanation {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.parts())
    }
}

impl<'de> Deserialize<'de> for Explanation {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let parts: Vec<Part> = Vec::deserialize(deserializer)?;
        let mut this = Self::default();
        if parts.len() > this.0.len() {
            return Err(D::Error::custom("more parts than an explanation has"));
        }
        for (place, part) in this.0.iter_mut().zip(parts) {
            *place = Some(part);
        }
        Ok(this)
    }
}

/// The main part, then the others.
impl fmt::Display for Explanation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(main) = self.main() else { return f.write_str("nothing to explain") };
        write!(f, "{main}")?;
        self.parts().filter(|p| *p != main).try_for_each(|p| write!(f, "; {p}"))
    }
}

/// Explains the time from the release to the guest's start; `None` if the guest does not claim a
/// credible one.
#[must_use]
pub fn of_start(
    record: &WindowRecord,
    detours: &[Detour],
    frequency: TscFrequency,
) -> Option<Explanation> {
    let Scan { start, .. } = record.scan()?;
    // Each stretch begins where the one before ends, whatever the stamps say.
    let awake = record.woken.clamp(record.release, start);
    let inside = record.entered.clamp(awake, start);
    let (exits, outside) = outside(detours, inside, start);
    let in_guest = Ticks(start.since(inside).0.saturating_sub(outside.0));
    let cause = in_guest_cause(record, detours, start);
    // An interrupt makes the way longer by an unknown time.
    let interrupted = matches!(cause, Cause::HostInterrupt { .. });
    let way = if interrupted { Ticks(0) } else { frequency.ticks(ENTRY) };
    let left = detours.first().map_or(start, |detour| detour.left.min(start));
    let way = in_guest.min(record.entered.after(way).min(left).since(inside));
    let asleep = record.woken.since(record.due);
    let (mut by_wake_up, mut by_host) = (awake.since(record.release), inside.since(awake));
    let late =
        if asleep >= record.entered.since(record.woken) { &mut by_wake_up } else { &mut by_host };
    late.0 = late.0.saturating_add(way.0);
    let nanos = |ticks| frequency.nanos(ticks);
    Some(Explanation::new(&[
        (Cause::LateWakeUp { after_due_ns: nanos(asleep).0 }, nanos(by_wake_up)),
        (Cause::HostDelay, nanos(by_host)),
        (Cause::VmExits { exits }, nanos(outside)),
        (cause, nanos(Ticks(in_guest.0.saturating_sub(way.0)))),
    ]))
}

/// How long a scan took, and where. What of it is usual is not known from one scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanTime {
    /// From the guest's start to its end, or to that of its window.
    pub execution: Nanos,
    /// False if the window ended first, so that the scan takes longer than `execution`.
    pub finished: bool,
    /// The part of `execution` that the guest was not left for.
    pub in_guest: Nanos,
    exits: u32,
    outside: Nanos,
    in_guest_cause: Cause,
}

impl ScanTime {
    /// The scan of a window; `None` if the guest claims none that is credible. One without an end
    /// counts only in an overrun: a guest that never says "done" has no scans that end.
    #[must_use]
    pub fn of(
        record: &WindowRecord,
        detours: &[Detour],
        frequency: TscFrequency,
    ) -> Option<ScanTime> {
        let scan = record.scan()?;
        let finished = record.finished_scan().is_some();
        if !finished && !record.overrun {
            return None;
        }
        let end = if finished { scan.done } else { record.left };
        let (exits, outside) = outside(detours, scan.start, end);
        let execution = end.since(scan.start);
        let in_guest = Ticks(execution.0.saturating_sub(outside.0));
        Some(ScanTime {
            execution: frequency.nanos(execution),
            finished,
            in_guest: frequency.nanos(in_guest),
            exits,
            outside: frequency.nanos(outside),
            in_guest_cause: in_guest_cause(record, detours, end),
        })
    }

    /// Explains what goes beyond `usual`, a time in the guest.
    #[must_use]
    pub fn explain(&self, usual: Nanos) -> Explanation {
        Explanation::new(&[
            (Cause::VmExits { exits: self.exits }, self.outside),
            (self.in_guest_cause, self.in_guest.less(usual)),
        ])
    }
}

/// How often and for how long the guest was left between two instants.
fn outside(detours: &[Detour], from: Tsc, to: Tsc) -> (u32, Ticks) {
    let (mut exits, mut ticks, mut at) = (0u32, 0u64, from);
    for detour in detours {
        let left = detour.left.max(at);
        let entered = detour.entered.min(to);
        if left < entered {
            exits = exits.saturating_add(1);
            ticks = ticks.saturating_add(entered.since(left).0);
            at = entered;
        }
    }
    (exits, Ticks(ticks))
}

/// Who took the time that ends at `end` and was spent in the guest as far as the thread can tell.
fn in_guest_cause(record: &WindowRecord, detours: &[Detour], end: Tsc) -> Cause {
    // The window's last exit is no detour. If others are missing, they came after the recorded
    // ones.
    let missing = record.exits.saturating_sub(1) as usize > detours.len();
    if record.kernel_exits == 0 || missing && detours.last().is_none_or(|d| d.entered < end) {
        return Cause::Unknown;
    }
    match record.kernel_exits.saturating_sub(u64::from(record.exits)) {
        0 => Cause::GuestComputation,
        exits => Cause::HostInterrupt { exits },
    }
}

#[cfg(test)]
#[path = "cause_tests.rs"]
mod tests;
