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
//! The kernel admits periods between two bounds only. A kicker's is kept inside of them, and the
//! schedules have to leave room for that ([`CpuReservations::check`]).
//!
//! A reservation is made once, at the start, and serves under every schedule: the kernel could
//! refuse a new one in the middle of a run.

use crate::schedules::Schedules;
use crate::sleep::{LAZY, SHORT, SURE, Steering};
use thiserror::Error;

use crate::table::{Cpu, PartitionId, Placement, Role};
use crate::time::Nanos;

/// Budget beyond guard and window, so that a kick, which takes some tens of microseconds to get
/// through, lands before the throttle does.
pub const KICK_MARGIN: Nanos = Nanos::from_micros(50);
/// Budget of the kicker for one kick.
pub const KICKER_RUNTIME: Nanos = Nanos::from_micros(20);
/// What it has beyond that for each further wake-up between two pieces of a divided sleep that may share the budget
/// of an end. In the lab such a wake-up takes up to 7 us, an end 9 us.
pub const KICKER_PIECE: Nanos = Nanos::from_micros(10);
/// Shortest period that kernels admit: the default of `kernel.sched_deadline_period_min_us`
/// (`sysctl_sched_dl_period_min` in `kernel/sched/deadline.c`).
pub const PERIOD_MIN: Nanos = Nanos::from_micros(100);
/// Longest period that kernels admit: the default of `kernel.sched_deadline_period_max_us`, 2^22 us.
pub const PERIOD_MAX: Nanos = Nanos::from_micros(1 << 22);
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
    /// How long after a wake-up the kernel takes the bandwidth of a thread back that has then used the
    /// processor for `used` and sleeps: when the share that it has reserved would have given it as much. It is a
    /// timer's interrupt on the thread's CPU (`task_non_contending`, kernel/sched/deadline.c).
    #[must_use]
    pub fn taken_back_after(&self, used: Nanos) -> Nanos {
        let ns = u128::from(used.0) * u128::from(self.period.0) / u128::from(self.runtime.0.max(1));
        Nanos(u64::try_from(ns).unwrap_or(u64::MAX))
    }

    /// Share of the CPU, in parts of a thousand, rounded up.
    #[must_use]
    pub fn permille(&self) -> u64 {
        self.permille_of(self.runtime)
    }

    fn permille_of(&self, time: Nanos) -> u64 {
        (u128::from(time.0) * 1000).div_ceil(u128::from(self.period.0.max(1))) as u64
    }

    /// How late the kick may be of a partition with this reservation, if the clock's rate becomes slower by a tenth after the
    /// partition's last look at it: by a ninth of what is left of the kicker's sleep. A thread that has used up its budget
    /// by then is throttled, and released by a timer on that clock, which may be late by a ninth of its period.
    fn late_kick(&self) -> Nanos {
        let asleep = self.runtime.less(KICK_MARGIN).plus(SHORT).min(LAZY);
        Nanos(asleep.0.div_ceil(9)).min(self.period.less(self.runtime))
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

/// Why the schedules of a CPU cannot be reserved for, whatever else runs there.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum PeriodError {
    /// The kernel admits no such period.
    #[error("the shortest time from a release to the next is {period}")]
    Partition {
        /// Whose releases.
        partition: PartitionId,
        /// The period that it would get.
        period: Nanos,
    },
    /// Each end needs a budget of its own, and the kernel gives none so often.
    #[error("windows end {between} apart")]
    Ends {
        /// The shortest time from one end to the next.
        between: Nanos,
    },
    /// At the window's end the partition's deadline would come before any that the kicker can have.
    #[error("guard and window leave {slack} of the shortest time from a release to the next")]
    Slack {
        /// Whose window.
        partition: PartitionId,
        /// What is left.
        slack: Nanos,
    },
}

