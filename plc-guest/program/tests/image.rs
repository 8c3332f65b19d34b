//! What is built is read again, and what breaks a rule is refused by name.

mod common;

use common::{MS, full, minimal};
use takt_program::build::{Builder, Event, Kind, Object, Port, Task, Type, Variable, When};
use takt_program::{
    Area, CodeOffset, Defect, Direction, Elementary, EventSource, Flags, Image, Nanoseconds,
    ObjectKind, SectionKind, TaskId, TaskKind, TrapKind, TypeId, TypeKind, address, signature,
};

#[test]
fn a_program_is_read_as_it_was_built() {
    let file = full().build().unwrap();
    let image = Image::verify(&file).unwrap();
    assert_eq!((image.name(), image.category()), ("Mixer", 7));
    assert_eq!(image.version().to_string(), "1.2.3");
    assert_eq!(image.init(), Some(CodeOffset(1)));
    assert_eq!((image.code(), image.constants()), (&[0xc3; 40][..], &[1, 2, 3, 4][..]));
    assert_eq!((image.state(), image.state_bytes()), (&[5; 10][..], 5000));
    assert_eq!(image.constants_address(), address::CODE + 4096);
    assert_eq!(image.area_bytes(Area::Input), 16);
    for kind in [SectionKind::Code, SectionKind::Constants, SectionKind::State] {
        assert_eq!(image.file_offset(kind) % 4096, 0, "{kind:?}");
    }
}

#[test]
fn tasks_are_read_as_they_were_built() {
    let file = full().build().unwrap();
    let image = Image::verify(&file).unwrap();
    let control = image.task(TaskId(0)).unwrap();
    let (period, offset) = (Nanoseconds(10 * MS), Nanoseconds(0));
    assert_eq!(control.kind, TaskKind::Cyclic { period, offset });
    assert_eq!((control.priority, control.sensitivity, control.entry), (1, 2, CodeOffset(2)));
    assert_eq!(control.budget, Some(Nanoseconds(MS)));
    assert_eq!(control.deadline, Some(Nanoseconds(5 * MS)));
    assert_eq!(control.stack_bytes, 8192, "stacks are whole pages");
    let minimum = Nanoseconds(MS);
    let order = image.task(TaskId(1)).unwrap();
    assert_eq!(order.kind, TaskKind::Event { source: EventSource::Channel("orders"), minimum });
    assert_eq!(order.deadline, Some(minimum), "none given: before the next release");
    let rest = image.task(TaskId(3)).unwrap();
    assert_eq!((rest.kind, rest.budget, rest.deadline), (TaskKind::Freewheeling, None, None));
    assert!(image.task(TaskId(4)).is_none());
    assert_eq!(image.tasks().len(), 4);
}

#[test]
fn variables_are_sorted_and_found_in_any_case() {
    let file = full().build().unwrap();
    let image = Image::verify(&file).unwrap();
    let names: Vec<_> = image.variables().map(|variable| variable.name).collect();
    assert_eq!(names, ["gain", "level", "Main.colour", "main.mix", "start"]);
    let mix = image.variable("MAIN.Mix").unwrap();
    assert_eq!((mix.bytes, mix.flags), (100, Flags::RETAIN));
    assert_eq!(mix.declared.unwrap().line, 12);
    let start = image.variable("start").unwrap();
    assert_eq!((start.bit, start.address(&image)), (Some(3), address::INPUT + 15));
    assert!(image.variable("gain").unwrap().flags.has(Flags::CONSTANT));
    for absent in ["", "a", "levels", "zzz"] {
        assert!(image.variable(absent).is_none(), "{absent}");
    }
}

#[test]
fn types_are_read_with_their_parts() {
    let file = full().build().unwrap();
    let image = Image::verify(&file).unwrap();
    let mix = image.type_of(image.variable("main.mix").unwrap().ty).unwrap();
    assert_eq!((mix.name, mix.kind, mix.depth), ("Mix", TypeKind::FunctionBlock, 3));
    let fields: Vec<_> = image.fields(&mix).map(|field| (field.name, field.offset)).collect();
    assert_eq!(fields, [("on", 0), ("row", 4), ("text", 16)]);
    let colour = image.type_of(image.variable("main.colour").unwrap().ty).unwrap();
    let values: Vec<_> = image.values(&colour).map(|value| (value.name, value.value)).collect();
    assert_eq!(values, [("red", -1), ("green", 1)]);
    assert_eq!(image.fields(&colour).len(), 0, "its values are no fields");
}

