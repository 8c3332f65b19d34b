//! Outputs and channels have one writer.

use takt_program::build::{Port, Variable};
use takt_program::{Area, Direction, Elementary, TaskId};

use super::Case;
use super::images::{builder, task};

/// A program with two tasks and these outputs: type, byte, bit, and the task that writes them.
fn outputs(all: &[(Elementary, u32, Option<u8>, Option<u16>)]) -> Vec<u8> {
    let mut program = builder("a");
    program.task(task("other", 1_000_000, 1_000, 1));
    program.output_bytes = 64;
    for (n, (elementary, offset, bit, writer)) in all.iter().enumerate() {
        let ty = program.elementary(*elementary);
        let variable = Variable::new(&format!("out{n}"), ty, Area::Output, *offset);
        program.variable(Variable { bit: *bit, writer: writer.map(TaskId), ..variable });
    }
    program.build().unwrap()
}

fn case(image: &[u8]) -> Case {
    Case::new("outputs").file("a.plc", image).program("a.plc", "")
}

#[test]
fn each_bit_of_an_output_has_one_writing_task() {
    use Elementary::{Bool, Byte, Dint, Word};
    let good = [
        (Bool, 0, Some(0), Some(0)),
        (Bool, 0, Some(1), Some(1)),
        (Byte, 1, None, Some(1)),
        (Dint, 4, None, Some(0)),
        // The same bytes under another name, by the same task.
        (Word, 6, None, Some(0)),
        // Who writes it the image does not say.
        (Byte, 4, None, None),
    ];
    case(&outputs(&good)).good();
    let twice = [
        ([(Bool, 0, Some(3), Some(0)), (Bool, 0, Some(3), Some(1))], "at %QX0.3"),
        ([(Byte, 2, None, Some(0)), (Bool, 2, Some(7), Some(1))], "at %QX2.7"),
        ([(Dint, 4, None, Some(1)), (Byte, 7, None, Some(0))], "at %QB7"),
    ];
    for (outputs_of_two, place) in twice {
        let words = ["case.toml:12:9:", "two tasks of the program \"a\" write one output", place];
        case(&outputs(&outputs_of_two)).refused(&words);
    }
    // A long one hides behind a short one of the same task that begins later.
    let hidden = [(Dint, 0, None, Some(0)), (Byte, 0, None, Some(0)), (Byte, 3, None, Some(1))];
    case(&outputs(&hidden)).refused(&["\"out0\"", "\"out2\"", "at %QB3"]);
}

/// A program that uses this port.
fn with_port(name: &str, port: &str, direction: Direction, bytes: u32) -> Vec<u8> {
    let mut program = builder(name);
    program.port(Port { name: port.to_owned(), direction, message_bytes: bytes });
    program.build().unwrap()
}

const CHANNEL: &str = "[[channel]]\nname = \"level\"\nkind = \"sampling\"\nmessage_bytes = 16\n\
    refresh_period = \"10ms\"\nsource = \"plc:level\"\ndestinations = [\"host:level\"]\n\
    host_file = \"level.log\"\n";

#[test]
fn ports_are_ends_of_channels_of_their_direction_and_size() {
    let with = |image: &[u8]| {
        let case = Case::new("ports").file("a.plc", image).program("a.plc", "");
        case.ending(CHANNEL)
    };
    with(&with_port("a", "level", Direction::Out, 16)).good();
    let refused = |port: &str, direction, bytes, words: &[&str]| {
        with(&with_port("a", port, direction, bytes)).refused(words);
    };
    refused(
        "valve",
        Direction::Out,
        16,
        &["is no end of a channel", "\"plc:valve\" as the source"],
    );
    refused("valve", Direction::In, 16, &["\"plc:valve\" as a destination"]);
    refused("level", Direction::In, 16, &["goes the other way", "a destination"]);
    refused("level", Direction::Out, 8, &["messages of up to 8 bytes", "16, the `message_bytes`"]);
}

#[test]
fn a_port_belongs_to_one_program() {
    let image = with_port("a", "level", Direction::Out, 16);
    let case = Case::new("shared").file("a.plc", &image).program("a.plc", "");
    let case = case.program("a.plc", "name = \"b\"").ending(CHANNEL);
    case.refused(&["\"a\" and \"b\" both use the port \"level\"", "the other one"]);
}