impl CpuReservations {
    /// Whether the kernel takes the periods of one CPU, and its windows can be ended by a kick.
    ///
    /// # Errors
    /// The first rule that is broken, see [`PeriodError`].
    pub fn check(schedules: &Schedules, cpu: Cpu) -> Result<(), PeriodError> {
        let on_cpu = |(i, placement): (usize, &Placement)| match placement.role {
            Role::Windowed { guard } if placement.cpu == cpu => {
                let partition = PartitionId(i);
                Some((partition, guard, schedules.timetable_of(partition)?))
            }
            _ => None,
        };
        let owners: Vec<_> = schedules.placements().iter().enumerate().filter_map(on_cpu).collect();
        for (partition, _, timetable) in &owners {
            let period = timetable.shortest_period();
            if !(PERIOD_MIN..=PERIOD_MAX).contains(&period) {
                return Err(PeriodError::Partition { partition: *partition, period });
            }
        }
        let between = schedules.timetable_on(cpu).map(|all| all.shortest_between_ends());
        if let Some(between) = between.filter(|between| *between < PERIOD_MIN) {
            return Err(PeriodError::Ends { between });
        }
        for (partition, guard, timetable) in &owners {
            let slack = timetable.shortest_period().less(guard.plus(timetable.longest()));
            if slack <= PERIOD_MIN {
                return Err(PeriodError::Slack { partition: *partition, slack });
            }
        }
        Ok(())
    }

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
        let kicker = schedules.timetable_on(cpu).map(|all| {
            let period =
                Nanos(slack.0 / 2).min(all.shortest_between_ends()).clamp(PERIOD_MIN, PERIOD_MAX);
            let pieces = pieces_within(period, all.longest_between_ends());
            Reservation { runtime: KICKER_RUNTIME.plus(pieces), period }
        });
        CpuReservations { partitions, kicker }
    }

    /// The same by a clock of which that is known. Where its rate may change, they have room beyond for what a step of
    /// the rate costs, as far as the CPU's ceiling has it: the kicker for one more wake-up, a look at the clock or the
    /// message that it is steered; then each partition for a kick that is late.
    #[must_use]
    pub fn by_a_clock_whose_steering_is(mut self, steering: Steering) -> CpuReservations {
        if steering == Steering::Impossible {
            return self;
        }
        let (for_looks, room) = (self.has_room_for_looks(), self.room_for_late_kicks());
        if let Some(kicker) = self.kicker.as_mut().filter(|_| for_looks) {
            kicker.runtime = kicker.runtime.plus(KICKER_PIECE);
        }
        for ((_, r), given) in self.partitions.iter_mut().zip(room) {
            r.runtime = r.runtime.plus(given);
        }
        self
    }

    /// Whether the kicker gets the budget for a look at the clock. Asked of what [`of`](Self::of) gives.
    #[must_use]
    pub fn has_room_for_looks(&self) -> bool {
        self.permille() + self.looks_permille() <= CEILING_PERMILLE
    }

    fn looks_permille(&self) -> u64 {
        self.kicker.map_or(0, |kicker| kicker.permille_of(KICKER_PIECE))
    }

    /// What each partition gets for late kicks, if there is not enough for all of them in equal parts.
    fn room_for_late_kicks(&self) -> Vec<Nanos> {
        let wanted: u64 = self.partitions.iter().map(|(_, r)| r.permille_of(r.late_kick())).sum();
        let taken =
            self.permille() + if self.has_room_for_looks() { self.looks_permille() } else { 0 };
        let left = CEILING_PERMILLE.saturating_sub(taken);
        let given = |kick: Nanos| match wanted <= left {
            true => kick,
            false => Nanos(kick.0 * left / wanted),
        };
        self.partitions.iter().map(|(_, r)| given(r.late_kick())).collect()
    }

    /// The partitions that have no room for the latest kick that they may get. One that is late by a ninth of [`SURE`]
    /// is in the [`KICK_MARGIN`]. Asked of what [`of`](Self::of) gives.
    pub(crate) fn without_room(&self) -> impl Iterator<Item = PartitionId> {
        let all = self.partitions.iter().zip(self.room_for_late_kicks());
        all.filter(|((_, r), given)| given.plus(Nanos(SURE.0 / 9)) < r.late_kick())
            .map(|((id, _), _)| *id)
    }

    /// Sum of all shares, in parts of a thousand.
    #[must_use]
    pub fn permille(&self) -> u64 {
        let partitions = self.partitions.iter().map(|(_, r)| r);
        partitions.chain(&self.kicker).map(Reservation::permille).sum()
    }
}

