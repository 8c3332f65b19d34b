//! What all kinds of tasks together may cost each other, beside a Linux that compiles.

use takt_program::Direction;
use takt_program::build::Event;
use takt_test_programs::{Entry, Program, cyclic, freewheeling, on, us};
use takt_tests::{Outcome, long};

use super::tasks::{Row, assert_on_time, limited, plc};

/// The worst response of a task that `takt check` has promised, in ns.
fn promised(outcome: &Outcome, task: &str) -> u64 {
    let mut rows = outcome.output.lines().map(|line| line.split("  ").map(str::trim));
    let row = rows.find_map(|row| {
        let cells: Vec<&str> = row.filter(|cell| !cell.is_empty()).collect();
        (cells.len() == 7 && cells[0] == task).then_some(cells)
    });
    let row = row.unwrap_or_else(|| panic!("nothing is promised of {task}\n{}", outcome.output));
    let number = |unit: &str| row[5].strip_suffix(unit)?.parse::<u64>().ok();
    let ns = number("ns")
        .or_else(|| number("us").map(|us| us * 1_000))
        .or_else(|| number("ms").map(|ms| ms * 1_000_000));
    ns.unwrap_or_else(|| panic!("{row:?}"))
}

/// Counts up a word in a port for ever, some 50 times a second, while all else goes on.
const ORDERS: &str = "(n=0; while sleep 0.02; do n=$((n + 1)); takt-port write order --hex \
    $(printf %02x%02x000000000000 $((n % 256)) $((n / 256))); done) & ";

#[ignore = "takes long: scripts/test --all"]
#[test]
fn six_tasks_of_two_programs_span_windows_and_cost_the_most_urgent_nothing() {
    let fast = Program::new("fast")
        .task(limited(cyclic("control", us(250), 0, Entry::Destroy), 3), 0)
        .task(limited(cyclic("middle", us(1_000), 10, Entry::Work), 50), 20_000)
        .task(freewheeling("rest", 200, Entry::Work), 1_000);
    // 1 ms and 6 ms of work, less than 100 us at a time.
    let order = Event::Channel("order".into());
    let slow = Program::new("slow")
        .port("order", Direction::In)
        .init(Entry::Nothing)
        .task(limited(on("order", order, us(5_000), 5, Entry::ReadPort), 10), 0)
        .task(limited(cyclic("long", us(10_000), 20, Entry::Work), 1_100), 500_000)
        .task(limited(cyclic("longest", us(100_000), 30, Entry::Work), 6_600), 3_000_000);
    let programs = [("fast", fast, ""), ("slow", slow, "")];
    // Debian 13's kernel 6.12 needs 3 s to start here, and its compiler is done with the first object in the sixth.
    let other = std::env::var_os("TAKT_SUITE").is_some_and(|suite| !suite.is_empty());
    let short = if other { "7s" } else { "5s" };
    let (duration, jobs) = if long() { ("60s", 235_000) } else { (short, 16_000) };
    let channel = "[[channel]]\nname = \"order\"\nkind = \"sampling\"\nmessage_bytes = 8\n\
        refresh_period = \"1s\"\nsource = \"linux:order\"\ndestinations = [\"plc:order\"]";
    let file = plc("tasks-six", 250, 100, &programs).compiling_linux(ORDERS).lines(channel);
    let outcome = file.run("tasks-six").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
    outcome.assert_compiled();
    for (task, jobs) in [
        ("fast.control", jobs),
        ("fast.middle", jobs / 4),
        // Linux sends fewer on a kernel 6.12.
        ("slow.order", jobs / 800),
        ("slow.long", jobs / 40),
        ("slow.longest", jobs / 400),
    ] {
        let row = Row::of(&outcome, task);
        row.assert_in_time(jobs - 1);
        let (worst, promised) = (row.number("response"), promised(&outcome, task));
        assert!(worst <= promised, "{task}: {worst} ns, promised {promised}\n{}", outcome.output);
    }
    assert!(Row::of(&outcome, "slow.longest").number("response") > 1_000_000, "it spans windows");
    assert!(Row::of(&outcome, "fast.rest").number("jobs") > 1_000, "{}", outcome.output);
    assert_on_time(&outcome, "fast.control");
    outcome.assert_exact("plc");
}

#[test]
fn a_window_that_begins_in_a_call_costs_the_most_urgent_task_nothing() {
    // It is in the kernel for most of its time, and so are most ends of windows.
    let calls = cyclic("calls", us(600_000), 9, Entry::RandomCalls);
    let program = Program::new("p")
        .task(limited(cyclic("urgent", us(250), 0, Entry::Destroy), 3), 0)
        .task(calls, 200_000);
    let file = plc("tasks-in-call", 250, 100, &[("p", program, "")]);
    let outcome = file.run("tasks-in-call").lasting("3s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(outcome.number("plc", "unfinished_windows") > 2_000, "{}", outcome.output);
    let urgent = Row::of(&outcome, "p.urgent");
    urgent.assert_in_time(8_000);
    // The cost of a tick that comes behind the release.
    let [least, most] = ["exec-min", "exec-max"].map(|column| urgent.number(column));
    assert!(most < least + 500, "{least} to {most} ns\n{}", outcome.output);
    assert_on_time(&outcome, "p.urgent");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn registers_survive_preemption_at_any_instant() {
    // It takes a different time in each window, so the lesser task is never interrupted where it was before.
    let destroy = cyclic("destroy", us(250), 0, Entry::DestroyAtRandom);
    let urgent = Program::new("urgent").task(destroy, 0);
    let lesser = Program::new("lesser")
        .task(cyclic("one", us(100_000), 10, Entry::Patterns), 290_000)
        .task(cyclic("two", us(120_000), 5, Entry::Patterns), 30_000);
    let programs = [("urgent", urgent, ""), ("lesser", lesser, "")];
    let (duration, times) = if long() { ("36s", 100_000) } else { ("3s", 6_000) };
    let file = plc("tasks-patterns", 250, 100, &programs);
    let outcome = file.run("tasks-patterns").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // A changed register stops the program.
    let rows = ["lesser.one", "lesser.two"].map(|task| Row::of(&outcome, task));
    let jobs: u64 = rows.iter().map(|row| row.number("jobs")).sum();
    let preempted = rows.iter().map(|row| row.number("switches")).sum::<u64>() - jobs;
    assert!(jobs > 20 && preempted > times, "{preempted} in {jobs} jobs\n{}", outcome.output);
    assert_on_time(&outcome, "urgent.destroy");
}
