//! Tasks of programs in the analysis: how they are ranked, what is bounded, and what is refused.

use takt_program::build::{Builder, Event, Task, Variable, When};
use takt_program::{Area, CodeOffset, Elementary, Nanoseconds};

use super::Case;
use super::images::task;

const MS: u64 = 1_000_000;
const US: u64 = 1_000;

/// A program with these tasks.
fn program(name: &str, tasks: Vec<Task>) -> Vec<u8> {
    let mut builder = Builder::new(name);
    builder.code = vec![0xc3];
    let bool_type = builder.elementary(Elementary::Bool);
    builder.state_bytes = 8;
    builder.variable(Variable::new("go", bool_type, Area::State, 0));
    for task in tasks {
        builder.task(task);
    }
    builder.build().unwrap()
}

fn event(name: &str, minimum: u64, budget: u64, priority: u8) -> Task {
    let source = Event::Rise("go".to_owned());
    Task {
        when: When::Event { source, minimum: Nanoseconds(minimum) },
        ..task(name, 1, budget, priority)
    }
}

fn freewheeling(name: &str, priority: u8) -> Task {
    Task { priority, ..Task::new(name, When::Freewheeling, CodeOffset(0)) }
}

/// Windows of 100 us each 250 us.
fn case(name: &str) -> Case {
    Case::new(name).windows([50, 100, 250])
}

/// Name, place in the analysis, and worst response in us of each task, the most urgent first.
fn responses(case: &Case) -> Vec<(String, Option<u64>)> {
    let file = case.good();
    let plc = &file.partitions()[0];
    let met = plc.met_in(takt_scheduler::schedules::ScheduleId(0));
    let response = |at: usize| met.unwrap().responses[at].0 / US;
    let tasks = plc.program_tasks().iter();
    tasks.map(|task| (task.name.clone(), task.place.map(response))).collect()
}

fn named(expected: &[(&str, Option<u64>)]) -> Vec<(String, Option<u64>)> {
    expected.iter().map(|(name, response)| ((*name).to_owned(), *response)).collect()
}

#[test]
fn tasks_are_ranked_by_priority_then_program_then_place() {
    let a = vec![task("slow", 10 * MS, 100 * US, 5), task("fast", 250 * US, 9 * US, 0)];
    let b = vec![task("same", MS, 19 * US, 5), task("first", MS, 9 * US, 1)];
    let case = case("ranks").file("a.plc", &program("a", a)).file("b.plc", &program("b", b));
    let case = case.program("a.plc", "").program("b.plc", "");
    // Each job costs 1 us more, and tasks begin with a window. In each, two interrupts are allowed for: the host's tick, and the
    // kernel's timer for the window enforcer.
    let found = responses(&case);
    let order: Vec<&str> = found.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(order, ["a.fast", "b.first", "a.slow", "b.same"]);
    // fast: 10; first: 20; slow has 10 + 10 in front of it in the first window, and 10 in the next.
    let bounds: Vec<u64> = found.iter().map(|(_, bound)| bound.unwrap()).collect();
    assert!(bounds.is_sorted(), "{bounds:?}");
    assert!((bounds[0], bounds[1]) == (22, 32), "{bounds:?}");
    assert!((280..330).contains(&bounds[2]), "{bounds:?}");
}

#[test]
fn events_release_no_task_more_often_than_a_period_may_be_short() {
    let of = |minimum, budget| {
        let tasks = vec![task("fast", 250 * US, 9 * US, 0), event("go", minimum, budget, 1)];
        case("often").file("a.plc", &program("a", tasks)).program("a.plc", "")
    };
    // Without a budget it is not analysed, and held to it all the same.
    of(1, 0).refused(&[
        "case.toml:12:9:",
        "events may release the task \"a.go\" each 1ns",
        "at least 100us from one release to the next",
    ]);
    of(99 * US, 9 * US).refused(&["events may release the task"]);
    of(100 * US, 0).good();
}

#[test]
fn an_event_may_come_just_as_a_window_closes() {
    let tasks = vec![task("fast", 250 * US, 9 * US, 0), event("go", MS, 9 * US, 1)];
    let case = case("event").file("a.plc", &program("a", tasks)).program("a.plc", "");
    let found = responses(&case);
    assert!(found[0].1.unwrap() == 22 && found[1].1.unwrap() == 194, "{found:?}");
}

#[test]
fn below_a_task_without_a_budget_nothing_is_bounded() {
    let tasks = vec![
        task("fast", 250 * US, 9 * US, 0),
        task("free", MS, 0, 1),
        task("slow", 10 * MS, US, 2),
        freewheeling("rest", 0),
    ];
    let case = case("no-budget").file("a.plc", &program("a", tasks)).program("a.plc", "");
    let found = responses(&case);
    assert!(found[0].1.is_some());
    assert_eq!(found[1..], named(&[("a.free", None), ("a.slow", None), ("a.rest", None)]));
    case.good();
}