/// Budget for wake-ups between pieces beside the one that the runtime for a kick has room for. In its last [`LAZY`]
/// a sleep of the kicker's is divided once. One piece of a longer sleep may end shortly before, and within a
/// longer period others: one for each ninth that leads from the period to [`LAZY`], and as many as it takes more
/// where the clock is fast, so that each piece, and the last, ends early.
pub(crate) fn pieces_within(period: Nanos, longest_sleep: Nanos) -> Nanos {
    let further = match (period.0 / LAZY.0).checked_ilog(9) {
        _ if longest_sleep <= LAZY => 0,
        None => 1,
        Some(ninths) => 3 + ninths,
    };
    Nanos(KICKER_PIECE.0 * u64::from(further))
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
    fn where_the_clock_may_be_steered_a_budget_has_room_for_a_kick_that_is_late_by_a_ninth() {
        let runtime = |windows| {
            one_plc(windows).by_a_clock_whose_steering_is(Steering::Possible).partitions[0]
                .1
                .runtime
        };
        // 112 us before the wake-up, 20 us of guard, the window.
        assert_eq!(runtime(&[(0, 300)]), us(370 + 48));
        let kicker = one_plc(&[(0, 300)]).by_a_clock_whose_steering_is(Steering::Possible).kicker;
        assert_eq!(kicker.map(|r| r.runtime), Some(us(30)));
        // 720 of 1000 are the partition's and up to 180 the kicker's: what is left, and not more.
        let full = one_plc(&[(0, 650)]);
        let (base, all) = (full.permille(), full.by_a_clock_whose_steering_is(Steering::Possible));
        assert!((base..=CEILING_PERMILLE).contains(&all.permille()), "{all:?}");
        let given = all.partitions[0].1.runtime.less(us(720));
        assert!(
            given <= us(CEILING_PERMILLE - base) && given.plus(us(1)) > us(CEILING_PERMILLE - base),
            "{all:?}"
        );
        // A file that has been refused before asks for no more.
        let too_much = one_plc(&[(0, 800)]);
        assert_eq!(too_much.clone().by_a_clock_whose_steering_is(Steering::Possible), too_much);
    }

    #[test]
    fn where_a_cpu_has_little_room_looks_at_the_clock_come_before_late_kicks() {
        let of = |window| {
            let all = one_plc(&[(0, window)]);
            (all.has_room_for_looks(), all.without_room().count() == 0)
        };
        // A kick that is 20 us late is in the margin of each reservation.
        let found = [300, 550, 620, 650].map(of);
        assert_eq!(found, [(true, true), (true, true), (true, false), (false, false)]);
    }

    #[test]
    fn what_is_left_for_late_kicks_is_shared_and_no_kicker_sleeps_longer_than_the_lazy_do() {
        let placements =
            [0, 1].map(|_| Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } });
        let of = |frame: u64, durations: [u64; 2]| {
            let windows = [0, 1].map(|n| Window {
                partition: PartitionId(n),
                offset: us(frame / 2 * n as u64),
                duration: us(durations[n]),
                period: us(frame),
            });
            let schedules = Schedules::new(us(frame), &placements, &[&windows]).unwrap();
            CpuReservations::of(&schedules, Cpu(0)).by_a_clock_whose_steering_is(Steering::Possible)
        };
        let runtimes = |all: &CpuReservations| [0, 1].map(|n| all.partitions[n].1.runtime);
        // 2 ms at most are slept by a clock that was good.
        let ninth = Nanos(LAZY.0.div_ceil(9));
        let long = of(20_000, [5_000, 2_000]);
        assert_eq!(runtimes(&long), [us(5_070).plus(ninth), us(2_070).plus(ninth)]);
        let full = of(1_000, [380, 220]);
        assert!(full.permille() <= CEILING_PERMILLE, "{full:?}");
        let [first, second] = runtimes(&full);
        assert!(first > us(450) && second > us(290), "{full:?}");
        assert!(first < us(450 + 57) && second < us(290 + 40), "{full:?}");
    }

    #[test]
    fn bandwidth_is_taken_back_when_the_share_would_have_given_what_was_used() {
        let quarter = Reservation { runtime: us(250), period: us(1000) };
        assert_eq!(quarter.taken_back_after(us(5)), us(20));
        assert_eq!(quarter.taken_back_after(us(250)), us(1000));
        assert_eq!(quarter.taken_back_after(Nanos::ZERO), Nanos::ZERO);
        let none = Reservation { runtime: Nanos::ZERO, period: Nanos(u64::MAX) };
        assert_eq!(none.taken_back_after(Nanos(u64::MAX)), Nanos(u64::MAX));
    }

    #[test]
    fn the_kickers_deadline_comes_before_that_of_the_thread_it_kicks() {
        let r = one_plc(&[(0, 300)]);
        // At the window's end the vCPU thread, woken 20 us early, still has 680 us.
        assert!(r.kicker.unwrap().period < us(1000 - 20 - 300));
    }

    #[test]
    fn the_kicker_has_its_whole_budget_for_each_windows_end() {
        // Ends at 100 us, 400 us and, in the next frame, 1100 us.
        assert_eq!(one_plc(&[(0, 100), (350, 50)]).kicker.unwrap().period, us((350 - 120) / 2));
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
    fn the_kicker_has_a_budget_for_the_pieces_of_sleeps_that_are_long() {
        let placement = Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(20) } };
        let kicker = |frame, windows: &[(u64, u64)]| {
            let window = |&(offset, duration): &(u64, u64)| Window {
                partition: PartitionId(0),
                offset: us(offset),
                duration: us(duration),
                period: us(frame),
            };
            let windows: Vec<Window> = windows.iter().map(window).collect();
            let schedules = Schedules::new(us(frame), &[placement], &[&windows]).unwrap();
            CpuReservations::of(&schedules, Cpu(0)).kicker.unwrap()
        };
        let reservation =
            |runtime, period| Reservation { runtime: us(runtime), period: us(period) };
        assert_eq!(kicker(1000, &[(0, 300)]), reservation(20, 340));
        assert_eq!(kicker(2000, &[(0, 180)]), reservation(20, 900));
        assert_eq!(kicker(2001, &[(0, 181)]), reservation(30, 900));
        assert_eq!(kicker(10_000, &[(0, 100), (500, 80)]), reservation(30, 190));
        assert_eq!(kicker(4100, &[(0, 80)]), reservation(50, 2000));
        assert_eq!(kicker(100_000, &[(0, 20_000)]), reservation(60, 39_990));
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

    fn check(frame: u64, guard: u64, windows: &[(u64, u64)]) -> Result<(), PeriodError> {
        let placements = [Placement { cpu: Cpu(0), role: Role::Windowed { guard: us(guard) } }];
        let windows: Vec<Window> = windows
            .iter()
            .map(|&(offset, duration)| Window {
                partition: PartitionId(0),
                offset: us(offset),
                duration: us(duration),
                period: us(frame),
            })
            .collect();
        let schedules = Schedules::new(us(frame), &placements, &[&windows]).unwrap();
        let checked = CpuReservations::check(&schedules, Cpu(0));
        let made = CpuReservations::of(&schedules, Cpu(0));
        if checked.is_ok() {
            let mut periods = made.partitions.iter().map(|(_, r)| r).chain(&made.kicker);
            assert!(periods.all(|r| (PERIOD_MIN..=PERIOD_MAX).contains(&r.period)));
        }
        checked
    }

    #[test]
    fn periods_that_the_kernel_admits_are_not_refused() {
        let plc = PartitionId(0);
        let refused = |period| Err(PeriodError::Partition { partition: plc, period: us(period) });
        assert_eq!(check(4_194_304, 20, &[(0, 300)]), Ok(()));
        assert_eq!(check(4_194_305, 20, &[(0, 300)]), refused(4_194_305));
        assert_eq!(check(8_000_000, 20, &[(0, 300), (4_000_000, 300)]), Ok(()));
        assert_eq!(check(1000, 0, &[(0, 10), (99, 10)]), refused(99));
        assert_eq!(check(111, 0, &[(0, 10)]), Ok(()));
    }

    #[test]
    fn a_window_leaves_more_than_the_shortest_deadline_of_a_kicker() {
        let slack = |slack| Err(PeriodError::Slack { partition: PartitionId(0), slack: us(slack) });
        assert_eq!(check(400, 20, &[(0, 280)]), slack(100));
        assert_eq!(check(400, 20, &[(0, 279)]), Ok(()));
        assert_eq!(check(100, 0, &[(0, 10)]), slack(90));
    }

    #[test]
    fn windows_end_as_far_apart_as_the_kernel_gives_budgets() {
        let ends = |between| Err(PeriodError::Ends { between: us(between) });
        assert_eq!(check(2000, 0, &[(0, 100), (150, 49)]), ends(99));
        assert_eq!(check(2000, 0, &[(0, 100), (150, 50)]), slack_of_100(50));
    }

    fn slack_of_100(slack: u64) -> Result<(), PeriodError> {
        Err(PeriodError::Slack { partition: PartitionId(0), slack: us(slack) })
    }

    #[test]
    fn a_cpu_without_windows_needs_nothing() {
        let background = Placement { cpu: Cpu(0), role: Role::Background };
        let schedules = Schedules::new(us(1000), &[background], &[&[]]).unwrap();
        let r = CpuReservations::of(&schedules, Cpu(0));
        assert_eq!((r.kicker, r.permille()), (None, 0));
    }
}
