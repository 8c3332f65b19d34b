//! What a program begins with: of its own image, of another version, and after a cold start.

use crate::common::{Own, block, image, layout};
use takt_program::{Elementary, Flags, Image};
use takt_retain::{Generation, Layout, Restored};

const R: Flags = Flags::RETAIN;
const P: Flags = Flags::PERSISTENT;
const DINT: Own = Own::One(Elementary::Dint);

fn restored(old: &Layout, new: &Layout, values: &[u8]) -> Restored {
    let file = Generation::encode(1, 77, old, values).unwrap();
    new.restore(&Generation::decode(&file).unwrap())
}

/// The bytes of a part.
fn part<'b>(layout: &Layout, block: &'b [u8], name: &str) -> &'b [u8] {
    let part = layout.parts().iter().find(|part| part.name == name).unwrap();
    &block[part.at..part.at + (part.count * part.bytes) as usize]
}

#[test]
fn the_same_image_gets_all_of_its_values_but_references() {
    let own = [("Main.n", DINT, R), ("mix", Own::Block, P), ("plain", DINT, Flags::NONE)];
    let file = image(0, &own);
    let layout = layout(&file);
    let names: Vec<&str> = layout.parts().iter().map(|part| part.name.as_str()).collect();
    assert_eq!(names, ["main.n", "mix.a", "mix.b[]"]);
    assert_eq!(layout.initial().len(), 4 + 16);
    assert_eq!(Layout::block_bytes(&Image::parse(&file).unwrap()), 4 + 16);
    assert_eq!(layout.initial()[..5], [0xee, 0xee, 0xee, 0xee, 0]);
    assert_eq!(layout.variables().collect::<Vec<_>>(), [(0, 4), (64, 16)]);
    assert_eq!((layout.pieces(), layout.has_persistent()), (2, true));
    let values = block(&layout, 1);
    let back = restored(&layout, &layout, &values);
    assert!(back.retain && !back.is_partial(), "{back}");
    assert_eq!(back.block[..8], values[..8]);
    assert_eq!(back.block[8..], layout.initial()[8..], "no reference comes from a file");
}

#[test]
fn another_image_gets_persistent_values_by_name_and_type() {
    let old = [
        ("kept", DINT, P),
        ("retained", DINT, R),
        ("retyped", DINT, P),
        ("row", Own::Array(1, 4), P),
        ("step", Own::Enumeration(&["idle", "run"]), P),
        ("step2", Own::Enumeration(&["idle", "run"]), P),
        ("gone", DINT, P),
        ("text", Own::Text(5), P),
    ];
    let new = [
        ("first", DINT, P),
        ("KEPT", DINT, P),
        ("retained", DINT, R),
        ("retyped", Own::One(Elementary::Real), P),
        ("row", Own::Array(3, 6), P),
        ("step", Own::Enumeration(&["idle", "run"]), P),
        ("step2", Own::Enumeration(&["run", "idle"]), P),
        ("text", Own::Text(6), P),
    ];
    let (old, new) = (layout(&image(0, &old)), layout(&image(1, &new)));
    let values = block(&old, 3);
    let back = restored(&old, &new, &values);
    assert!(!back.retain && back.is_partial());
    let same = |name| assert_eq!(part(&new, &back.block, name), part(&old, &values, name));
    same("kept");
    same("step");
    let (row, before) = (part(&new, &back.block, "row[]"), part(&old, &values, "row[]"));
    assert_eq!((&row[..8], &row[8..]), (&before[8..], &[0; 8][..]), "by index");
    for name in ["first", "retained", "retyped", "step2", "text"] {
        let initial = part(&new, new.initial(), name);
        assert_eq!(part(&new, &back.block, name), initial, "{name}");
    }
    let text = back.to_string();
    for said in [
        "1 RETAIN values start anew, because another image ran",
        "new: first",
        "dropped: gone",
        "retyped (DINT -> REAL)",
        "step2 (step:SINT:",
        "text (STRING[5] -> STRING[6])",
        "in part: row[] (2 elements)",
    ] {
        assert!(text.contains(said), "{said}: {text}");
    }
    // An online change keeps RETAIN values, too.
    let carried = new.carry(&old, &values);
    let retained = part(&new, &carried, "retained");
    assert_eq!(retained, part(&old, &values, "retained"));
}

#[test]
fn a_cold_start_keeps_what_is_persistent() {
    let own = [("a", DINT, R), ("b", DINT, P), ("c", DINT, R.with(P))];
    let layout = layout(&image(0, &own));
    let values = block(&layout, 9);
    let cold = layout.cold(&values).unwrap();
    assert_eq!((&cold[..4], &cold[4..]), (&layout.initial()[..4], &values[4..]));
    assert_eq!(layout.cold(&values[1..]), None);
}

#[test]
fn what_lies_side_by_side_is_one_piece() {
    let own: Vec<(String, Own, Flags)> =
        (0..5).map(|n| (format!("v{n}"), Own::Array(1, 16), R)).collect();
    let own: Vec<_> = own.iter().map(|(name, ty, flags)| (name.as_str(), *ty, *flags)).collect();
    assert_eq!(layout(&image(0, &own)).pieces(), 1);
}