#[test]
fn a_place_in_the_code_leads_to_the_source() {
    let file = full().build().unwrap();
    let image = Image::verify(&file).unwrap();
    let trap = image.trap(CodeOffset(20)).unwrap();
    assert_eq!((trap.kind, trap.place.unwrap().column), (TrapKind::Bounds, 3));
    assert!(image.trap(CodeOffset(21)).is_none(), "a trap is one instruction");
    assert_eq!(image.line(CodeOffset(15)).unwrap().line, 9, "a line goes on to the next entry");
    assert!(image.line(CodeOffset(7)).is_none(), "before the first entry");
    assert!(image.line(CodeOffset(16)).is_none(), "where none is known");
}

#[test]
fn a_signature_is_of_this_image_and_key() {
    let private = [7; 32];
    let unsigned = full().build().unwrap();
    let mut file = unsigned.clone();
    signature::sign(&mut file, &private).unwrap();
    let image = Image::verify(&file).unwrap();
    assert_eq!(image.key(), Some(signature::public(&private)));
    assert_eq!(image.hash(), Image::verify(&unsigned).unwrap().hash(), "signing changes no hash");
    assert!(Image::verify(&unsigned).unwrap().key().is_none());

    // Of another image.
    let mut other = minimal().build().unwrap();
    other[128..224].copy_from_slice(&file[128..224]);
    assert_eq!(Image::verify(&other).unwrap_err().field, "signature");
    // Of another key.
    let mut forged = file.clone();
    forged[128..160].copy_from_slice(&signature::public(&[8; 32]));
    assert_eq!(Image::verify(&forged).unwrap_err().field, "signature");
    // Signed again by another.
    signature::sign(&mut file, &[8; 32]).unwrap();
    assert_eq!(Image::verify(&file).unwrap().key(), Some(signature::public(&[8; 32])));
}

#[test]
fn the_layout_hash_is_of_layout_only() {
    let hash = |b: &Builder| Image::verify(&b.build().unwrap()).unwrap().layout_hash();
    let base = hash(&full());
    let mut same = full();
    same.code.push(0x90);
    same.category = 8;
    assert_eq!(hash(&same), base, "code is no layout");
    let mut larger = full();
    larger.state_bytes += 1;
    assert_ne!(hash(&larger), base);
    let mut more = full();
    let real = more.elementary(Elementary::Real);
    more.variable(Variable::new("new", real, Area::State, 200));
    assert_ne!(hash(&more), base);
}

