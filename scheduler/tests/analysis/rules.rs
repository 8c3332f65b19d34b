//! The bound for tasks that are released with windows, against the simulator.

use super::simulator::{Job, simulate};
use super::{Frame, frames, places, ticks};
use proptest::prelude::*;
use takt_scheduler::analysis::{Rule, Start, Task, TaskSet, Verdict, bound_with};
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
    fn no_response_is_above_the_bound(frame in frames(), tasks in tasks(), first in any::<prop::sample::Index>(), places in places()) {
        let us = Nanos::from_micros;
        let set: Vec<Task> = tasks.iter().enumerate().map(|(at, (frames, budget, ..))| {
            let period = us(frames * frame.length);
            Task { period, budget: us(*budget).min(period), priority: 200 - at as u8 }
        }).collect();
        let rules: Vec<Rule> = tasks.iter().zip(&set)
            .map(|((.., event), task)| {
                let released = if *event { Start::Anywhere } else { Start::Window };
                Rule { deadline: task.period, released }
            })
            .collect();
        let set = TaskSet::new(&set).unwrap();
        let verdict = bound_with(&set, &rules, &frame.supply());
        let Verdict::Meets { responses } = verdict else { return Ok(()) };
        let (base, _) = frame.windows[first.index(frame.windows.len())];
        let jobs: Vec<Job> =
            tasks.iter().enumerate().flat_map(|(at, task)| jobs(at, task, &frame, base)).collect();
        let simulated = simulate(&frame.disturbed(FRAMES, &jobs, &places), tasks.len(), &jobs).unwrap();
        for (simulated, bound) in simulated.iter().zip(ticks(&responses)) {
            prop_assert!(*simulated <= bound, "{simulated} > {bound}");
        }
    }
}

/// What is known of the releases makes the bound that of a window, not of the gap before it.
#[test]
fn a_task_that_begins_with_its_window_does_not_wait_for_it() {
    let us = Nanos::from_micros;
    let frame = Frame { length: 500, windows: vec![(100, 200)], wake_up: 0, interrupts: 0 };
    let task = |budget, priority| Task { period: us(500), budget: us(budget), priority };
    let set = TaskSet::new(&[task(20, 9), task(50, 8), task(10, 7)]).unwrap();
    let rule = |released| Rule { deadline: us(500), released };
    let responses = |rules: [Rule; 3]| match bound_with(&set, &rules, &frame.supply()) {
        Verdict::Meets { responses } => ticks(&responses),
        other => panic!("{other:?}"),
    };
    assert_eq!(responses([rule(Start::Window); 3]), [20, 70, 80]);
    // An event may come just as the window closes, and so may all below it.
    assert_eq!(
        responses([rule(Start::Window), rule(Start::Anywhere), rule(Start::Window)]),
        [20, 470, 480]
    );
    assert_eq!(responses([rule(Start::Anywhere); 3]), [420, 470, 480]);
}

#[test]
fn a_deadline_before_the_period_is_kept() {
    let us = Nanos::from_micros;
    let frame = Frame { length: 500, windows: vec![(100, 200)], wake_up: 5, interrupts: 0 };
    let set = TaskSet::new(&[Task { period: us(500), budget: us(20), priority: 1 }]).unwrap();
    let verdict = |deadline| {
        let rule = Rule { deadline: us(deadline), released: Start::Window };
        bound_with(&set, &[rule], &frame.supply())
    };
    assert!(matches!(verdict(25), Verdict::Meets { .. }));
    let Verdict::Unproven { task, demand, supply } = verdict(24) else { panic!() };
    assert_eq!((task, demand, supply), (0, us(20), us(19)));
}
