//! What only an interface has; `virtio/carried_tests.rs` has the rest.

use super::*;
use crate::virtio::carried::tests::{Guest, Kind};

#[test]
fn a_driver_finds_the_interface() {
    let mut guest = Guest::new(Kind::Net);
    assert_eq!(guest.read(0x8), 1);
    assert_eq!([guest.read(0x100), guest.read(0x104)], [0x0000_0002, 0x0000_0700]);
    let offered = guest.registers.offered();
    let taken: u64 = bits(&RINGS) | bits(&FROM_GUEST) | bits(&TO_GUEST) | 1 << 15 | 1 << 5;
    assert_eq!(offered, taken, "{offered:#x}");
}

#[test]
fn what_the_guest_does_not_take_is_not_sent_to_it() {
    let v1 = 1 << 32;
    for (features, checksum, segments) in [
        (v1, false, [false; 3]),
        (v1 | 1 << 1 | 1 << 7, true, [true, false, false]),
        (v1 | 1 << 1 | 1 << 9, true, [false; 3]),
        // Segments without checksums are a mistake of the driver's, and so is notification without segments.
        (v1 | 1 << 7 | 1 << 8, false, [false; 3]),
    ] {
        assert_eq!(Agreed::of(features), Agreed { checksum, segments });
    }
}
