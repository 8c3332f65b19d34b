//! What releases event tasks.

use takt_abi::io::{EVENT, kind};
use takt_plan::check::report;
use takt_program::build::{Builder, Event, Task, When};
use takt_program::{CodeOffset, Nanoseconds};

use super::Case;
use super::images::builder;

/// A task that waits for this, at most each 1 ms, for 10 us.
fn waiting(program: &mut Builder, name: &str, source: Event) {
    let when = When::Event { source, minimum: Nanoseconds(1_000_000) };
    let task = Task::new(name, when, CodeOffset(0));
    program.task(Task { budget: Some(Nanoseconds(10_000)), priority: 1, ..task });
}

/// A partition, in a folder of this name, with a program whose second and further tasks wait for these.
fn case(name: &str, sources: &[Event], interrupts: &str) -> Case {
    let mut program = builder("a");
    for (number, source) in sources.iter().enumerate() {
        waiting(&mut program, &format!("e{number}"), source.clone());
    }
    let case = Case::new(name).file("a.plc", &program.build().unwrap());
    case.program("a.plc", "").with(interrupts)
}

fn interrupt(name: &str) -> Event {
    Event::Interrupt(name.to_owned())
}

const ENCODER: &str = "[[partition.interrupt]]\nname = \"encoder\"\nvector = 64\nuio = \"uio0\"";

#[test]
fn an_interrupt_releases_one_task_by_its_name() {
    let file = case("released", &[interrupt("encoder")], ENCODER).good();
    let table = file.partitions()[0].io_table();
    let entry = table.mappings[0];
    assert_eq!((table.count, entry.direction, entry.kind), (1, EVENT, kind::INTERRUPT));
    assert_eq!((entry.program, entry.task, entry.place), (0, 1, 64));
    let text = report(&file);
    for line in [
        "  24us of each window are kept for interrupts that release tasks, and letting them in (4 x 6us)\n",
        "interrupt 64 encoder: of uio0\n",
    ] {
        assert!(text.contains(line), "no {line:?} in\n{text}");
    }
    // Without such a task nothing is kept for it.
    assert!(!report(&case("released", &[], ENCODER).good()).contains("letting them in"));
}

#[test]
fn what_the_guest_cannot_wait_for_is_refused() {
    let refused = |sources: &[Event], interrupts: &str, words: &[&str]| {
        case("unreleased", sources, interrupts).refused(words);
    };
    let doorbell = Event::Doorbell("x".to_owned());
    refused(&[doorbell], "", &["waits for a doorbell, which only a Linux has", "`channel` sees"]);
    let missing = ["waits for the interrupt \"x\", which is not there", "`name = \"x\"`"];
    refused(&[interrupt("x")], ENCODER, &missing);
    let without_name = ENCODER.replace("name = \"encoder\"\n", "");
    refused(&[interrupt("encoder")], &without_name, &["which is not there"]);
    let twice = [interrupt("encoder"), interrupt("encoder")];
    refused(&twice, ENCODER, &["the task \"e1\"", "a second task waits for"]);
    let ticks = ENCODER.replace("64", "32");
    refused(&[interrupt("encoder")], &ticks, &["the starts of windows", "33 to 254"]);
    let name = ENCODER.replace("encoder", "The Encoder");
    refused(&[], &name, &["is not a word of the allowed form"]);
}
