//! The analysis against a simulator that shares nothing with it: random tables of several windows,
//! random task sets, random execution times.

mod rules;
mod simulator;

use proptest::prelude::*;
use proptest::sample::select;
use simulator::{Job, disturbed_ticks, open_ticks, simulate};
use takt_scheduler::analysis::{
    Method, Start, Supply, Task, TaskSet, Verdict, analyse, bound, replay,
};
use takt_scheduler::table::{Cpu, PartitionId, Placement, Role, Table, Window};
use takt_scheduler::time::Nanos;

const FRAMES: [u64; 5] = [100, 200, 300, 400, 500];
/// With these frames and periods, no hyperperiod is longer than 18 ms.
const PERIODS: [u64; 10] = [100, 150, 200, 300, 400, 500, 600, 900, 1200, 1500];

/// A frame and its windows, in ticks.
#[derive(Clone, Debug)]
struct Frame {
    length: u64,
    windows: Vec<(u64, u64)>,
    /// Lost at the start of each window.
    wake_up: u64,
    /// Lost anywhere in each window.
    interrupts: u64,
}

impl Frame {
    /// With all that is lost at the start of windows.
    fn open(&self) -> Vec<bool> {
        open_ticks(self.length, &self.windows, self.wake_up + self.interrupts)
    }

    /// For so many frames, with interrupts in these places.
    fn disturbed(&self, frames: u64, jobs: &[Job], places: &[u64]) -> Vec<bool> {
        let open = open_ticks(self.length, &self.windows, self.wake_up);
        let releases: Vec<u64> = jobs.iter().map(|job| job.release).collect();
        disturbed_ticks(&open, (frames, &self.windows), self.interrupts, &releases, places)
    }

    fn supply(&self) -> Supply {
        let partition = PartitionId(0);
        let placement = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::ZERO } };
        let us = Nanos::from_micros;
        let window = |&(start, end)| Window {
            partition,
            offset: us(start),
            duration: us(end - start),
            period: us(self.length),
        };
        let windows: Vec<Window> = self.windows.iter().map(window).collect();
        let table = Table::new(us(self.length), &[placement], &windows).unwrap();
        Supply::of(&table, partition, us(self.wake_up), us(self.interrupts)).unwrap()
    }
}

/// A frame and tasks in it, periods and budgets in ticks.
#[derive(Clone, Debug)]
struct Case {
    frame: Frame,
    tasks: Vec<(u64, u64, u8)>,
}

impl Case {
    fn set(&self) -> TaskSet {
        let us = Nanos::from_micros;
        let task =
            |&(period, budget, priority)| Task { period: us(period), budget: us(budget), priority };
        TaskSet::new(&self.tasks.iter().map(task).collect::<Vec<_>>()).unwrap()
    }

    /// Ticks after which everything repeats, found by trying.
    fn hyperperiod(&self) -> u64 {
        let periods = || self.tasks.iter().map(|t| t.0).chain([self.frame.length]);
        (1..).find(|ticks| periods().all(|p| ticks % p == 0)).unwrap()
    }

    /// The jobs of one hyperperiod; `actual` turns a budget into an execution time.
    fn jobs(&self, mut actual: impl FnMut(u64) -> u64) -> Vec<Job> {
        let mut jobs = Vec::new();
        for (task, &(period, budget, priority)) in self.tasks.iter().enumerate() {
            for release in (0..self.hyperperiod()).step_by(period as usize) {
                let deadline = release + period;
                jobs.push(Job { task, priority, release, deadline, work: actual(budget) });
            }
        }
        jobs
    }

    fn simulate(&self, jobs: &[Job]) -> Result<Vec<u64>, simulator::Miss> {
        simulate(&self.frame.open(), self.tasks.len(), jobs)
    }

    fn simulate_disturbed(
        &self,
        jobs: &[Job],
        places: &[u64],
    ) -> Result<Vec<u64>, simulator::Miss> {
        let last = jobs.iter().map(|job| job.release).max().unwrap_or(0);
        let frames = last / self.frame.length + 1;
        simulate(&self.frame.disturbed(frames, jobs, places), self.tasks.len(), jobs)
    }
}

fn frames() -> impl Strategy<Value = Frame> {
    select(&FRAMES[..])
        .prop_flat_map(|length| {
            let cuts = prop::collection::btree_set(0..=length / 10, 2..8);
            // Window edges off the grid of the periods; the last may be the end of the frame.
            (Just(length), cuts, 0..10u64, 0..5u64, 0..6u64)
        })
        .prop_map(|(length, cuts, shift, wake_up, interrupts)| {
            let cuts: Vec<u64> = cuts.into_iter().map(|c| (c * 10 + shift).min(length)).collect();
            let pairs = cuts.chunks_exact(2).map(|c| (c[0], c[1]));
            let windows = pairs.filter(|(a, b)| b - a >= 10).collect();
            Frame { length, windows, wake_up, interrupts }
        })
        .prop_filter("no window", |frame| !frame.windows.is_empty())
}