#[test]
fn what_cannot_be_in_time_is_refused_at_its_image() {
    let tasks = vec![task("fast", 250 * US, 9 * US, 0), task("big", MS, 900 * US, 1)];
    let late = case("late").file("a.plc", &program("a", tasks)).program("a.plc", "");
    late.refused(&[
        "case.toml:12:9:",
        "the task \"a.big\" of \"plc\" is not proven",
        "a budget of at most",
    ]);
    let mut due = task("due", 250 * US, 50 * US, 0);
    due.deadline = Some(Nanoseconds(55 * US));
    let due = |deadline: u64| {
        let mut due = due.clone();
        due.deadline = Some(Nanoseconds(deadline * US));
        case("due").file("a.plc", &program("a", vec![due])).program("a.plc", "")
    };
    assert_eq!(responses(&due(65)).len(), 1);
    due(55).refused(&["\"a.due\"", "in 55us it and the more urgent tasks may ask for 51us"]);
}

#[test]
fn a_job_may_take_as_many_budgets_as_its_sensitivity_lets_it() {
    let with = |sensitivity: u16| {
        let fast = Task { sensitivity, ..task("fast", 250 * US, 9 * US, 0) };
        let tasks = vec![fast, task("slow", MS, 9 * US, 1)];
        case("sensitive").file("a.plc", &program("a", tasks)).program("a.plc", "")
    };
    assert_eq!(responses(&with(0)), named(&[("a.fast", Some(22)), ("a.slow", Some(32))]));
    assert_eq!(responses(&with(2)), named(&[("a.fast", Some(40)), ("a.slow", Some(50))]));
    // A window gives 88, of which 1 is for switching.
    with(9).refused(&["\"a.fast\"", "may ask for 91us", "a budget of at most 8us;"]);
    with(40).refused(&["a budget of 41 times its size", "at most the period, less 1us"]);
}

#[test]
fn releases_in_the_middle_of_a_window_are_refused() {
    let with = |period: u64, offset: u64, windows: [u64; 3]| {
        let mut task = task("t", period * US, 5 * US, 0);
        let (period, offset) = (Nanoseconds(period * US), Nanoseconds(offset * US));
        task.when = When::Cyclic { period, offset };
        let case = Case::new("middle").windows(windows).file("a.plc", &program("a", vec![task]));
        case.program("a.plc", "")
    };
    let middle = ["jobs of the task \"a.t\"", "in the middle of a window", "by the key `period`"];
    with(250, 0, [0, 100, 250]).good();
    with(1000, 500, [0, 100, 250]).good();
    // Between two windows it is seen at the second: as late as in the worst phase.
    let bound = responses(&with(1000, 150, [0, 100, 250]))[0].1.unwrap();
    assert!(bound > 150, "{bound}");
    with(1000, 50, [0, 100, 250]).refused(&middle);
    with(250, 0, [0, 300, 1000]).refused(&middle);
    // A period that wanders through the windows, and one that does so in tiny steps.
    with(1001, 0, [0, 300, 1000]).refused(&middle);
    let mut odd = task("t", 1_000_001, 5 * US, 0);
    odd.budget = None;
    let odd = Case::new("odd").file("a.plc", &program("a", vec![odd])).program("a.plc", "");
    odd.refused(&middle);
}

#[test]
fn periods_budgets_and_numbers_have_bounds() {
    let one = |name: &str, tasks: Vec<Task>| {
        case(name).file("a.plc", &program("a", tasks)).program("a.plc", "")
    };
    one("short", vec![task("t", 50 * US, US, 0)]).refused(&["the task \"a.t\"", "100 us to a day"]);
    let full = vec![task("t", 250 * US, 250 * US, 0)];
    one("full", full).refused(&["a budget of at most the period, less 1us"]);
    let mut many = case("many-tasks");
    for n in 0..5 {
        let tasks = (0..16).map(|t| task(&format!("t{t}"), MS, US, t)).collect();
        many = many.file(&format!("p{n}.plc"), &program(&format!("p{n}"), tasks));
        many = many.program(&format!("p{n}.plc"), "");
    }
    many.refused(&["case.toml:24:9:", "have 80 tasks", "at most 64 tasks"]);
    let events = |each: &[u8]| {
        let mut many = case("many-events");
        for (n, count) in each.iter().enumerate() {
            let tasks = (0..*count).map(|t| event(&format!("t{t}"), 10 * MS, US, t)).collect();
            many = many.file(&format!("p{n}.plc"), &program(&format!("p{n}"), tasks));
            many = many.program(&format!("p{n}.plc"), "");
        }
        many
    };
    let most = "at most 32 event tasks, in a partition";
    events(&[11, 11, 11]).refused(&["case.toml:18:9:", "have 33 event tasks", most]);
    events(&[11, 11, 10]).good();
}
