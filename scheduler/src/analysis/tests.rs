//! Verdicts worked out by hand. Random ones against a simulator are in `tests/analysis`.

use super::*;
use crate::table::{Cpu, PartitionId, Placement, Role, Table, Window};

fn us(n: u64) -> Nanos {
    Nanos::from_micros(n)
}

/// Windows `start..end` in a frame, in us.
fn supply(frame: u64, windows: &[(u64, u64)], wake_up: u64) -> Supply {
    with_interrupts(frame, windows, wake_up, 0)
}

/// The same with interrupts, in us for each window.
fn with_interrupts(frame: u64, windows: &[(u64, u64)], wake_up: u64, interrupts: u64) -> Supply {
    let partition = PartitionId(0);
    let placement = Placement { cpu: Cpu(0), role: Role::Windowed { guard: Nanos::ZERO } };
    let window = |&(start, end)| Window {
        partition,
        offset: us(start),
        duration: us(end - start),
        period: us(frame),
    };
    let windows: Vec<Window> = windows.iter().map(window).collect();
    let table = Table::new(us(frame), &[placement], &windows).unwrap();
    Supply::of(&table, partition, us(wake_up), us(interrupts)).unwrap()
}

/// Tasks `(period, budget)` in us, the most urgent first.
fn tasks(tasks: &[(u64, u64)]) -> TaskSet {
    let task = |(i, &(period, budget)): (usize, _)| Task {
        period: us(period),
        budget: us(budget),
        priority: 200 - i as u8,
    };
    TaskSet::new(&tasks.iter().enumerate().map(task).collect::<Vec<_>>()).unwrap()
}

fn meets(responses: &[u64]) -> Verdict {
    Verdict::Meets { responses: responses.iter().map(|&n| us(n)).collect() }
}

#[test]
fn work_that_does_not_fit_a_window_goes_on_in_the_next() {
    let set = tasks(&[(1000, 100), (2000, 250)]);
    // 0..100 the first, 100..300 the second; 1000..1100 the first, 1100..1150 the second.
    let analysis = analyse(&set, &supply(1000, &[(0, 300)], 0));
    assert_eq!((analysis.method, analysis.verdict), (Method::Exact, meets(&[100, 1150])));
}

/// The example of `docs/analysis.md`, with every figure that it gives.
#[test]
fn the_documented_example_holds() {
    let s = supply(1000, &[(0, 300)], 10);
    let set = tasks(&[(1000, 100), (2000, 250)]);
    let load = Load { span: us(2000), demand: us(450), supply: us(580) };
    let verdict = meets(&[110, 1170]);
    assert_eq!(analyse(&set, &s), Analysis { method: Method::Exact, verdict, load });
    assert_eq!((load.permille(), load.idle()), (776, us(130)));
    assert_eq!(bound(&set, &s), meets(&[810, 1870]));
    let miss = Miss { task: 1, release: us(0), deadline: us(2000), undone: us(20) };
    assert_eq!(
        replay(&tasks(&[(1000, 100), (2000, 400)]), &s),
        Some((Method::Exact, Verdict::Misses(miss)))
    );
}

#[test]
fn what_is_released_inside_a_window_meets_all_of_its_interrupts() {
    // The second job would be complete at 1470 if the second window lost its 24 at 900.
    let windows = [(0, 510), (900, 1480)];
    let s = with_interrupts(2000, &windows, 0, 24);
    let analysis = analyse(&tasks(&[(1000, 470)]), &s);
    assert!(matches!(analysis.verdict, Verdict::Unproven { .. }), "{analysis:?}");
    // 1024 to 1480.
    let analysis = analyse(&tasks(&[(1000, 456)]), &s);
    assert_eq!((analysis.method, analysis.verdict), (Method::Bound, meets(&[480])));
    // A window that begins with the release meets them at its start at the worst.
    let s = with_interrupts(2000, &[(0, 510), (1000, 1480)], 0, 24);
    let analysis = analyse(&tasks(&[(1000, 456)]), &s);
    assert_eq!((analysis.method, analysis.verdict), (Method::Exact, meets(&[480])));
}

