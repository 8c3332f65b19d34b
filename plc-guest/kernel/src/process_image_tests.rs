//! Tests of the process image.

use crate::process_image::*;
use crate::time::Instant;
use takt_abi::io::{ANY_TASK, INPUT, Mapping, OUTPUT, WHOLE, flag, kind};
use takt_program::Elementary;

/// An input of a type at a byte, from a field of a message.
fn input(ty: Elementary, offset: u32, field: u32) -> Mapping {
    Mapping {
        direction: INPUT,
        kind: kind::FIELD,
        task: ANY_TASK,
        bit: WHOLE,
        place_bit: WHOLE,
        offset,
        bytes: ty.bytes(),
        ty: ty.code().into(),
        field,
        ..Mapping::NONE
    }
}

fn output(mapping: Mapping) -> Mapping {
    Mapping { direction: OUTPUT, task: 0, ..mapping }
}

fn bit(mapping: Mapping, bit: u8, place_bit: u8) -> Mapping {
    Mapping { bit, place_bit, ..mapping }
}

#[test]
fn a_value_is_copied_byte_for_byte_and_no_neighbour_changes() {
    let message = [1, 2, 3, 4, 5, 6, 7, 8];
    let mut image = [0xee; 8];
    read(&input(Elementary::Dint, 2, 3), &message, &mut image);
    assert_eq!(image, [0xee, 0xee, 4, 5, 6, 7, 0xee, 0xee]);
    let mut back = [0; 8];
    write(&output(input(Elementary::Dint, 2, 4)), &image, &mut back);
    assert_eq!(back, [0, 0, 0, 0, 4, 5, 6, 7]);
}

#[test]
fn a_structure_without_an_elementary_type_is_copied_whole() {
    let whole = Mapping { ty: 0, bytes: 5, ..input(Elementary::Byte, 1, 2) };
    let mut image = [0; 8];
    read(&whole, &[9, 8, 7, 6, 5, 4, 3, 2], &mut image);
    assert_eq!(image, [0, 7, 6, 5, 4, 3, 0, 0]);
}

#[test]
fn a_bit_of_any_register_byte_becomes_a_bit_or_a_byte() {
    for place_bit in 0..32u8 {
        let register = (1u32 << place_bit).to_le_bytes();
        for value in [register, [0; 4]] {
            let expected = value != [0; 4];
            let mut image = [0b1010_1010; 2];
            read(&bit(input(Elementary::Bool, 1, 0), 2, place_bit), &value, &mut image);
            let kept = 0b1010_1010 & !0b100;
            assert_eq!(image, [0b1010_1010, kept | (u8::from(expected) << 2)]);
            read(&bit(input(Elementary::Bool, 1, 0), WHOLE, place_bit), &value, &mut image);
            assert_eq!(image[1], u8::from(expected));
        }
    }
}

/// A BOOL of a whole byte is 0 or 1 for the program, whatever a message says: a `bool` of Rust that is 2 is undefined.
#[test]
fn a_truth_value_is_one_or_zero() {
    let mut image = [0xee; 2];
    read(&input(Elementary::Bool, 1, 0), &[2], &mut image);
    assert_eq!(image, [0xee, 1]);
    let mut register = [0; 4];
    write(&output(bit(input(Elementary::Bool, 0, 0), WHOLE, 17)), &[0x80], &mut register);
    assert_eq!(register, [0, 0, 2, 0]);
}

#[test]
fn no_table_reaches_beyond_its_slices() {
    for ty in [Elementary::Bool, Elementary::Lreal] {
        for far in [8, 100, u32::MAX - 2, u32::MAX] {
            let mut image = [7; 8];
            let point = Mapping { offset: far, ..input(ty, 0, 0) };
            read(&point, &[1; 8], &mut image);
            clear(&point, &mut image);
            put(&point, [1; 8], &mut image);
            read(&input(ty, 0, far), &[1; 8], &mut image);
            read(&bit(input(Elementary::Bool, 0, far), 3, 254), &[1; 8], &mut image);
            cover(&mut image, far, far, None);
            cover(&mut image, far, 1, Some(255));
            assert_eq!(image, [7; 8], "{ty:?} {far}");
        }
    }
    let huge = Mapping { bytes: u32::MAX, ty: 0, ..input(Elementary::Byte, 4, 0) };
    let mut image = [7; 8];
    read(&huge, &[1; 8], &mut image);
    assert_eq!(image, [7; 8]);
    clear(&huge, &mut image);
    assert_eq!(image, [7, 7, 7, 7, 0, 0, 0, 0]);
}

#[test]
fn a_channel_without_a_valid_message_keeps_its_values_or_zeroes_them() {
    let keeps = input(Elementary::Int, 0, 0);
    let zeroes = Mapping { flags: flag::ZERO, ..input(Elementary::Int, 2, 0) };
    let valid = Mapping { kind: kind::VALID, ..bit(input(Elementary::Bool, 4, 0), 6, WHOLE) };
    let age = Mapping { kind: kind::AGE, ..input(Elementary::Time, 8, 0) };
    let all = [keeps, zeroes, valid, age];
    let mut image = [0; 16];
    let mut see = |newest: Newest<'_>| {
        all.iter().for_each(|mapping| read_newest(mapping, &newest, &mut image));
        image
    };
    let fresh = see(Newest { message: Some(&[5, 6]), valid: true, age: 300, count: 0 });
    assert_eq!(fresh, [5, 6, 5, 6, 64, 0, 0, 0, 44, 1, 0, 0, 0, 0, 0, 0]);
    // Old: what it says is the last that is known.
    let stale = see(Newest { message: Some(&[7, 8]), valid: false, age: 1 << 40, count: 0 });
    assert_eq!(stale[..5], [7, 8, 0, 0, 0]);
    let none = see(Newest::NONE);
    assert_eq!(none[..5], [7, 8, 0, 0, 0]);
    assert_eq!(none[8..], i64::MAX.to_le_bytes());
}

