//! Where variables lie when a program changes: what stays, what moves.

use super::*;
use crate::source::Sources;
use crate::{build, project};

fn part(size: u32, old: Option<(u32, u32)>) -> Part {
    Part { size, align: size.min(8), old: old.map(|(offset, size)| Place { offset, size }) }
}

#[test]
fn what_is_the_same_stays_and_what_is_new_fills_what_is_free() {
    // Between two that stay 8 bytes are free; the third is new, the fourth had another size and has room.
    let parts = [
        part(8, Some((16, 8))),
        part(8, Some((0, 8))),
        part(4, None),
        part(8, Some((24, 4))),
        part(8, None),
    ];
    assert_eq!(place(&parts), (vec![16, 0, 8, 24, 32], 40));
}

#[test]
fn what_grows_moves_and_not_what_is_behind_it() {
    let parts = [part(16, Some((0, 8))), part(8, Some((8, 8)))];
    assert_eq!(place(&parts), (vec![16, 8], 32));
}

#[test]
fn an_old_place_that_does_not_fit_or_would_overlap_is_not_taken() {
    // The image is a file: whatever it says, nothing overlaps.
    let parts = [part(8, Some((4, 8))), part(8, Some((0, 8))), part(8, Some((0, 8)))];
    assert_eq!(place(&parts), (vec![8, 0, 16], 24));
    let parts = [part(8, Some((u32::MAX - 7, 8)))];
    assert_eq!(place(&parts).0, [0]);
}

/// A program with a block in which something is free in front of the memory of an edge.
fn with_an_edge() -> Program {
    let source = "FUNCTION_BLOCK Counter
VAR_INPUT ready : BOOL; more : DINT; start : BOOL R_EDGE; END_VAR
VAR start_last : BOOL; END_VAR
VAR_OUTPUT n : DINT; END_VAR
IF ready AND start AND NOT start_last THEN n := n + more; END_IF;
start_last := ready;
END_FUNCTION_BLOCK
PROGRAM Main
VAR count : Counter; lamp AT %QX0.0 : BOOL; END_VAR
count(ready := TRUE, more := 1, start := lamp);
lamp := count.n > 0;
END_PROGRAM
CONFIGURATION c
TASK t (INTERVAL := T#1ms, PRIORITY := 1);
PROGRAM one WITH t : Main;
END_CONFIGURATION
";
    let mut sources = Sources::new();
    sources.add("main.st", source.as_bytes()).expect("a source");
    let checked = project::check("test", &mut sources).expect("a thread");
    checked.program.expect("a program without errors")
}

/// The fields of all structures, with their places.
fn places_of_fields(program: &Program) -> Vec<(String, u32)> {
    let structures = program.types.iter().filter_map(|(id, _)| program.types.structure(id));
    let fields = structures.flat_map(|structure| &structure.fields);
    fields.map(|field| (field.name.clone(), field.offset)).collect()
}

#[test]
fn what_has_not_changed_stays_with_all_its_edges() {
    let old = with_an_edge();
    let image = build::build(&old).expect("an image").image;
    let mut new = with_an_edge();
    keep(&mut new, &Image::verify(&image).expect("an image"));
    let places = places_of_fields(&old);
    assert!(places.iter().any(|(name, _)| name == "start-last"), "{places:?}");
    assert_eq!(places_of_fields(&new), places);
}