fn cases() -> impl Strategy<Value = Case> {
    let tasks = prop::collection::vec((select(&PERIODS[..]), 1..=1000u64), 1..6);
    let priorities = Just((0..6u8).collect::<Vec<_>>()).prop_shuffle();
    // From idle to a little too much, in parts of a thousand of the supply.
    (frames(), tasks, priorities, 100..1200u64).prop_map(|(frame, shares, priorities, load)| {
        let supply = frame.open().iter().filter(|open| **open).count() as u64;
        let sum: u64 = shares.iter().map(|(_, share)| share).sum();
        let budget = |period, share| period * supply * share * load / (frame.length * sum * 1000);
        let task = |(&(period, share), priority)| {
            (period, u64::clamp(budget(period, share), 1, period), priority)
        };
        let tasks = shares.iter().zip(priorities).map(task).collect();
        Case { frame, tasks }
    })
}

/// For [`disturbed_ticks`].
fn places() -> impl Strategy<Value = Vec<u64>> {
    prop::collection::vec(0..1000u64, 1..50)
}

fn ticks(responses: &[Nanos]) -> Vec<u64> {
    responses.iter().map(|r| r.0 / 1000).collect()
}

proptest! {
    /// Response times and misses are those of the simulator, to the tick; or on the safe side of them, where it says so.
    #[test]
    fn with_full_budgets_the_replay_is_the_simulator(case in cases()) {
        let simulated = case.simulate(&case.jobs(|budget| budget));
        match replay(&case.set(), &case.frame.supply()).unwrap() {
            (Method::Exact, Verdict::Meets { responses }) => {
                prop_assert_eq!(Ok(ticks(&responses)), simulated);
            }
            (Method::Bound, Verdict::Meets { responses }) => {
                let simulated = simulated.unwrap();
                prop_assert!(simulated.iter().zip(ticks(&responses)).all(|(s, r)| *s <= r));
            }
            (Method::Bound, Verdict::Misses(_)) => {}
            (Method::Exact, Verdict::Misses(miss)) => {
                let us = |n: Nanos| n.0 / 1000;
                let miss = simulator::Miss {
                    task: miss.task,
                    release: us(miss.release),
                    deadline: us(miss.deadline),
                    undone: us(miss.undone),
                };
                prop_assert_eq!(Err(miss), simulated);
            }
            (_, Verdict::Unproven { .. }) => prop_assert!(false, "the replay is never unsure"),
        }
    }

    /// What is accepted stays within its response times wherever interrupts fall.
    #[test]
    fn interrupts_anywhere_in_windows_break_nothing(case in cases(), places in places()) {
        if let Verdict::Meets { responses } = analyse(&case.set(), &case.frame.supply()).verdict {
            let simulated = case.simulate_disturbed(&case.jobs(|budget| budget), &places);
            prop_assert!(simulated.is_ok(), "{simulated:?}");
            for (simulated, bound) in simulated.unwrap().into_iter().zip(ticks(&responses)) {
                prop_assert!(simulated <= bound, "{simulated} > {bound}");
            }
        }
    }

    /// What is accepted stays within its response times however short the jobs really are.
    #[test]
    fn shorter_executions_break_nothing(
        case in cases(),
        shares in prop::collection::vec(0..=100u64, 1..50),
        places in places(),
    ) {
        if let Verdict::Meets { responses } = analyse(&case.set(), &case.frame.supply()).verdict {
            let mut shares = shares.iter().cycle();
            let jobs = case.jobs(|budget| (budget * shares.next().unwrap() / 100).max(1));
            let simulated = case.simulate_disturbed(&jobs, &places);
            prop_assert!(simulated.is_ok(), "{simulated:?}");
            for (simulated, bound) in simulated.unwrap().into_iter().zip(ticks(&responses)) {
                prop_assert!(simulated <= bound, "{simulated} > {bound}");
            }
        }
    }

    /// The bound accepts nothing that the replay rejects, and is never below it.
    #[test]
    fn the_bound_is_on_the_safe_side(case in cases()) {
        let (set, supply) = (case.set(), case.frame.supply());
        match (bound(&set, &supply), replay(&set, &supply).unwrap()) {
            // Each is on the safe side, and either may be closer.
            (_, (Method::Bound, _)) => {}
            (Verdict::Meets { responses }, (_, Verdict::Meets { responses: exact })) => {
                for (task, (bound, exact)) in responses.iter().zip(&exact).enumerate() {
                    prop_assert!(bound >= exact, "task {task}: {bound} < {exact}");
                    prop_assert!(*bound <= set.tasks()[task].period);
                }
            }
            (Verdict::Unproven { task, demand, supply: least }, _) => {
                prop_assert_eq!(least, supply.minimum(Start::Anywhere, set.tasks()[task].period));
                prop_assert!(least < demand, "{least} covers {demand}");
            }
            (bound, exact) => prop_assert!(false, "{bound:?}, but {exact:?}"),
        }
    }

    /// The bound holds for any phase, and for jobs that come later than a period.
    #[test]
    fn the_bound_holds_whenever_jobs_come(
        case in cases(),
        delays in prop::collection::vec(0..300u64, 10..50),
        places in places(),
    ) {
        if let Verdict::Meets { responses } = bound(&case.set(), &case.frame.supply()) {
            let mut delays = delays.iter().cycle();
            let mut jobs = Vec::new();
            for (task, &(period, work, priority)) in case.tasks.iter().enumerate() {
                let mut release = 0;
                // A phase for each task, then now and then a delay.
                while release < 5000 {
                    let delay = *delays.next().unwrap();
                    release += if jobs.len() % 3 == 0 { delay } else { delay / 100 };
                    jobs.push(Job { task, priority, release, deadline: release + period, work });
                    release += period;
                }
            }
            let simulated = case.simulate_disturbed(&jobs, &places);
            prop_assert!(simulated.is_ok(), "{simulated:?}");
            for (simulated, bound) in simulated.unwrap().into_iter().zip(ticks(&responses)) {
                prop_assert!(simulated <= bound, "{simulated} > {bound}");
            }
        }
    }

    /// Counting the open ticks gives the same supply, from any instant and in the worst phase; with interrupts at the end of
    /// windows, which the phase can follow, too.
    #[test]
    fn supply_is_what_counting_gives(frame in frames(), from in 0..1500u64, length in 0..1500u64) {
        let (open, supply) = (frame.open(), frame.supply());
        let count = |from: u64, length: u64| {
            let in_use = |t: &u64| open[(t % frame.length) as usize];
            Nanos::from_micros((from..from + length).filter(in_use).count() as u64)
        };
        let us = Nanos::from_micros;
        prop_assert_eq!(supply.available(us(from), us(from + length)), count(from, length));
        let phases = || 0..frame.length;
        let outside = phases().filter(|p| frame.windows.iter().all(|(a, b)| p <= a || b <= p));
        let least = outside.map(|phase| count(phase, length)).min().unwrap_or(Nanos::ZERO);
        prop_assert_eq!(supply.minimum(Start::Outside, us(length)), least);
        // In the window in which it begins the interrupts come last.
        let last = |phase: u64| {
            let begun = frame.windows.iter().find(|(a, b)| a + frame.wake_up < phase && phase < *b);
            begun.map(|(_, end)| {
                let head = (end - phase).saturating_sub(frame.interrupts).min(length);
                let tail = length.saturating_sub(end - phase);
                us(head).plus(count(*end, tail))
            })
        };
        let inside = phases().filter_map(last).min().unwrap_or(least);
        prop_assert_eq!(supply.minimum(Start::Anywhere, us(length)), inside.min(least));
    }

    /// A completion is the first instant with enough supply, to the nanosecond, however far away;
    /// and the longest time to one is the first length with enough supply in the worst phase.
    #[test]
    fn completions_invert_the_supply(
        frame in frames(),
        from in 0..u64::MAX / 2,
        demand in 1..100_000_000u64,
    ) {
        let supply = frame.supply();
        let (from, demand, tick) = (Nanos(from), Nanos(demand), Nanos(1));
        let finish = supply.finish(from, demand).unwrap();
        prop_assert_eq!(supply.available(from, finish), demand);
        prop_assert!(supply.available(from, finish.less(tick)) < demand);
        for start in [Start::Window, Start::Outside, Start::Anywhere] {
            let longest = supply.longest(start, demand).unwrap();
            prop_assert!(supply.minimum(start, longest) >= demand);
            prop_assert!(supply.minimum(start, longest.less(tick)) < demand);
        }
    }

    /// Whatever the numbers, the answer comes, does not overflow, and is consistent.
    #[test]
    fn any_input_is_answered(
        frame in frames(),
        tasks in prop::collection::vec((0..64u32, any::<u64>(), 0..64u32, any::<u64>()), 0..70),
    ) {
        // Shifted, so that all magnitudes come.
        let tasks: Vec<Task> = (0u8..)
            .zip(tasks)
            .map(|(priority, (a, period, b, budget))| Task {
                period: Nanos(period >> a),
                budget: Nanos(budget >> b),
                priority,
            })
            .collect();
        // Also the well-formed among them on their own: few lists are so as a whole.
        let good: Vec<Task> =
            tasks.iter().copied().filter(|t| TaskSet::new(&[*t]).is_ok()).take(64).collect();
        for list in [tasks, good] {
            let Ok(set) = TaskSet::new(&list) else { continue };
            let supply = frame.supply();
            let analysis = analyse(&set, &supply);
            let _ = (set.fits_frame(supply.frame()), analysis.load.permille());
            match analysis.verdict {
                Verdict::Meets { responses } => {
                    prop_assert!(responses.iter().zip(set.tasks()).all(|(r, t)| *r <= t.period));
                    let rounding = Nanos(set.tasks().len() as u64);
                    prop_assert!(analysis.load.demand <= analysis.load.supply.plus(rounding));
                }
                Verdict::Misses(miss) => prop_assert!(miss.undone > Nanos::ZERO),
                Verdict::Unproven { demand, supply, .. } => prop_assert!(supply < demand),
            }
        }
    }
}