/// What is wrong, and how its error begins after the offset.
type Broken = (&'static str, fn(&mut Builder));

#[test]
fn what_breaks_a_rule_is_refused_by_name() {
    fn task(b: &mut Builder, change: fn(&mut Task)) {
        let mut task = Task::cyclic("x", Nanoseconds(MS), CodeOffset(0));
        change(&mut task);
        b.task(task);
    }
    fn variable(b: &mut Builder, change: fn(&mut Variable)) {
        let ty = b.elementary(Elementary::Dint);
        let mut variable = Variable::new("x", ty, Area::State, 0);
        change(&mut variable);
        b.variable(variable);
    }
    let broken: &[Broken] = &[
        ("header 0, code", |b| b.code.clear()),
        ("header 0, name", |b| b.name.clear()),
        ("header 0, name", |b| b.name = "a b".into()),
        ("header 0, init", |b| b.init = Some(CodeOffset(40))),
        ("requirements 0, input bytes", |b| b.input_bytes = 65_537),
        ("task 4, name: two tasks", |b| task(b, |t| t.name = "ORDER".into())),
        ("task 4, entry", |b| task(b, |t| t.entry = CodeOffset(40))),
        ("task 4, stack", |b| task(b, |t| t.stack_bytes = 0)),
        ("task 4, stack: found 1048576", |b| task(b, |t| t.stack_bytes = 0x10_0000)),
        ("task 4, deadline: found 1000001", |b| {
            task(b, |t| t.deadline = Some(Nanoseconds(MS + 1)));
        }),
        ("task 4, budget: found 1000001", |b| task(b, |t| t.budget = Some(Nanoseconds(MS + 1)))),
        ("task 4, period", |b| {
            task(b, |t| t.when = When::Cyclic { period: Nanoseconds(0), offset: Nanoseconds(0) });
        }),
        ("task 4, offset", |b| {
            task(b, |t| t.when = When::Cyclic { period: Nanoseconds(5), offset: Nanoseconds(5) });
        }),
        ("task 4, source: the program has no BOOL", |b| {
            task(b, |t| {
                let source = Event::Rise("level".into());
                t.when = When::Event { source, minimum: Nanoseconds(MS) };
            });
        }),
        ("task 4, source: the program has no port", |b| {
            task(b, |t| {
                let source = Event::Channel("nowhere".into());
                t.when = When::Event { source, minimum: Nanoseconds(MS) };
            });
        }),
        ("task 4, source: no message comes to a port", |b| {
            b.port(Port { name: "done".into(), direction: Direction::Out, message_bytes: 8 });
            task(b, |t| {
                let source = Event::Channel("done".into());
                t.when = When::Event { source, minimum: Nanoseconds(MS) };
            });
        }),
        ("variable 5, name: variables are in the order", |b| {
            variable(b, |v| v.name = "START".into())
        }),
        ("variable 5, offset: found 5003", |b| variable(b, |v| v.offset = 4999)),
        ("variable 5, type", |b| variable(b, |v| v.ty = TypeId(99))),
        ("variable 5, bit", |b| variable(b, |v| v.bit = Some(0))),
        ("variable 5, writer", |b| variable(b, |v| v.writer = Some(TaskId(4)))),
        ("variable 5, writer: no task writes", |b| {
            variable(b, |v| (v.area, v.writer) = (Area::Input, Some(TaskId(0))));
        }),
        ("type 9, size", |b| {
            b.ty(Type::new(3, Kind::Elementary(Elementary::Real)));
        }),
        ("type 9, size", |b| {
            b.ty(Type::new(8, Kind::Array { element: TypeId(1), lower: 0, upper: 2 }));
        }),
        ("type 9, upper", |b| {
            b.ty(Type::new(8, Kind::Array { element: TypeId(1), lower: 1, upper: -1 }));
        }),
        ("type 9, size", |b| {
            let (lower, upper) = (i64::MIN, i64::MAX);
            b.ty(Type::new(8, Kind::Array { element: TypeId(1), lower, upper }));
        }),
        ("type 9, element: a type has only types before", |b| {
            b.ty(Type::new(8, Kind::Array { element: TypeId(9), lower: 1, upper: 1 }));
        }),
        ("type 9, target", |b| {
            b.ty(Type::new(8, Kind::Reference { target: TypeId(77) }));
        }),
        ("object 4, name", |b| {
            b.object(Object { name: "Lock".into(), kind: ObjectKind::Flags });
        }),
        ("object 4, depth", |b| {
            let kind = ObjectKind::Queue { message_bytes: 1, depth: 0 };
            b.object(Object { name: "q".into(), kind });
        }),
        ("object 4, bytes", |b| {
            b.object(Object { name: "q".into(), kind: ObjectKind::Mailbox { bytes: 4097 } });
        }),
    ];
    for (expected, change) in broken {
        let mut b = full();
        change(&mut b);
        let error = b.build().map(|_| ()).unwrap_err().to_string();
        let (_, said) = error.split_once(", ").unwrap();
        assert!(said.starts_with(expected), "expected {expected}\n   found {error}");
    }
}

#[test]
fn types_are_nested_to_a_limit() {
    let nest = |levels| {
        let mut b = minimal();
        let mut ty = b.elementary(Elementary::Bool);
        for _ in 0..levels {
            ty = b.ty(Type::new(1, Kind::Array { element: ty, lower: 0, upper: 0 }));
        }
        b.build()
    };
    assert!(nest(31).is_ok());
    assert_eq!(nest(32).unwrap_err().field, "depth");
}

#[test]
fn a_file_of_another_version_is_told_as_such() {
    let mut file = minimal().build().unwrap();
    file[8] = 2;
    let error = Image::verify(&file).unwrap_err();
    assert_eq!(error.to_string(), "at byte 0x0, header 0, format version: found 2, allowed is 1");
    file[0] = b'X';
    assert!(matches!(Image::verify(&file).unwrap_err().defect, Defect::Rule(_)));
}
