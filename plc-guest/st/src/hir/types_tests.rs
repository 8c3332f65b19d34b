//! Types: when two are one, their layout, and their initial values as bytes.

use super::super::{Constant, GlobalId, Retention};
use super::*;

fn structure(types: &mut Types, fields: &[(&str, TypeId, Constant)]) -> TypeId {
    let id = types.declare("s", StructureKind::Struct);
    for (name, ty, initial) in fields {
        types.define(id, name, *ty, initial.clone(), Section::Variable, Retention::None);
    }
    types.complete(id);
    id
}

#[test]
fn equal_structural_types_are_one_type() {
    let mut types = Types::new();
    let int = types.elementary(Elementary::Int);
    let array = types.array(int, 1, 4);
    assert_eq!(array, types.array(int, 1, 4));
    assert_ne!(array, types.array(int, 0, 3));
    assert_eq!(types.string(80), types.string(80));
}

#[test]
fn fields_are_aligned_and_sizes_are_multiples_of_the_alignment() {
    let mut types = Types::new();
    let (bool, lint) = (types.elementary(Elementary::Bool), types.elementary(Elementary::Lint));
    let text = types.string(3);
    let id = structure(
        &mut types,
        &[
            ("a", bool, Constant::Default),
            ("b", lint, Constant::Default),
            ("c", text, Constant::Default),
            ("d", bool, Constant::Default),
        ],
    );
    let offsets: Vec<u32> =
        types.structure(id).unwrap().fields.iter().map(|field| field.offset).collect();
    assert_eq!(offsets, [0, 8, 16, 20]);
    assert_eq!((types.size(id), types.align(id)), (24, 8));
}

#[test]
fn integers_wrap_to_their_width() {
    assert_eq!(Elementary::Sint.wrap(128), -128);
    assert_eq!(Elementary::Usint.wrap(-1), 255);
    assert_eq!(Elementary::Lint.wrap(1 << 63), -(1 << 63));
    assert_eq!(Elementary::Bool.wrap(2), 1);
}

#[test]
fn initial_values_are_encoded_through_arrays_and_structures() {
    let mut types = Types::new();
    let int = types.elementary(Elementary::Int);
    let percent = types.subrange("percent", Elementary::Usint, 10, 100);
    let text = types.string(4);
    let numbers = types.array(int, 1, 3);
    let id = structure(
        &mut types,
        &[
            ("p", percent, Constant::Default),
            ("t", text, Constant::String(b"ab".to_vec())),
            ("n", numbers, Constant::Fill(Box::new(Constant::Integer(-2)))),
        ],
    );
    let mut bytes = vec![0; types.size(id) as usize];
    types.encode(id, &Constant::Default, &mut bytes, &|_, _| 0);
    assert_eq!(bytes, [10, b'a', b'b', 0, 0, 0, 0xFE, 0xFF, 0xFE, 0xFF, 0xFE, 0xFF]);

    let inner = Constant::Aggregate([Constant::Integer(1)].into());
    let given = Constant::Aggregate([Constant::Integer(7), Constant::Default, inner].into());
    bytes.fill(0);
    types.encode(id, &given, &mut bytes, &|_, _| 0);
    assert_eq!(bytes, [7, b'a', b'b', 0, 0, 0, 1, 0, 0, 0, 0, 0]);
}

#[test]
fn a_reference_is_encoded_as_an_address() {
    let mut types = Types::new();
    let int = types.elementary(Elementary::Int);
    let reference = types.reference(int);
    let mut bytes = [0; 8];
    types.encode(reference, &Constant::Address(GlobalId(3), vec![1]), &mut bytes, &|id, fields| {
        0x5000_0000 + u64::from(id.0) * 16 + u64::from(fields[0]) * 4
    });
    assert_eq!(u64::from_le_bytes(bytes), 0x5000_0034);
}
