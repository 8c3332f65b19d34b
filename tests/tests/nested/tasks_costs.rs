//! What the kernel costs, in instructions, which are the lab's nanoseconds.

use takt_test_programs::{Entry, Program, cyclic, us};

use super::tasks::{Row, plc};

#[test]
fn a_call_for_the_time_takes_120_instructions_at_most() {
    let program = Program::new("p").task(cyclic("main", us(1_000), 0, Entry::Times), 1_000);
    let file = plc("tasks-times", 1_000, 300, &[("p", program, "")]);
    let outcome = file.run("tasks-times").lasting("1500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // With three instructions of the program's for each call.
    let shortest = Row::of(&outcome, "p.main").number("exec-min");
    assert!(shortest <= 123 * 1_000, "{shortest}\n{}", outcome.output);
}
