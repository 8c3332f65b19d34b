//! An image with something of everything, for the tests to read and to break.

use takt_program::build::{
    Builder, Event, Field, Kind, Line, Object, Place, Port, Task, Trap, Type, Variable, When,
};
use takt_program::{
    Area, CodeOffset, Direction, Elementary, Flags, Nanoseconds, ObjectKind, TrapKind, Version,
};

pub const MS: u64 = 1_000_000;

/// Fills a builder with something of everything.
pub fn full() -> Builder {
    let mut b = Builder::new("Mixer");
    b.version = Version { major: 1, minor: 2, patch: 3 };
    b.category = 7;
    b.init = Some(CodeOffset(1));
    b.code = vec![0xc3; 40];
    b.constants = vec![1, 2, 3, 4];
    b.state = vec![5; 10];
    b.state_bytes = 5000;
    (b.input_bytes, b.output_bytes, b.marker_bytes) = (16, 8, 4);
    let bool = b.elementary(Elementary::Bool);
    let real = b.elementary(Elementary::Real);
    let dint = b.elementary(Elementary::Dint);
    let text = b.ty(Type::new(81, Kind::String { length: 80 }));
    let row = b.ty(Type::new(12, Kind::Array { element: dint, lower: -1, upper: 1 }));
    let field = |name: &str, ty, offset| Field { name: name.into(), ty, offset };
    let fields = vec![field("on", bool, 0), field("row", row, 4), field("text", text, 16)];
    let block = b.ty(Type::new(100, Kind::FunctionBlock { fields }).named("Mix"));
    let values = vec![("red".into(), -1), ("green".into(), 1)];
    let colour =
        b.ty(Type::new(1, Kind::Enumeration { base: Elementary::Sint, values }).named("Colour"));
    b.ty(Type::new(4, Kind::Subrange { base: Elementary::Dint, low: -5, high: 5 }));
    b.ty(Type::new(8, Kind::Reference { target: block }));
    let place = Place { file: "src/mixer.st".into(), line: 12, column: 3 };
    let at = |name: &str, ty, area, offset| Variable::new(name, ty, area, offset);
    b.variable(Variable {
        declared: Some(place.clone()),
        ..at("main.mix", block, Area::State, 0).with(Flags::RETAIN)
    });
    b.variable(at("Main.colour", colour, Area::State, 4999));
    b.variable(Variable { bit: Some(3), ..at("start", bool, Area::Input, 15).with(Flags::INPUT) });
    b.variable(at("level", real, Area::Output, 4).with(Flags::OUTPUT.with(Flags::FORCEABLE)));
    b.variable(at("gain", real, Area::Constant, 0));
    b.task(Task {
        priority: 1,
        budget: Some(Nanoseconds(MS)),
        deadline: Some(Nanoseconds(5 * MS)),
        stack_bytes: 5000,
        sensitivity: 2,
        ..Task::cyclic("control", Nanoseconds(10 * MS), CodeOffset(2))
    });
    let event = |source| When::Event { source, minimum: Nanoseconds(MS) };
    b.task(Task::new("order", event(Event::Channel("orders".into())), CodeOffset(3)));
    b.task(Task::new("edge", event(Event::Rise("START".into())), CodeOffset(4)));
    b.task(Task { priority: 255, ..Task::new("rest", When::Freewheeling, CodeOffset(5)) });
    b.object(Object { name: "lock".into(), kind: ObjectKind::Semaphore { ceiling: 1 } });
    b.object(Object {
        name: "jobs".into(),
        kind: ObjectKind::Queue { message_bytes: 16, depth: 4 },
    });
    b.object(Object { name: "last".into(), kind: ObjectKind::Mailbox { bytes: 8 } });
    b.object(Object { name: "bits".into(), kind: ObjectKind::Flags });
    b.port(Port { name: "orders".into(), direction: Direction::In, message_bytes: 64 });
    b.trap(Trap { at: CodeOffset(20), kind: TrapKind::Bounds, place: Some(place) });
    b.trap(Trap { at: CodeOffset(10), kind: TrapKind::User, place: None });
    b.line(Line { at: CodeOffset(8), file: "src/mixer.st".into(), line: 9 });
    b.line(Line { at: CodeOffset(16), file: String::new(), line: 0 });
    b
}

/// The simplest program.
#[allow(dead_code, reason = "not every test file needs it")]
pub fn minimal() -> Builder {
    let mut b = Builder::new("m");
    b.code = vec![0xc3];
    b.task(Task::cyclic("t", Nanoseconds(MS), CodeOffset(0)));
    b
}
