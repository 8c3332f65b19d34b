//! Forces of some programs, in any order, up to the most that there may be.

use takt_abi::live::Range;

use super::*;

fn point(program: u8, offset: u32) -> Point {
    Point::new(Range { program, area: Area::State, offset, bytes: 4 }, None).unwrap()
}

fn values(forces: &Forces, program: u8) -> Vec<(u32, u64)> {
    forces.of(program).map(|(point, value)| (point.range.offset, value)).collect()
}

#[test]
fn a_point_has_one_forced_value_until_it_is_released() {
    let mut forces = Forces::NONE;
    for (program, offset, value) in [(0, 0, 1), (1, 0, 2), (0, 4, 3), (0, 0, 4)] {
        forces.set(point(program, offset), value).unwrap();
    }
    assert_eq!((values(&forces, 0), values(&forces, 1)), (vec![(0, 4), (4, 3)], vec![(0, 2)]));
    assert_eq!(forces.count(), 3);
    forces.release(point(0, 0)).unwrap();
    assert_eq!(forces.release(point(0, 0)), Err(Refusal::NotForced));
    assert_eq!((values(&forces, 0), values(&forces, 1)), (vec![(4, 3)], vec![(0, 2)]));
    assert!(forces.any(1) && !forces.any(2) && !forces.any(16));
    forces.clear();
    assert!(!forces.any(1));
    assert!(values(&forces, 0).is_empty() && forces.count() == 0);
}

#[test]
fn one_more_than_there_is_room_for_is_refused_and_changes_nothing() {
    let mut forces = Forces::NONE;
    for offset in 0..FORCES as u32 {
        forces.set(point(0, offset), 1).unwrap();
    }
    assert_eq!(forces.set(point(0, 1 << 20), 1), Err(Refusal::Full));
    assert_eq!(forces.set(point(16, 0), 1), Err(Refusal::NoProgram));
    assert_eq!(values(&forces, 0).len(), FORCES);
    forces.set(point(0, 7), 2).unwrap();
    forces.release(point(0, 0)).unwrap();
    forces.set(point(0, 1 << 20), 1).unwrap();
}

#[test]
fn what_is_in_its_place_stays_there_until_something_writes() {
    let mut forces = Forces::NONE;
    forces.set(point(0, 0), 1).unwrap();
    assert!(!forces.is_settled(0));
    (0..2).for_each(|program| forces.settle(program));
    forces.unsettle(1);
    assert!(forces.is_settled(0) && !forces.is_settled(1));
    forces.set(point(0, 4), 1).unwrap();
    forces.release(point(0, 0)).unwrap();
    assert!(forces.is_settled(0), "the others stay");
    forces.clear();
    forces.settle(255);
    assert!(!forces.is_settled(0) && !forces.is_settled(255));
}

#[test]
fn inputs_are_known_apart_from_the_others() {
    let input = |offset| {
        let range = Range { program: 3, area: Area::Input, offset, bytes: 1 };
        Point::new(range, None).unwrap()
    };
    let of = |forces: &Forces| {
        forces.inputs_of(3).map(|(point, _)| point.range.offset).collect::<Vec<_>>()
    };
    let mut forces = Forces::NONE;
    for point in [point(3, 0), input(1), point(3, 8), input(2), input(1), point(2, 0)] {
        forces.set(point, 1).unwrap();
    }
    assert_eq!((of(&forces), forces.inputs_of(2).count()), (vec![1, 2], 0));
    forces.release(input(1)).unwrap();
    assert_eq!(of(&forces), [2]);
    forces.release(input(2)).unwrap();
    forces.release(point(3, 0)).unwrap();
    assert_eq!((of(&forces), values(&forces, 3)), (vec![], vec![(8, 1)]));
}
