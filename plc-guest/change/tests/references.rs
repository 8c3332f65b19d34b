//! References follow the first byte of their targets. A change after which one would lead to something else is refused.

mod common;

use common::{TestMemory, TestStates};
use takt_change::make::{Change, Large, NoteKind, Refusal};
use takt_change::{LargePlan, Plan, Ready};
use takt_program::build::{Builder, Field, Kind, Task, Type, Variable};
use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds, TypeId, address};

/// A version with a reference `r` to the first type, and behind it a variable `a` of the second one.
fn program(types: impl FnOnce(&mut Builder) -> (TypeId, TypeId)) -> Vec<u8> {
    let mut image = Builder::new("p");
    image.code = vec![0xc3];
    let (target, ty) = types(&mut image);
    let reference = image.ty(Type::new(8, Kind::Reference { target }));
    image.state_bytes = 8 + image.type_of(ty).unwrap().bytes;
    image.variable(Variable::new("r", reference, Area::State, 0));
    image.variable(Variable::new("a", ty, Area::State, 8));
    image.task(Task::cyclic("t", Nanoseconds(1_000_000), CodeOffset(0)));
    image.build().unwrap()
}

fn array(image: &mut Builder, element: TypeId, (lower, upper): (i64, i64)) -> TypeId {
    let bytes = image.type_of(element).unwrap().bytes * (upper - lower + 1) as u32;
    image.ty(Type::new(bytes, Kind::Array { element, lower, upper }))
}

fn change(old: &[u8], new: &[u8]) -> Change {
    Change::between(&Image::parse(old).unwrap(), &Image::parse(new).unwrap())
}

fn target() -> Vec<Refusal> {
    vec![Refusal::Target { name: "a".into() }]
}

#[test]
fn an_array_with_references_to_its_type_loses_no_elements_behind_its_first_one() {
    let version = |target, bounds| {
        program(|image| {
            let element = image.elementary(Elementary::Int);
            (array(image, element, target), array(image, element, bounds))
        })
    };
    for (target, old, new, refused) in [
        ((0, 9), (0, 9), (0, 4), true),
        // Another type.
        ((0, 3), (0, 9), (0, 4), false),
        ((0, 9), (0, 9), (0, 19), false),
        ((0, 9), (0, 9), (-3, 9), false),
        // Without its first element it is no target any more.
        ((0, 9), (0, 9), (1, 9), false),
        // The roll-back would do the same.
        ((0, 9), (0, 4), (0, 9), true),
    ] {
        let refusals = change(&version(target, old), &version(target, new)).refusals;
        let wanted = if refused { self::target() } else { Vec::new() };
        assert_eq!(refusals, wanted, "{target:?}: {old:?} {new:?}");
    }
}

#[test]
fn rows_with_references_to_all_of_them_stay_as_long_as_they_are() {
    let version = |row| {
        program(|image| {
            let element = image.elementary(Elementary::Int);
            let [before, now] = [(0, 9), row].map(|row| array(image, element, row));
            (array(image, before, (0, 3)), array(image, now, (0, 3)))
        })
    };
    assert_eq!(change(&version((0, 9)), &version((0, 9))).refusals, []);
    for row in [(0, 4), (0, 19)] {
        assert_eq!(change(&version((0, 9)), &version(row)).refusals, target(), "{row:?}");
    }
}

/// A version whose `a` has a counter and an enumeration of so many names, behind this many variables; `r` refers to all of `a`.
fn batch(names: i64, before: u32) -> Vec<u8> {
    let mut image = Builder::new("p");
    image.code = vec![0xc3];
    let base = Elementary::Int;
    let values = (0..names).map(|value| (format!("n{value}"), value)).collect();
    let phase = image.ty(Type::new(2, Kind::Enumeration { base, values }).named("E"));
    let count = image.elementary(base);
    let field = |name: &str, ty, offset| Field { name: name.into(), ty, offset };
    let fields = vec![field("count", count, 0), field("phase", phase, 2)];
    let structure = image.ty(Type::new(4, Kind::Structure { fields }).named("S"));
    let row = array(&mut image, structure, (0, 1));
    let reference = image.ty(Type::new(8, Kind::Reference { target: row }));
    image.state_bytes = 8 * (2 + before);
    image.variable(Variable::new("r", reference, Area::State, 0));
    let more = image.elementary(Elementary::Lint);
    for n in 0..before {
        image.variable(Variable::new(&format!("n{n}"), more, Area::State, 8 + 8 * n));
    }
    image.variable(Variable::new("a", row, Area::State, 8 + 8 * before));
    image.task(Task::cyclic("t", Nanoseconds(1_000_000), CodeOffset(0)));
    image.build().unwrap()
}

#[test]
fn a_reference_to_an_enumeration_that_has_gained_a_name_gets_back() {
    let (old, new) = (batch(2, 0), batch(3, 1));
    let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
    let plans = Change::between(&a, &b).plans.unwrap();
    let mut state = (address::STATE + 8).to_le_bytes().to_vec();
    state.extend([1, 0, 1, 0, 2, 0, 0, 0]);
    let mut memory = TestMemory::new(&state, b.state_bytes(), &b);
    let there = Ready::new(Plan::parse(&plans.forward, &a, &b).unwrap());
    while there.prepare(0, 1_000, &mut memory).is_some() {}
    there.apply(&mut memory);
    assert_eq!(memory.state[..8], (address::STATE + 16).to_le_bytes());
    memory.state[16..24].copy_from_slice(&[7, 0, 2, 0, 8, 0, 2, 0]);
    Ready::new(Plan::parse(&plans.back, &b, &a).unwrap()).apply(&mut memory);
    assert_eq!(memory.state[..8], (address::STATE + 8).to_le_bytes());
    // Counters of now, and the names of the commit.
    assert_eq!(memory.state[8..16], [7, 0, 1, 0, 8, 0, 0, 0]);
    // The way there could not follow one to an enumeration that loses a name.
    let refused = Refusal::Reference { name: "r".into() };
    assert_eq!(change(&new, &old).refusals, [refused]);
}

/// A version whose `a` is one value, with a reference to an INT.
fn value(base: Elementary) -> Vec<u8> {
    program(|image| (image.elementary(Elementary::Int), image.elementary(base)))
}

#[test]
fn what_may_become_null_is_told() {
    let told = |old, new| {
        let notes = change(&value(old), &value(new)).notes;
        notes.iter().any(|note| note.kind == NoteKind::Reference)
    };
    assert!(told(Elementary::Int, Elementary::Dint), "converted");
    assert!(told(Elementary::Int, Elementary::Bool), "begins anew");
    assert!(!told(Elementary::Int, Elementary::Int), "kept");
    // It comes along, and back it begins anew.
    let notes = change(&batch(2, 0), &batch(3, 1)).notes;
    assert!(notes.iter().any(|note| note.kind == NoteKind::Reference));
}

#[test]
fn a_roll_back_from_a_second_state_leads_no_reference_to_a_value_of_another_type() {
    let (old, new) = (value(Elementary::Dint), value(Elementary::Int));
    let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
    let large = Large::between(&a, &b).unwrap();
    let back = LargePlan::parse(&large.back, &b, &a).unwrap();
    let mut first = [0; 12];
    let mut second = [0; 10];
    second[..8].copy_from_slice(&(address::STATE + 8).to_le_bytes());
    let mut page = back.page(0);
    let mut states = TestStates { old: &second, new: &mut first, lost: Vec::new() };
    while !back.carry(&mut page, 1_000, &mut states) {}
    assert_eq!(first[..8], [0; 8]);
}