fn simulate(kind: u8, ty: Elementary, [low, high]: [f64; 2], now: u64) -> [u8; 8] {
    let simulation = Mapping {
        kind,
        place: low.to_bits(),
        high: high.to_bits(),
        period_ns: 1000,
        ..input(ty, 0, 0)
    };
    simulated(&simulation, Instant(now)).unwrap()
}

#[test]
fn simulated_values_have_their_shapes() {
    let value = |kind, now| f64::from_le_bytes(simulate(kind, Elementary::Lreal, [-2.0, 6.0], now));
    for now in [0, 499, 999, 1_000_000] {
        assert_eq!(value(kind::CONSTANT, now), -2.0);
    }
    assert_eq!([0, 250, 999, 1000].map(|t| value(kind::RAMP, t)), [-2.0, 0.0, 5.992, -2.0]);
    assert_eq!(
        [0, 499, 500, 999, 1000].map(|t| value(kind::SQUARE, t)),
        [-2.0, -2.0, 6.0, 6.0, -2.0]
    );
    for now in 0..2000 {
        let expected = 2.0 + 4.0 * (std::f64::consts::TAU * now as f64 / 1000.0).sin();
        let found = value(kind::SINE, now);
        assert!((found - expected).abs() < 8.0 * 4e-6, "{now}: {found} {expected}");
        assert!((-2.0..=6.0).contains(&found), "{now}: {found}");
    }
    let other = input(Elementary::Lreal, 0, 0);
    assert_eq!(simulated(&other, Instant(0)), None);
}

#[test]
fn simulated_numbers_end_at_the_limits_of_their_type() {
    let value = |ty, value| simulate(kind::CONSTANT, ty, [value, 0.0], 0);
    assert_eq!(value(Elementary::Int, -2.5), (-3i64).to_le_bytes());
    assert_eq!(value(Elementary::Int, -1e9)[..2], i16::MIN.to_le_bytes());
    assert_eq!(value(Elementary::Sint, 1e9)[..1], i8::MAX.to_le_bytes());
    assert_eq!(value(Elementary::Usint, 1e9)[..2], [255, 0]);
    assert_eq!(value(Elementary::Uint, -4.0)[..2], [0, 0]);
    assert_eq!(value(Elementary::Lword, 1e30), [255; 8]);
    assert_eq!(value(Elementary::Real, 1.5)[..4], 1.5f32.to_le_bytes());
    assert_eq!(value(Elementary::Real, 1e39)[..4], f32::MAX.to_le_bytes());
    assert_eq!(value(Elementary::Real, -1e39)[..4], f32::MIN.to_le_bytes());
    assert_eq!(value(Elementary::Bool, 0.49)[0], 0);
    assert_eq!(value(Elementary::Bool, 0.5)[0], 1);
    assert_eq!(value(Elementary::Dint, f64::NAN)[..4], [0; 4]);
}

#[test]
fn a_place_is_visited_once_for_all_of_its_points() {
    let port = |place, direction| Mapping { kind: kind::PORT, place, direction, ..Mapping::NONE };
    let channel =
        |kind, program| Mapping { kind, place: 1, direction: INPUT, program, ..Mapping::NONE };
    let all = [
        channel(kind::FIELD, 0),
        channel(kind::VALID, 0),
        channel(kind::AGE, 0),
        port(1, INPUT),
        port(2, INPUT),
        port(2, INPUT),
        port(2, OUTPUT),
        channel(kind::FIELD, 1),
    ];
    let lengths: Vec<usize> = places(&all).map(<[Mapping]>::len).collect();
    assert_eq!(lengths, [3, 1, 2, 1, 1]);
}

#[test]
fn a_job_reads_and_writes_what_is_its_own() {
    let any = input(Elementary::Byte, 0, 0);
    let own = Mapping { task: 2, ..any };
    assert!([None, Some(0), Some(2)].iter().all(|task| is_read_by(&any, *task)));
    assert_eq!([None, Some(0), Some(2)].map(|task| is_read_by(&own, task)), [true, false, true]);
    let written = Mapping { task: 2, ..output(any) };
    assert_eq!(
        [None, Some(0), Some(2)].map(|task| is_written_by(&written, task)),
        [true, false, true]
    );
    assert!(!is_read_by(&written, None) && !is_written_by(&any, None));
}

#[test]
fn what_a_task_does_not_write_stays_as_others_wrote_it() {
    let mut map = [0; 8];
    cover(&mut map, 0, 1, Some(3));
    cover(&mut map, 4, 2, None);
    assert_eq!(map, [8, 0, 0, 0, 255, 255, 0, 0]);
    let map = u64::from_le_bytes(map);
    let merged = merged(u64::from_le_bytes([0xf0; 8]), u64::from_le_bytes([0x0f; 8]), map);
    assert_eq!(merged.to_le_bytes(), [0xf8, 0xf0, 0xf0, 0xf0, 0x0f, 0x0f, 0xf0, 0xf0]);
}
