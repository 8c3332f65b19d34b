//! Where variables lie when a program changes: what stays, what moves.

use super::*;

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
