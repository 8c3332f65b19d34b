//! Forces of some programs, in any order, up to the most that there may be.

use takt_abi::live::{Area, Range};

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
