//! Whether a version with other budgets is let in.

use takt_plan::Admission;
use takt_program::build::{Builder, Task};
use takt_program::{Image, Nanoseconds};

use super::Case;
use super::images::task;

/// A program without tasks.
fn empty(name: &str) -> Builder {
    let mut program = Builder::new(name);
    program.code = vec![0xc3];
    program
}

/// The image of a program with these tasks: name, period and budget in us, and priority.
fn program(name: &str, tasks: &[(&str, u64, u64, u8)]) -> Vec<u8> {
    let mut program = empty(name);
    for &(name, period, budget, priority) in tasks {
        program.task(task(name, period * 1_000, budget * 1_000, priority));
    }
    program.build().unwrap()
}

fn parsed(bytes: &[u8]) -> Image<'_> {
    Image::parse(bytes).unwrap()
}

#[test]
fn a_version_counts_with_the_larger_budgets_and_the_shorter_deadlines_of_all_that_may_run() {
    let a = program("a", &[("fast", 1_000, 60, 0), ("slow", 2_000, 30, 2)]);
    let b = program("b", &[("main", 1_000, 60, 1)]);
    let file = Case::new("admission")
        .file("a.plc", &a)
        .file("b.plc", &b)
        .program("a.plc", "")
        .program("b.plc", "")
        .good();
    let admission = Admission::of(&file, file.partitions()[0].id());
    let check = |a: &[&[u8]], b: &[&[u8]]| {
        let a = a.iter().map(|bytes| (0, parsed(bytes)));
        admission.check(&a.chain(b.iter().map(|bytes| (1, parsed(bytes)))).collect::<Vec<_>>())
    };
    assert_eq!(check(&[&a], &[&b]), Ok(()));
    let other = |fast, slow| program("a", &[("fast", 1_000, fast, 0), ("slow", 2_000, slow, 2)]);
    assert_eq!(check(&[&a, &other(70, 40)], &[&b]), Ok(()));
    let said = check(&[&a, &other(60, 300)], &[&b]).unwrap_err();
    assert!(
        said.starts_with("with the larger budgets of both versions, in the schedule \"normal\" the task \"a.slow\" "),
        "{said}"
    );
    let said = check(&[&a, &other(140, 30)], &[&b]).unwrap_err();
    assert!(said.contains("the task \"b.main\" "), "{said}");
    // Each fits, but jobs of both may be in one window, and a roll-back leads to the other one.
    let (one, two) = (other(20, 150), other(110, 20));
    assert_eq!((check(&[&one], &[&b]), check(&[&two], &[&b])), (Ok(()), Ok(())));
    assert!(check(&[&one, &two], &[&b]).is_err());

    // Without a budget nothing below is bounded.
    let none = program("a", &[("fast", 1_000, 0, 0), ("slow", 2_000, 30, 2)]);
    assert_eq!(check(&[&a, &none], &[&b]), Err("the task \"a.fast\" has no budget".to_owned()));
    // A budget beyond the period is none that a task can have.
    assert!(check(&[&a, &other(1_000, 30)], &[&b]).is_err());
}

/// A dot belongs to a name like any other character.
#[test]
fn a_task_whose_name_ends_with_that_of_another_has_its_own_budget() {
    let with =
        |axis, fast| program("a", &[("fast", 1_000, fast, 0), ("axis.fast", 1_000, axis, 1)]);
    let old = with(30, 30);
    let file = Case::new("dots").file("a.plc", &old).program("a.plc", "").good();
    let admission = Admission::of(&file, file.partitions()[0].id());
    let check = |new: &[u8]| admission.check(&[(0, parsed(&old)), (0, parsed(new))]);
    assert_eq!(check(&with(40, 30)), Ok(()));
    let said = check(&with(900, 30)).unwrap_err();
    assert!(said.contains("the task \"a.axis.fast\" "), "{said}");
}

/// A version may let its jobs exceed their budget more often.
#[test]
fn a_larger_sensitivity_counts_like_a_larger_budget() {
    let with = |sensitivity: u16| {
        let mut program = empty("a");
        let fast = task("fast", 1_000_000, 60_000, 0);
        program.task(Task { sensitivity, ..fast });
        program.build().unwrap()
    };
    let old = with(0);
    let file = Case::new("sensitive").file("a.plc", &old).program("a.plc", "").good();
    let admission = Admission::of(&file, file.partitions()[0].id());
    let check = |new: &[u8]| admission.check(&[(0, parsed(&old)), (0, parsed(new))]);
    assert_eq!(check(&with(2)), Ok(()));
    let said = check(&with(4)).unwrap_err();
    assert!(said.contains("may ask for 301us"), "{said}");
}

#[test]
fn a_shorter_deadline_is_reckoned_with() {
    let with = |deadline: u64| {
        let mut program = empty("a");
        let fast = task("fast", 1_000_000, 100_000, 0);
        program.task(fast);
        let slow = task("slow", 1_000_000, 40_000, 1);
        program.task(Task { deadline: Some(Nanoseconds(deadline * 1_000)), ..slow });
        program.build().unwrap()
    };
    let old = with(1_000);
    let file = Case::new("deadline").file("a.plc", &old).program("a.plc", "").good();
    let admission = Admission::of(&file, file.partitions()[0].id());
    let check = |new: &[u8]| admission.check(&[(0, parsed(&old)), (0, parsed(new))]);
    assert_eq!(check(&with(250)), Ok(()));
    let said = check(&with(130)).unwrap_err();
    assert!(said.contains("the task \"a.slow\" "), "{said}");
}
