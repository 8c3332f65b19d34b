//! What programs begin with, over each kind of start.

use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Flags, Nanoseconds};

use super::*;

/// `retained`, then `persistent`; in another version the other way round.
fn image(patch: u16, flags: [Flags; 2]) -> Vec<u8> {
    let mut image = Builder::new("tank");
    image.version.patch = patch;
    image.code = vec![0xc3];
    image.state = vec![9; 16];
    image.state_bytes = 16;
    let ty = image.elementary(Elementary::Ulint);
    let places = if patch == 0 { [0, 8] } else { [8, 0] };
    for (name, (at, flags)) in ["a", "b"].into_iter().zip(places.into_iter().zip(flags)) {
        image.variable(Variable::new(name, ty, Area::State, at).with(flags));
    }
    image.task(Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0)));
    image.build().unwrap()
}

const BOTH: [Flags; 2] = [Flags::RETAIN, Flags::PERSISTENT];

fn kept(image: &[u8], block: [u8; 16], retain: bool) -> Kept {
    let layout = Layout::of(&Image::parse(image).unwrap()).into();
    Kept { layout, block: block.to_vec(), retain }
}

fn values(a: u8, b: u8) -> [u8; 16] {
    [[a; 8], [b; 8]].concat().try_into().unwrap()
}

#[test]
fn a_warm_start_has_all_a_cold_one_what_is_persistent() {
    let image = image(0, BOTH);
    let kept = kept(&image, values(1, 2), true);
    let begins = |mode| kept.beginning(&image, mode);
    assert_eq!(begins(StartMode::Warm), (restored::ALL, values(1, 2).to_vec()));
    assert_eq!(begins(StartMode::Cold), (restored::PERSISTENT, values(9, 2).to_vec()));
}

#[test]
fn after_a_download_the_first_start_is_cold() {
    let image = image(0, BOTH);
    let kept = kept(&image, values(9, 2), false);
    let begins = kept.beginning(&image, StartMode::Warm);
    assert_eq!(begins, (restored::PERSISTENT, values(9, 2).to_vec()));
}

#[test]
fn a_version_that_was_entered_since_finds_its_values_by_name() {
    let kept = kept(&image(0, BOTH), values(1, 2), true);
    let other = image(1, BOTH);
    let begins = kept.beginning(&other, StartMode::Warm);
    assert_eq!(begins, (restored::ALL, values(1, 2).to_vec()), "a block is in the order of names");
    let nothing = image(2, [Flags::NONE; 2]);
    assert_eq!(kept.beginning(&nothing, StartMode::Cold), (restored::NOTHING, Vec::new()));
    assert_eq!(kept.beginning(b"no image", StartMode::Warm).0, restored::NOTHING);
}
