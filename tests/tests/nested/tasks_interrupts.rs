//! Tasks that the interrupt of a device releases. The device is QEMU's `edu`, which asks when it is told to.

use takt_program::Elementary::Dword;
use takt_program::build::Event;
use takt_test_programs::{Entry, Program, cyclic, on, us};
use takt_tests::{File, Outcome};

use super::devices::{EDU, EDU_INTERRUPT};
use super::tasks::{Row, assert_on_time, lines};
use super::tasks_costs::GUARD_NS;

/// A run of an urgent task, of a program that has the device ask each 2 ms and serves it, and of a lesser task that
/// looks at its registers all the time, over several windows.
fn run(test: &str, guard: &str) -> Outcome {
    let urgent = Program::new("u").task(cyclic("urgent", us(1_000), 0, Entry::Nothing), 0);
    let serve = on("serve", Event::Interrupt("edu".into()), us(1_000), 2, Entry::CopyInputs);
    let drive = Program::new("d")
        .task(cyclic("raise", us(2_000), 1, Entry::FaultingOutputs), u64::MAX)
        .task(serve, 0)
        .input("status", Dword, 8)
        .output("raise", Dword, 0, 0)
        .output("acknowledge", Dword, 8, 1);
    let lesser = Program::new("l").task(cyclic("lesser", us(200_000), 9, Entry::Patterns), 400_000);
    let programs = [("urgent", urgent, ""), ("drive", drive, ""), ("lesser", lesser, "")];
    let io = [
        ("status", "0x24", "task = \"serve\""),
        ("raise", "0x60", ""),
        ("acknowledge", "0x64", ""),
    ];
    let io = io.map(|(point, offset, more)| {
        format!(
            "[[partition.io]]\nprogram = \"drive\"\npoint = {point:?}\nmmio = \"edu\"\n\
             offset = {offset:?}\n{more}\n"
        )
    });
    let lines = format!(
        "release_guard = {guard:?}\n{}{}{EDU}{EDU_INTERRUPT}name = \"edu\"\n",
        lines(test, &programs),
        io.concat()
    );
    let file = File::new("1ms").plc_with("plc", &lines).schedule("normal").window("plc", 0, 300);
    let outcome = file.run(test).lasting("2500ms").with("--device").with("edu").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
    assert_eq!(outcome.number("plc", "illegal_accesses"), 0, "{}", outcome.output);
    assert!(outcome.number("plc", "unfinished_windows") > 1_000, "{}", outcome.output);
    outcome
}

#[test]
fn an_interrupt_releases_its_task_once_and_moves_no_release() {
    let outcome = run("tasks-interrupts", "20us");
    let [raised, served] =
        ["drive.raise", "drive.serve"].map(|task| Row::of(&outcome, task).number("jobs"));
    // It passes through a thread of the host's, so now and then the device is told again before it has been served.
    assert!(raised > 900 && served * 10 > raised * 8 && served <= raised, "{served} of {raised}");
    Row::of(&outcome, "drive.serve").assert_in_time(700);
    Row::of(&outcome, "urgent.urgent").assert_in_time(1_900);
    assert_on_time(&outcome, "urgent.urgent");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_window_that_finds_a_task_and_an_interrupt_leaves_8_us_of_the_guard() {
    // Without a guard, what comes before the wait is seen as lateness.
    let outcome = run("tasks-interrupts-unguarded", "0us");
    let latest = outcome.number("plc", "release_latency_ns.max");
    println!("of a guard of {GUARD_NS} ns {} are left", GUARD_NS.saturating_sub(latest));
    assert!(latest <= GUARD_NS - 8_000, "{latest}\n{}", outcome.output);
}