#[test]
fn responses_come_in_the_order_of_the_set() {
    let urgent = Task { period: us(1000), budget: us(100), priority: 9 };
    let other = Task { period: us(2000), budget: us(250), priority: 3 };
    let set = TaskSet::new(&[other, urgent]).unwrap();
    let s = supply(1000, &[(0, 300)], 0);
    assert_eq!(replay(&set, &s), Some((Method::Exact, meets(&[1150, 100]))));
    assert_eq!(bound(&set, &s), meets(&[1850, 800]));
}

#[test]
fn the_worst_response_need_not_be_the_first() {
    // Released at 0 it waits for nothing, released at 500 it waits for the window at 700.
    let s = supply(1000, &[(0, 100), (700, 800)], 0);
    assert_eq!(replay(&tasks(&[(500, 100)]), &s), Some((Method::Exact, meets(&[300]))));
}

#[test]
fn a_completion_at_the_deadline_is_in_time() {
    let s = supply(1000, &[(400, 700)], 0);
    assert_eq!(analyse(&tasks(&[(500, 100)]), &s).verdict, meets(&[500]));
    let (release, deadline) = (us(0), us(500));
    let miss = Miss { task: 0, release, deadline, undone: us(1) };
    assert_eq!(analyse(&tasks(&[(500, 101)]), &s).verdict, Verdict::Misses(miss));
}

#[test]
fn a_miss_names_the_job_and_what_it_lacks() {
    let s = supply(1000, &[(0, 300)], 0);
    assert_eq!(analyse(&tasks(&[(1000, 100), (2000, 400)]), &s).verdict, meets(&[100, 1300]));
    let miss = Miss { task: 1, release: us(0), deadline: us(2000), undone: us(1) };
    let verdict = analyse(&tasks(&[(1000, 100), (2000, 401)]), &s).verdict;
    assert_eq!(verdict, Verdict::Misses(miss));
}

#[test]
fn of_two_misses_at_one_instant_the_more_urgent_is_named() {
    let s = supply(1000, &[(0, 100)], 0);
    let miss = Miss { task: 1, release: us(0), deadline: us(1000), undone: us(10) };
    let set = tasks(&[(1000, 90), (1000, 20), (1000, 1)]);
    assert_eq!(analyse(&set, &s).verdict, Verdict::Misses(miss));
}

#[test]
fn with_all_of_the_processor_both_methods_are_the_textbook() {
    let s = supply(1000, &[(0, 1000)], 0);
    let set = tasks(&[(100, 40), (150, 40), (350, 100)]);
    assert_eq!(replay(&set, &s), Some((Method::Exact, meets(&[40, 80, 300]))));
    assert_eq!(bound(&set, &s), meets(&[40, 80, 300]));
}

#[test]
fn the_bound_starts_from_the_worst_phase() {
    // 700 us without a window, then as in the replay: 300 there, 700 without, 150 of the next.
    let set = tasks(&[(1000, 100), (2000, 250)]);
    assert_eq!(bound(&set, &supply(1000, &[(0, 300)], 0)), meets(&[800, 1850]));
}

#[test]
fn the_bound_may_refuse_what_the_replay_accepts() {
    // From 100 on there is nothing for 600 us; but no job is released at 100.
    let s = supply(1000, &[(0, 100), (700, 800)], 0);
    let unproven = Verdict::Unproven { task: 0, demand: us(100), supply: us(0) };
    assert_eq!(bound(&tasks(&[(500, 100)]), &s), unproven);
    assert_eq!(replay(&tasks(&[(500, 100)]), &s), Some((Method::Exact, meets(&[300]))));
}

