//! The smallest files that pass for the images of guests. Nothing in them could run.
#![allow(dead_code, reason = "not every test needs all of them")]

use takt_program::Elementary;

/// Little-endian fields at their offsets, in a file of so many bytes.
fn file(bytes: usize, fields: &[(usize, &[u8])]) -> Vec<u8> {
    let mut file = vec![0; bytes];
    for (at, field) in fields {
        file[*at..at + field.len()].copy_from_slice(field);
    }
    file
}

/// A PLC's image: an ELF header, and a segment of one instruction at 1 MiB.
pub fn plc() -> Vec<u8> {
    let start = 0x10_0000u64.to_le_bytes();
    let fields: [(usize, &[u8]); 14] = [
        (0, b"\x7fELF\x02\x01\x01"),
        (16, &[2, 0, 62, 0, 1]),  // EXEC, x86-64
        (24, &start),             // entry
        (32, &[64]),              // program headers
        (52, &[64, 0, 56, 0, 1]), // their size and number
        (64, &[1, 0, 0, 0, 5]),   // LOAD, readable and executable
        (72, &[120]),             // in the file
        (80, &start),
        (88, &start),
        (96, &[1]), // bytes in the file
        (104, &[1]),
        (112, &[1]),
        (120, &[0xf4]), // hlt
        (121, b"\nan image for tests\n"),
    ];
    file(142, &fields)
}

/// A Linux kernel: the header of a bzImage that takes the memory up to 24 MiB.
pub fn kernel() -> Vec<u8> {
    let fields: [(usize, &[u8]); 11] = [
        (0x1f1, &[1]), // sectors before the kernel
        (0x1fe, &[0x55, 0xaa]),
        (0x202, b"HdrS"),
        (0x206, &[0x0f, 0x02]), // boot protocol 2.15
        (0x211, &[1]),          // loaded high
        (0x214, &0x10_0000u32.to_le_bytes()),
        (0x22c, &0x7fff_ffffu32.to_le_bytes()),
        (0x236, &[1]), // 64-bit entry point
        (0x258, &0x100_0000u64.to_le_bytes()),
        (0x260, &0x80_0000u32.to_le_bytes()),
        (0x400, b"a kernel for tests\n"),
    ];
    file(0x600, &fields)
}

/// A program with two tasks, inputs and outputs of some types, and these ports.
pub fn program(ports: &[&str]) -> Vec<u8> {
    use takt_program::build::{Builder, Kind, Port, Task, Type, Variable};
    use takt_program::{Area, CodeOffset, Direction, Nanoseconds, TaskId};

    let mut program = Builder::new("tank");
    program.code = vec![0xc3];
    (program.state_bytes, program.input_bytes, program.output_bytes) = (8, 32, 8);
    for (name, period, priority) in [("fast", 1_000_000, 0), ("slow", 10_000_000, 1)] {
        let budget = Some(Nanoseconds(10_000));
        let task = Task::cyclic(name, Nanoseconds(period), CodeOffset(0));
        program.task(Task { budget, priority, ..task });
    }
    let bytes = program.elementary(Elementary::Byte);
    let block = program.ty(Type::new(12, Kind::Array { element: bytes, lower: 0, upper: 11 }));
    for name in ports {
        let name = (*name).to_owned();
        program.port(Port { name, direction: Direction::In, message_bytes: 8 });
    }
    let inputs = [
        ("level", Elementary::Real, 0, None),
        ("enable", Elementary::Bool, 4, Some(0)),
        ("count", Elementary::Uint, 6, None),
        ("stamp", Elementary::Time, 8, None),
        ("total", Elementary::Udint, 28, None),
    ];
    let outputs = [
        ("valve", Elementary::Real, 0, None, Some(0)),
        ("lamp", Elementary::Bool, 4, Some(0), Some(0)),
        ("alarm", Elementary::Bool, 4, Some(1), Some(1)),
        ("loose", Elementary::Byte, 5, None, None),
    ];
    for (name, ty, offset, bit) in inputs {
        let ty = program.elementary(ty);
        program.variable(Variable { bit, ..Variable::new(name, ty, Area::Input, offset) });
    }
    for (name, ty, offset, bit, writer) in outputs {
        let ty = program.elementary(ty);
        let variable = Variable::new(name, ty, Area::Output, offset);
        program.variable(Variable { bit, writer: writer.map(TaskId), ..variable });
    }
    program.variable(Variable::new("block", block, Area::Input, 16));
    program.variable(Variable::new("inner", bytes, Area::State, 0));
    program.build().unwrap()
}

/// A program with one task and these points.
fn example(name: &str, inputs: &[Point], outputs: &[Point]) -> Vec<u8> {
    use takt_program::build::{Builder, Task, Variable};
    use takt_program::{Area, CodeOffset, Nanoseconds};

    let mut program = Builder::new(name);
    program.code = vec![0xc3];
    (program.input_bytes, program.output_bytes) = (32, 16);
    let task = Task::cyclic("main", Nanoseconds(10_000_000), CodeOffset(0));
    program.task(Task { budget: Some(Nanoseconds(10_000)), ..task });
    for (area, points) in [(Area::Input, inputs), (Area::Output, outputs)] {
        for (name, ty, offset, bit) in points {
            let ty = program.elementary(*ty);
            program.variable(Variable { bit: *bit, ..Variable::new(name, ty, area, *offset) });
        }
    }
    program.build().unwrap()
}

/// Name, type, byte, and bit.
type Point = (&'static str, Elementary, u32, Option<u8>);

/// The points of the example `tank`.
pub fn tank() -> Vec<u8> {
    let real = |name, offset| (name, Elementary::Real, offset, None);
    let inputs = [real("level", 0), real("setpoint", 4), ("fresh", Elementary::Bool, 8, Some(0))];
    example("tank", &inputs, &[real("valve", 0), ("alarm", Elementary::Bool, 4, Some(0))])
}

/// The points of the example `plant`.
pub fn plant() -> Vec<u8> {
    let real = |name| (name, Elementary::Real, 0, None);
    example("plant", &[real("valve")], &[real("level")])
}

/// The points of the example `drive`.
pub fn drive() -> Vec<u8> {
    let inputs = [
        ("speed", Elementary::Real, 0, None),
        ("age", Elementary::Time, 8, None),
        ("told", Elementary::Udint, 16, None),
    ];
    let enable = ("enable", Elementary::Bool, 4, Some(0));
    example("drive", &inputs, &[("voltage", Elementary::Real, 0, None), enable])
}

/// The points of the example `motor`.
pub fn motor() -> Vec<u8> {
    let inputs = [("voltage", Elementary::Real, 0, None), ("enable", Elementary::Bool, 4, Some(0))];
    example("motor", &inputs, &[("speed", Elementary::Real, 0, None)])
}
