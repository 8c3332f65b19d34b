//! What the kernel costs, in instructions, which are the lab's nanoseconds.

use takt_program::ObjectKind;
use takt_test_programs::{Entry, Program, cyclic, us};
use takt_tests::{File, Outcome};

use super::tasks::{Row, lines, object, plc};

/// The guard whose length the waiting is measured against.
pub const GUARD_NS: u64 = 20_000;

/// A PLC alone, without a guard: what lies between a window's beginning and the instant at which the kernel would wait
/// for the release is seen as the lateness of the release.
fn unguarded(test: &str, program: Program) -> Outcome {
    let lines = lines(test, &[("p", program, "")]);
    let lines = format!("release_guard = \"0us\"\n{lines}");
    let file = File::new("1ms").plc_with("plc", &lines).schedule("normal").window("plc", 0, 300);
    let outcome = file.run(test).lasting("2s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome
}

fn urgent() -> Program {
    Program::new("p").task(cyclic("urgent", us(1_000), 0, Entry::Nothing), 0)
}

#[test]
fn a_window_that_interrupts_a_task_leaves_11_us_to_wait_for_the_release() {
    let idle = unguarded("tasks-idle", urgent());
    // In the middle of its work at each window's start.
    let endless = cyclic("lesser", us(3_600_000_000), 9, Entry::Endless);
    let ticked = unguarded("tasks-ticked", urgent().task(endless, 0));
    let unfinished = ticked.number("plc", "unfinished_windows");
    assert!(unfinished > 1_900, "{unfinished}\n{}", ticked.output);
    let of = |outcome: &Outcome, key| outcome.number("plc", &format!("release_latency_ns.{key}"));
    // With what the kernel does for the task that it interrupts: it saves its registers and charges it.
    let more = of(&ticked, "p50") - of(&idle, "p50");
    let most = if ticked.is_on_kernel("6.1.") { 1_400 } else { 1_800 };
    assert!(more <= most, "{more}\n{}", ticked.output);
    let latest = of(&ticked, "max");
    println!(
        "{more} ns more; of a guard of {GUARD_NS} ns {} are left",
        GUARD_NS.saturating_sub(latest)
    );
    assert!(latest <= GUARD_NS - 11_000, "{latest}\n{}", ticked.output);
}

#[test]
fn a_window_that_begins_in_a_call_leaves_8_us_to_wait_for_the_release() {
    // The kernel finds the window itself when the call is over. Some of the calls print lines.
    let calls = cyclic("lesser", us(3_600_000_000), 9, Entry::RandomCalls);
    let called = unguarded("tasks-called", urgent().task(calls, 1_000_000_000));
    let unfinished = called.number("plc", "unfinished_windows");
    assert!(unfinished > 1_900, "{unfinished}\n{}", called.output);
    let [least, half, latest] =
        ["min", "p50", "max"].map(|key| called.number("plc", &format!("release_latency_ns.{key}")));
    println!("of a guard of {GUARD_NS} ns {} are left", GUARD_NS.saturating_sub(latest));
    // So more than half of the windows do without the interrupt, which takes longer than the rest of most calls.
    assert!(half < least + 1_000, "{least} {half}\n{}", called.output);
    assert!(latest <= GUARD_NS - 8_000, "{latest}\n{}", called.output);
}

/// The number with which a program stops itself in a run.
fn told(test: &str, program: Program) -> u64 {
    let outcome = plc(test, 1_000, 300, &[("p", program, "")]).run(test).lasting("1s").run();
    let code = outcome
        .output
        .lines()
        .find_map(|line| line.split_once("stops itself, code ")?.1.parse().ok());
    code.unwrap_or_else(|| panic!("it did not stop itself\n{}", outcome.output))
}

#[test]
fn a_switch_from_a_task_to_another_takes_300_instructions_at_most() {
    let stamp = Program::new("p").task(cyclic("urgent", us(1_000), 0, Entry::Stamp), 0);
    let since = cyclic("lesser", us(1_000), 9, Entry::SinceStamp);
    let next = told("tasks-next", stamp.task(since, 200));
    let waits = Program::new("p")
        .object(object("flag", ObjectKind::Flags))
        .task(cyclic("urgent", us(1_000), 0, Entry::AwaitStamp), 200)
        .task(cyclic("lesser", us(1_000), 9, Entry::StampAndSet), 0);
    let woken = told("tasks-woken", waits);
    println!("a waiting task goes on after {woken} instructions, a job begins after {next}");
    assert!(woken <= 300 && next <= 300, "{woken} {next}");
}

#[test]
fn one_task_that_says_done_costs_the_host_what_a_plc_without_tasks_does() {
    let tasks = unguarded("tasks-alone", urgent());
    let plain = File::new("1ms").plc("plc", None, "release_guard = \"0us\"");
    let plain = plain.schedule("normal").window("plc", 0, 300).run("tasks-plain");
    let plain = plain.lasting("2s").run();
    for key in ["wake_up_latency_ns.p50", "wake_up_latency_ns.max", "entry_ns.max"] {
        let [tasks, plain] = [&tasks, &plain].map(|outcome| outcome.number("plc", key));
        assert!(tasks <= plain + 10, "{key}: {tasks}, and {plain} without tasks");
    }
    assert_eq!(tasks.number("plc", "unfinished_windows"), 0, "{}", tasks.output);
}

#[test]
fn a_call_for_the_time_takes_120_instructions_at_most() {
    let program = Program::new("p").task(cyclic("main", us(1_000), 0, Entry::Times), 1_000);
    let file = plc("tasks-times", 1_000, 300, &[("p", program, "")]);
    let outcome = file.run("tasks-times").lasting("1500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // With three instructions of the program's for each call.
    let longest = Row::of(&outcome, "p.main").number("exec-max");
    assert!(longest <= 123 * 1_000, "{longest}\n{}", outcome.output);
}