#[test]
fn a_long_iteration_ends_with_the_period_or_a_refusal() {
    // The rival leaves 1 ns of every 100 us: millions of steps, if they were taken one by one.
    let rival = Task { period: us(100), budget: Nanos(99_999), priority: 2 };
    let slow = |budget| Task { period: us(1_000_000), budget: Nanos(budget), priority: 1 };
    let s = supply(1000, &[(0, 1000)], 0);
    let set = |budget| TaskSet::new(&[rival, slow(budget)]).unwrap();
    let responses = [Nanos(99_999), us(1_000_000)].into();
    assert_eq!(bound(&set(9_990), &s), Verdict::Meets { responses });
    let (demand, supply) = (Nanos(1_000_000_001), us(1_000_000));
    assert_eq!(bound(&set(10_001), &s), Verdict::Unproven { task: 1, demand, supply });
}

#[test]
fn thousands_of_windows_cost_steps_but_no_verdict() {
    // The rival leaves 16 ns of each window: 63 windows for the first of the others.
    let windows: Vec<(u64, u64)> = (0..4096).map(|i| (i * 100, i * 100 + 50)).collect();
    let s = supply(409_600, &windows, 0);
    let rival = Task { period: us(100), budget: Nanos(49_984), priority: 255 };
    let slow = |priority| Task { period: us(819_200_000), budget: us(1), priority };
    let mut set = vec![rival];
    set.extend((0..7).map(slow));
    let verdict = bound(&TaskSet::new(&set).unwrap(), &s);
    let Verdict::Meets { responses } = verdict else { panic!("{verdict:?}") };
    assert_eq!(responses[0], us(100).less(Nanos(16)));
    assert!(responses[1..].iter().all(|r| *r <= us(819_200_000)));
}

#[test]
fn more_jobs_than_the_limit_are_bounded_and_not_replayed() {
    let set = tasks(&[(100, 10)]);
    let method = |frame| analyse(&set, &supply(frame, &[(0, frame)], 0)).method;
    assert_eq!(method(100 * JOBS_MAX), Method::Exact);
    assert_eq!(method(100 * (JOBS_MAX + 1)), Method::Bound);
}

#[test]
fn the_load_is_that_of_a_hyperperiod() {
    let load = analyse(&tasks(&[(1000, 100), (2000, 250)]), &supply(1000, &[(0, 300)], 0)).load;
    assert_eq!(load, Load { span: us(2000), demand: us(450), supply: us(600) });
    assert_eq!((load.permille(), load.idle()), (750, us(150)));
    let load = analyse(&tasks(&[(1000, 301)]), &supply(1000, &[(0, 300)], 0)).load;
    assert_eq!((load.permille(), load.idle()), (1004, us(0)));
}

#[test]
fn the_load_of_an_endless_hyperperiod_is_that_of_a_frame() {
    let primes = [1_000_003, 1_000_033, 1_000_037];
    let task = |(priority, period)| Task { period: Nanos(period), budget: us(50), priority };
    let set = TaskSet::new(&(1..).zip(primes).map(task).collect::<Vec<_>>()).unwrap();
    let load = analyse(&set, &supply(1000, &[(0, 300)], 0)).load;
    // 50000 * 1000000 / 1000003 is 49999.85, the others are 49998.35 and 49998.15.
    let demand = Nanos(50_000 + 49_999 + 49_999);
    assert_eq!(load, Load { span: us(1000), demand, supply: us(300) });
    assert_eq!(load.permille(), 500);
}

#[test]
fn no_tasks_meet_all_their_deadlines() {
    let s = supply(1000, &[(0, 300)], 0);
    let analysis = analyse(&tasks(&[]), &s);
    assert_eq!(analysis.verdict, meets(&[]));
    assert_eq!((analysis.load.permille(), analysis.load.idle()), (0, us(300)));
    assert_eq!(bound(&tasks(&[]), &s), meets(&[]));
}
