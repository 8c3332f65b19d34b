//! Images that somebody made to do harm: read without panic, and refused.

mod common;

use common::{full, minimal};
use proptest::prelude::*;
use takt_program::build::{Field, Kind, Type};
use takt_program::{CodeOffset, Defect, Elementary, Image, SectionKind, signature};

/// Reads everything that an accepted image has.
fn read_all(image: &Image<'_>) -> usize {
    let mut sum = image.code().len() + image.constants().len() + image.state().len();
    sum += image.tasks().map(|task| task.name.len()).sum::<usize>();
    sum += image.objects().count() + image.ports().count();
    for variable in image.variables() {
        assert_eq!(image.variable(variable.name).unwrap().index, variable.index);
        let end = u64::from(variable.offset) + u64::from(variable.bytes);
        assert!(end <= image.area_bytes(variable.area).into());
    }
    for ty in image.types() {
        sum += image.fields(&ty).count() + image.values(&ty).count();
    }
    for at in [0, 8, 20, u32::MAX] {
        sum += usize::from(image.trap(CodeOffset(at)).is_some());
        sum += usize::from(image.line(CodeOffset(at)).is_some());
    }
    sum + image.traps().count() + image.lines().count()
}

fn parse(file: &[u8]) {
    if let Ok(image) = Image::parse(file) {
        read_all(&image);
    }
}

#[test]
fn no_byte_can_be_changed_unseen() {
    let mut file = full().build().unwrap();
    signature::sign(&mut file, &[1; 32]).unwrap();
    for at in 0..file.len() {
        for flip in [1, 0x80] {
            file[at] ^= flip;
            parse(&file);
            file[at] ^= flip;
        }
        file[at] ^= 0xff;
        assert!(Image::verify(&file).is_err(), "byte {at} changed");
        file[at] ^= 0xff;
    }
    assert!(Image::verify(&file).is_ok());
}

#[test]
fn no_part_of_an_image_is_one() {
    let file = full().build().unwrap();
    for length in 0..file.len() {
        assert!(Image::parse(&file[..length]).is_err(), "the first {length} bytes");
    }
    let mut longer = file.clone();
    longer.push(0);
    assert!(Image::parse(&longer).is_err(), "with one byte more");
}

/// An image with so many structures, of which only the first has fields of its own: the others name the same.
fn with_shared_fields(structures: usize, fields: u32) -> Vec<u8> {
    let mut b = minimal();
    let byte = b.elementary(Elementary::Byte);
    let field = |offset| Field { name: "f".into(), ty: byte, offset };
    b.ty(Type::new(fields, Kind::Structure { fields: (0..fields).map(field).collect() }));
    for number in 1..structures {
        let empty = Kind::Structure { fields: Vec::new() };
        b.ty(Type::new(fields, empty).named(&format!("s{number}")));
    }
    let mut file = b.build().unwrap();
    // A structure's record has its depth at 2, and where its fields begin and how many there are at 16.
    let record = |number: usize| 40 * number;
    let types = (256..file.len() - 40).step_by(8).find(|&at| {
        let second = at + record(1);
        file[at] == 1 && file[second] == 5 && file[second + 20..][..4] == fields.to_le_bytes()
    });
    let types = types.unwrap();
    for number in 2..=structures {
        let at = types + record(number);
        assert_eq!(file[at], 5);
        file[at + 2] = 2;
        file[at + 16..][..4].copy_from_slice(&0u32.to_le_bytes());
        file[at + 20..][..4].copy_from_slice(&fields.to_le_bytes());
    }
    file
}

#[test]
fn types_with_the_same_fields_are_refused_before_they_take_time() {
    assert!(Image::parse(&with_shared_fields(1, 100)).is_ok());
    let refused = Image::parse(&with_shared_fields(2, 100)).unwrap_err();
    assert_eq!((refused.record, refused.index, refused.field), ("type", 2, "first"));
    assert!(matches!(refused.defect, Defect::Rule(_)), "{refused}");
}

/// The metadata, in which all numbers are; the segments after it may be anything.
fn metadata(file: &[u8]) -> usize {
    Image::parse(file).unwrap().file_offset(SectionKind::Code)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn numbers_of_any_value_do_no_harm(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u64>(), 0..4_u8), 1..4)
    ) {
        let mut file = full().build().unwrap();
        let end = metadata(&file);
        for (index, value, size) in changes {
            let bytes = 1 << size;
            let at = index.index(end - bytes) / bytes * bytes;
            file[at..at + bytes].copy_from_slice(&value.to_le_bytes()[..bytes]);
        }
        parse(&file);
    }

    #[test]
    fn any_bytes_do_no_harm(bytes in prop::collection::vec(any::<u8>(), 0..2048)) {
        let mut file = minimal().build().unwrap();
        parse(&bytes);
        let end = bytes.len().min(file.len());
        file[16..end.max(16)].copy_from_slice(&bytes[16.min(end)..end]);
        parse(&file);
    }
}
