//! The kernel adds a program's `init` as a task once, at the start of the guest.

use takt_change::make::Change;
use takt_program::build::{Builder, Task};
use takt_program::{CodeOffset, Image, Nanoseconds};

fn program(init: Option<CodeOffset>) -> Vec<u8> {
    let mut image = Builder::new("a");
    image.code = vec![0xc3; 2];
    image.init = init;
    image.task(Task {
        budget: Some(Nanoseconds(10_000)),
        ..Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0))
    });
    image.build().unwrap()
}

#[test]
fn init_neither_comes_nor_goes() {
    for (old, new, allowed) in [
        (None, Some(CodeOffset(1)), false),
        (Some(CodeOffset(1)), None, false),
        (Some(CodeOffset(1)), Some(CodeOffset(0)), true),
        (None, None, true),
    ] {
        let (a, b) = (program(old), program(new));
        let change = Change::between(&Image::parse(&a).unwrap(), &Image::parse(&b).unwrap());
        assert_eq!(change.refusals.is_empty(), allowed, "{old:?} {new:?}: {:?}", change.refusals);
    }
}
