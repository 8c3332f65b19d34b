//! Variables that share bytes stay as they are, or the change is refused.

use std::fs;

use takt_change::make::{Change, Refusal};
use takt_program::build::{Builder, Kind, Task, Type, Variable};
use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds};

/// A version with an array of bytes and a name for each of its elements; the last element has this type.
fn program(names: u32, last: Elementary) -> Vec<u8> {
    let mut image = Builder::new("a");
    image.code = vec![0xc3];
    image.state_bytes = names + 8;
    let byte = image.elementary(Elementary::Byte);
    let last = image.elementary(last);
    let kind = Kind::Array { element: byte, lower: 0, upper: i64::from(names) + 7 };
    let all = image.ty(Type::new(names + 8, kind));
    image.variable(Variable::new("All", all, Area::State, 0));
    for at in 0..names {
        let ty = if at + 1 == names { last } else { byte };
        image.variable(Variable::new(&format!("Part{at}"), ty, Area::State, at));
    }
    let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
    task.budget = Some(Nanoseconds(10_000));
    image.task(task);
    image.build().unwrap()
}

fn refusals(old: &[u8], new: &[u8]) -> Vec<Refusal> {
    Change::between(&Image::parse(old).unwrap(), &Image::parse(new).unwrap()).refusals
}

#[test]
fn one_that_begins_anew_is_told_with_the_one_that_it_shares_bytes_with() {
    let (old, new) = (program(9, Elementary::Byte), program(9, Elementary::Ulint));
    assert_eq!(refusals(&old, &old), []);
    let (one, other) = ("All".to_owned(), "Part8".to_owned());
    let told = Refusal::Shared { one, other };
    assert_eq!(refusals(&old, &new), [told.clone(), told]);
}

/// Time that this thread has run for so far, in ns (the kernel's Documentation/scheduler/sched-stats.rst): what else the
/// machine does is not in it.
fn run_time() -> u64 {
    let text = fs::read_to_string("/proc/thread-self/schedstat").unwrap();
    text.split(' ').next().unwrap().parse().unwrap()
}

/// Takt compares in the thread that feeds the host's watchdog.
#[test]
fn eight_times_as_many_take_no_square_of_the_time() {
    let [few, many] = [2_500, 20_000].map(|names| {
        let image = program(names, Elementary::Byte);
        let begin = run_time();
        assert_eq!(refusals(&image, &image), []);
        run_time() - begin
    });
    // A square would be 64 times as long.
    assert!(many < 24 * few, "{few} ns, {many} ns");
}
