//! Which frames pass the acceptance filter.

use takt_sja1000::{BitRate, Controller, ExtendedId, Filter, Id, StandardId};

use crate::chip::Chip;

fn started(filter: Filter) -> Chip {
    let chip = Chip::new();
    Controller::start(chip.clone(), BitRate::Kbit500, filter).unwrap();
    chip
}

fn standard(id: u16, remote: bool, data: &[u8]) -> Vec<u8> {
    let [high, low] = (id << 5).to_be_bytes();
    [&[u8::from(remote) << 6 | data.len() as u8, high, low], data].concat()
}

fn extended(id: u32, remote: bool) -> Vec<u8> {
    [&[0x80 | u8::from(remote) << 6][..], &(id << 3).to_be_bytes()].concat()
}

#[test]
fn all_means_all() {
    let chip = started(Filter::ALL);
    assert!(chip.deliver(&standard(0, false, &[])));
    assert!(chip.deliver(&standard(0x7ff, true, &[])));
    assert!(chip.deliver(&extended(0x1fff_ffff, true)));
    assert!(chip.deliver(&extended(0, false)));
}

#[test]
fn a_standard_identifier_passes_with_any_data() {
    let id = StandardId::new(0x5a3).unwrap();
    let chip = started(Filter::standard(id, StandardId::MAX));
    for data in [&[][..], &[0xff], &[0, 0xff], &[0x12, 0x34, 0x56]] {
        assert!(chip.deliver(&standard(0x5a3, false, data)), "{data:x?}");
    }
    assert!(chip.deliver(&standard(0x5a3, true, &[])));
    for bit in 0..11 {
        assert!(!chip.deliver(&standard(0x5a3 ^ 1 << bit, false, &[])), "bit {bit}");
    }
}

#[test]
fn bits_that_are_not_relevant_may_differ() {
    let range = StandardId::new(0x7f0).unwrap();
    let chip = started(Filter::standard(StandardId::new(0x12f).unwrap(), range));
    for id in 0..0x800 {
        let passed = chip.deliver(&standard(id, false, &[]));
        assert_eq!(passed, id >> 4 == 0x12, "{id:#x}");
    }
}

#[test]
fn an_extended_identifier_passes_alone() {
    let id = ExtendedId::new(0x1234_5678).unwrap();
    let chip = started(Filter::extended(id, ExtendedId::MAX));
    assert!(chip.deliver(&extended(0x1234_5678, false)));
    assert!(chip.deliver(&extended(0x1234_5678, true)));
    for bit in 0..29 {
        assert!(!chip.deliver(&extended(0x1234_5678 ^ 1 << bit, false)), "bit {bit}");
    }
}

#[test]
fn a_filter_for_several_identifiers_keeps_what_they_have_in_common() {
    let short = |id| Id::from(StandardId::new(id).unwrap());
    let long = |id| Id::from(ExtendedId::new(id).unwrap());
    let chip = started(Filter::for_all([short(0x181), short(0x182), short(0x281)].into_iter()));
    for id in 0..0x800 {
        let passed = chip.deliver(&standard(id, false, &[]));
        assert_eq!(passed, id & !0x303 == 0x80, "{id:#x}");
    }
    let chip = started(Filter::for_all([long(0x18ff_0001), long(0x18ff_0003)].into_iter()));
    for (id, passes) in [(0x18ff_0001, true), (0x18ff_0003, true), (0x18ff_0000, false)] {
        assert_eq!(chip.deliver(&extended(id, false)), passes, "{id:#x}");
    }
    assert_eq!(Filter::for_all([].into_iter()), Filter::ALL);
    assert_eq!(Filter::for_all([short(1), long(1)].into_iter()), Filter::ALL);
    assert_eq!(Filter::for_all([long(1), short(1)].into_iter()), Filter::ALL);
}
