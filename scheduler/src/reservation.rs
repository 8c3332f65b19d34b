//! What the schedules ask of SCHED_DEADLINE.
//!
//! The kernel's constant-bandwidth server is the second fence around a window: the first is the
//! kick at its end. The reservation must therefore *exceed* the window by what the kick takes to
//! arrive. With a budget equal to the window, a thread was throttled just before its kick in half
//! of all windows, and was cut only when the budget came back, a period later.
//!
//! The kicker is a deadline thread itself, since only such a thread preempts another one, and
//! only one with an *earlier absolute deadline* does. At a window's end the vCPU thread's deadline
//! is still `period - guard - window` away: the kicker's relative deadline is half of that. It also
//! is no longer than the time between two window ends, since each end needs the whole budget.
//!
//! A reservation is made once, at the start, and serves under every schedule: the kernel could
//! refuse a new one in the middle of a run.

use crate::schedules::Schedules;
use crate::table::{Cpu, PartitionId, Role};
use crate::time::Nanos;

/// Budget beyond guard and window, so that a kick, which takes some tens of microseconds to get
/// through, lands before the throttle does.
pub const KICK_MARGIN: Nanos = Nanos::from_micros(50);
/// Budget of the kicker for one kick.
pub const KICKER_RUNTIME: Nanos = Nanos::from_micros(20);
/// Smallest deadline that is useful for the kicker.
const KICKER_PERIOD_MIN: Nanos = Nanos::from_micros(50);
/// Share of a CPU that reservations may take, in parts of a thousand. Kernels admit 950 (6.1) or
/// 900 (6.18); the rest is what keeps the host itself alive.
pub const CEILING_PERMILLE: u64 = 900;

/// Parameters of SCHED_DEADLINE; the deadline equals the period. (A shorter deadline would make
/// the kernel put a thread to sleep that wakes a little before its period is over: `sched/deadline.c`,
/// "constrained deadline".)
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reservation {
    /// Budget in each period.
    pub runtime: Nanos,
    /// Period and relative deadline.
    pub period: Nanos,
}

impl Reservation {
    /// Share of the CPU, in parts of a thousand, rounded up.
    #[must_use]
    pub fn permille(&self) -> u64 {
        (u128::from(self.runtime.0) * 1000).div_ceil(u128::from(self.period.0.max(1))) as u64
    }
}

/// The reservations that one CPU needs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CpuReservations {
    /// For each windowed partition of this CPU.
    pub partitions: Vec<(PartitionId, Reservation)>,
    /// For the thread that ends windows; `None` where there are none.
    pub kicker: Option<Reservation>,
}

impl CpuReservations {
    /// Derives them from the schedules.
    #[must_use]
    pub fn of(schedules: &Schedules, cpu: Cpu) -> CpuReservations {
        let mut partitions = Vec::new();
        let mut slack = Nanos(u64::MAX);
        for (i, placement) in schedules.placements().iter().enumerate() {
            let Role::Windowed { guard } = placement.role else { continue };
            let id = PartitionId(i);
            let Some(timetable) = schedules.timetable_of(id).filter(|_| placement.cpu == cpu)
            else {
                continue;
            };
            let busy = guard.plus(timetable.longest());
            let period = timetable.shortest_period();
            slack = slack.min(period.less(busy));
            let runtime = busy.plus(KICK_MARGIN).min(period);
            partitions.push((id, Reservation { runtime, period }));
        }
        let kicker = schedules.timetable_on(cpu).map(|all| Reservation {
            runtime: KICKER_RUNTIME,
            period: Nanos(slack.0 / 2).min(all.shortest_between_ends()).max(KICKER_PERIOD_MIN),
        });
        CpuReservations { partitions, kicker }
    }

    /// Sum of all shares, in parts of a thousand.
    #[must_use]
    pub fn permille(&self) -> u64 {
        let partitions = self.partitions.iter().map(|(_, r)| r);
        partitions.chain(&self.kicker).map(Reservation::permille).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::{Placement, Window};

    fn us(n: u64) -> Nanos {
        Nanos::from_micros(n)
    }

    fn one_plc(windows: &[(u64, u64)]) -> CpuReservations {
        let placements = [
            Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } },
            Placement { cpu: Cpu(0), role: Role::Background },
        ];
        let windows: Vec<Window> = windows
            .iter()
            .map(|&(offset, duration)| Window {
                partition: PartitionId(0),
                offset: us(offset),
                duration: us(duration),
                period: us(1000),
            })
            .collect();
        let schedules = Schedules::new(us(1000), &placements, &[&windows]).unwrap();
        CpuReservations::of(&schedules, Cpu(0))
    }

    #[test]
    fn a_budget_exceeds_guard_and_window_by_the_kick() {
        let r = one_plc(&[(0, 300)]);
        let plc = Reservation { runtime: us(370), period: us(1000) };
        assert_eq!(r.partitions, [(PartitionId(0), plc)]);
        assert_eq!(r.permille(), 370 + 59);
    }

    #[test]
    fn the_kickers_deadline_comes_before_that_of_the_thread_it_kicks() {
        let r = one_plc(&[(0, 300)]);
        // At the window's end the vCPU thread, woken 20 us early, still has 680 us.
        assert!(r.kicker.unwrap().period < us(1000 - 20 - 300));
    }

    #[test]
    fn the_kicker_has_its_whole_budget_for_each_windows_end() {
        // Ends at 100 us, 300 us and, in the next frame, 1100 us.
        assert_eq!(one_plc(&[(0, 100), (250, 50)]).kicker.unwrap().period, us((250 - 120) / 2));
        let placements =
            [0, 1].map(|_| Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } });
        let window = |partition, offset| Window {
            partition: PartitionId(partition),
            offset: us(offset),
            duration: us(100),
            period: us(2000),
        };
        let windows = [window(0, 0), window(1, 200)];
        let schedules = Schedules::new(us(2000), &placements, &[&windows]).unwrap();
        assert_eq!(CpuReservations::of(&schedules, Cpu(0)).kicker.unwrap().period, us(200));
    }

    #[test]
    fn several_windows_take_the_longest_in_the_shortest_period() {
        let r = one_plc(&[(0, 100), (400, 200)]);
        assert_eq!(r.partitions[0].1, Reservation { runtime: us(270), period: us(400) });
    }

    #[test]
    fn one_reservation_serves_under_every_schedule() {
        let placements = [Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } }];
        let window = |offset, duration| Window {
            partition: PartitionId(0),
            offset: us(offset),
            duration: us(duration),
            period: us(1000),
        };
        let (short, long) = ([window(400, 100)], [window(0, 300)]);
        let schedules = Schedules::new(us(1000), &placements, &[&short, &long]).unwrap();
        let r = CpuReservations::of(&schedules, Cpu(0));
        // The longest window, and at a switch the one at 0 comes 600 us after the one at 400 us.
        assert_eq!(r.partitions[0].1, Reservation { runtime: us(370), period: us(600) });
    }

    #[test]
    fn a_cpu_without_windows_needs_nothing() {
        let background = Placement { cpu: Cpu(0), role: Role::Background };
        let schedules = Schedules::new(us(1000), &[background], &[&[]]).unwrap();
        let r = CpuReservations::of(&schedules, Cpu(0));
        assert_eq!((r.kicker, r.permille()), (None, 0));
    }
}
