//! The bound for tasks that are released with windows, against the simulator.

use super::simulator::{Job, simulate};
use super::{Frame, frames, ticks};
use proptest::prelude::*;
use takt_scheduler::analysis::{Rule, Task, TaskSet, Verdict, bound_with};
use takt_scheduler::time::Nanos;

/// Frames that are simulated.
const FRAMES: u64 = 40;

/// A task: its period in frames, its budget, how much later than the first its releases are (in frames if it
/// is released with a window, in ticks each time if by events), and whether by events.
type Given = (u64, u64, Vec<u64>, bool);

fn tasks() -> impl Strategy<Value = Vec<Given>> {
    let late = prop::collection::vec(0..150u64, 1..6);
    prop::collection::vec((1..5u64, 1..60u64, late, any::<bool>()), 1..5)
}

/// Its jobs, the first of them with the window that begins at `base`.
fn jobs(at: usize, (frames, budget, late, event): &Given, frame: &Frame, base: u64) -> Vec<Job> {
    let (priority, period) = (200 - at as u8, frames * frame.length);
    let job = |release| Job { task: at, priority, release, deadline: u64::MAX, work: *budget };
    if !event {
        let first = base + late[0] % 4 * frame.length;
        return (first..FRAMES * frame.length).step_by(period as usize).map(job).collect();
    }
    let mut release = base;
    let mut jobs = Vec::new();
    for late in late.iter().cycle() {
        release += late;
        if release >= FRAMES * frame.length {
            return jobs;
        }
        jobs.push(job(release));
        release += period;
    }
    jobs
}

proptest! {
    /// No job takes longer than the bound, whatever the first window, and whenever events come.
    #[test]
    fn no_response_is_above_the_bound(frame in frames(), tasks in tasks(), first in any::<prop::sample::Index>()) {
        let us = Nanos::from_micros;
        let set: Vec<Task> = tasks.iter().enumerate().map(|(at, (frames, budget, ..))| {
            let period = us(frames * frame.length);
            Task { period, budget: us(*budget).min(period), priority: 200 - at as u8 }
        }).collect();
        let rules: Vec<Rule> = tasks.iter().zip(&set)
            .map(|((.., event), task)| Rule { deadline: task.period, at_window_start: !event })
            .collect();
        let set = TaskSet::new(&set).unwrap();
        let verdict = bound_with(&set, &rules, &frame.supply());
        let Verdict::Meets { responses } = verdict else { return Ok(()) };
        let (base, _) = frame.windows[first.index(frame.windows.len())];
        let jobs: Vec<Job> =
            tasks.iter().enumerate().flat_map(|(at, task)| jobs(at, task, &frame, base)).collect();
        let simulated = simulate(&frame.open(), tasks.len(), &jobs).unwrap();
        for (simulated, bound) in simulated.iter().zip(ticks(&responses)) {
            prop_assert!(*simulated <= bound, "{simulated} > {bound}");
        }
    }
}

/// What is known of the releases makes the bound that of a window, not of the gap before it.
#[test]
fn a_task_that_begins_with_its_window_does_not_wait_for_it() {
    let us = Nanos::from_micros;
    let frame = Frame { length: 500, windows: vec![(100, 200)], overhead: 0 };
    let task = |budget, priority| Task { period: us(500), budget: us(budget), priority };
    let set = TaskSet::new(&[task(20, 9), task(50, 8), task(10, 7)]).unwrap();
    let rule = |at_window_start| Rule { deadline: us(500), at_window_start };
    let responses = |rules: [Rule; 3]| match bound_with(&set, &rules, &frame.supply()) {
        Verdict::Meets { responses } => ticks(&responses),
        other => panic!("{other:?}"),
    };
    assert_eq!(responses([rule(true), rule(true), rule(true)]), [20, 70, 80]);
    // An event may come just as the window closes, and so may all below it.
    assert_eq!(responses([rule(true), rule(false), rule(true)]), [20, 470, 480]);
    assert_eq!(responses([rule(false); 3]), [420, 470, 480]);
}

#[test]
fn a_deadline_before_the_period_is_kept() {
    let us = Nanos::from_micros;
    let frame = Frame { length: 500, windows: vec![(100, 200)], overhead: 5 };
    let set = TaskSet::new(&[Task { period: us(500), budget: us(20), priority: 1 }]).unwrap();
    let verdict = |deadline| {
        let rule = Rule { deadline: us(deadline), at_window_start: true };
        bound_with(&set, &[rule], &frame.supply())
    };
    assert!(matches!(verdict(25), Verdict::Meets { .. }));
    let Verdict::Unproven { task, demand, supply } = verdict(24) else { panic!() };
    assert_eq!((task, demand, supply), (0, us(20), us(19)));
}
