//! A plan that lies is refused before a byte is touched, or stays within the state.

mod common;

use common::{Random, Source, TestMemory};
use takt_change::cost::{COMMIT_NS, GATHER_BYTES};
use takt_change::make::Change;
use takt_change::plan::{HEADER_BYTES, RECORD_BYTES};
use takt_change::{Conversion, Defect, Plan, Ready, Step};
use takt_program::{Elementary, Image};

const CASES: u64 = if cfg!(debug_assertions) { 20_000 } else { 500_000 };

/// Two images with states of 64 and 96 bytes, and the header of a plan between them.
struct Versions {
    old: Vec<u8>,
    new: Vec<u8>,
    header: Vec<u8>,
}

impl Versions {
    fn new() -> Self {
        let source = |elements: i64| {
            let element = Box::new(common::Ty::Elementary(Elementary::Dint));
            Source(vec![("a".into(), common::Ty::Array(1, elements, element))])
        };
        let (old, new) = (source(16).image(&[]), source(24).image(&[]));
        let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
        let mut header = Change::between(&a, &b).plans.unwrap().forward;
        header.truncate(HEADER_BYTES);
        Self { old, new, header }
    }

    fn images(&self) -> (Image<'_>, Image<'_>) {
        (Image::parse(&self.old).unwrap(), Image::parse(&self.new).unwrap())
    }

    fn plan(&self, steps: &[Step], saved: u32) -> Vec<u8> {
        let mut bytes = self.header.clone();
        bytes[12..16].copy_from_slice(&(steps.len() as u32).to_le_bytes());
        bytes[88..92].copy_from_slice(&saved.to_le_bytes());
        steps.iter().for_each(|step| bytes.extend_from_slice(&step.record()));
        bytes
    }
}

fn verdict(steps: &[Step], saved: u32) -> Result<(), Defect> {
    let versions = Versions::new();
    let (a, b) = versions.images();
    Plan::parse(&versions.plan(steps, saved), &a, &b).map(drop)
}

#[test]
fn each_rule_of_a_plan_is_kept() {
    let conversion = Conversion::between(Elementary::Int, Elementary::Dint).unwrap();
    let copy = |from, to, bytes| Step::Copy { from, to, bytes };
    assert_eq!(verdict(&[copy(60, 92, 4), Step::Save { from: 0, to: 0, bytes: 8 }], 8), Ok(()));
    assert_eq!(verdict(&[copy(61, 0, 4)], 0), Err(Defect::Range(0)));
    assert_eq!(verdict(&[copy(0, 93, 4)], 0), Err(Defect::Range(0)));
    assert_eq!(verdict(&[copy(0, 8, u32::MAX)], 0), Err(Defect::Range(0)));
    assert_eq!(verdict(&[copy(8, 8, 4)], 0), Err(Defect::Record(0)), "a copy to where it is");
    assert_eq!(verdict(&[copy(0, 8, 0)], 0), Err(Defect::Record(0)), "nothing");
    assert_eq!(verdict(&[copy(0, 8, 8), copy(32, 15, 4)], 0), Err(Defect::Order(1)), "twice");
    assert_eq!(verdict(&[copy(0, 8, 8), copy(32, 0, 4)], 0), Err(Defect::Order(1)), "backwards");
    let convert = |from, to, count| Step::Convert { from, to, count, conversion };
    assert_eq!(verdict(&[convert(60, 0, 2)], 0), Ok(()));
    assert_eq!(verdict(&[convert(60, 0, 3)], 0), Err(Defect::Range(0)));
    assert_eq!(verdict(&[convert(0, 0, u32::MAX)], 0), Err(Defect::Range(0)));
    assert_eq!(
        verdict(&[Step::Initial { to: 60, bytes: 8 }], 0),
        Err(Defect::Record(0)),
        "partly early"
    );
    assert_eq!(verdict(&[Step::Restore { from: 4, to: 0, bytes: 8 }], 8), Err(Defect::Range(0)));
    assert_eq!(verdict(&[Step::Save { from: 0, to: 4, bytes: 8 }], 8), Err(Defect::Range(0)));
    assert_eq!(verdict(&[Step::Save { from: 0, to: 0, bytes: 8 }], 1 << 20), Err(Defect::Room));
    let save = Step::Save { from: 0, to: 0, bytes: 8 };
    assert_eq!(verdict(&[save, copy(0, 8, 8)], 8), Err(Defect::Order(1)), "the groups' order");
    assert_eq!(verdict(&[Step::Reference { from: 57, to: 0 }], 0), Err(Defect::Range(0)));
    let versions = Versions::new();
    let (a, b) = versions.images();
    let mut unknown = versions.plan(&[copy(0, 8, 8)], 0);
    for (at, value) in [(0, 8), (1, 1), (3, 1)] {
        let kept = std::mem::replace(&mut unknown[HEADER_BYTES + at], value);
        assert_eq!(Plan::parse(&unknown, &a, &b).unwrap_err(), Defect::Record(0), "{at}");
        unknown[HEADER_BYTES + at] = kept;
    }
    // A conversion that loses something is none that can be written.
    assert_eq!(Conversion::between(Elementary::Dint, Elementary::Int), None);
    assert_eq!(Conversion::between(Elementary::Dint, Elementary::Real), None);
    assert_eq!(Conversion::between(Elementary::Int, Elementary::Uint), None);
}

#[test]
fn a_plan_is_for_two_images_only() {
    let versions = Versions::new();
    let ((a, b), bytes) = (versions.images(), versions.plan(&[], 0));
    assert!(Plan::parse(&bytes, &a, &b).is_ok());
    assert_eq!(Plan::parse(&bytes, &b, &a).unwrap_err(), Defect::Images);
    assert_eq!(Plan::parse(&bytes, &a, &a).unwrap_err(), Defect::Images);
    assert_eq!(Plan::parse(&bytes[..HEADER_BYTES - 1], &a, &b).unwrap_err(), Defect::Header);
    assert_eq!(Plan::parse(&[], &a, &b).unwrap_err(), Defect::Header);
}

#[test]
fn what_takes_too_long_has_no_place_between_two_cycles() {
    let elements = |n| {
        let ty = common::Ty::Array(1, n, Box::new(common::Ty::Elementary(Elementary::Dint)));
        common::Source(vec![
            ("front".into(), common::Ty::Elementary(Elementary::Dint)),
            ("a".into(), ty),
        ])
    };
    let without = |n| common::Source(elements(n).0.split_off(1));
    let change = |n| {
        let (old, new) = (without(n).image(&[]), elements(n).image(&[]));
        let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
        Change::between(&a, &b)
    };
    let most = i64::from(GATHER_BYTES / 4);
    assert!(change(most * 9 / 10).plans.is_some_and(|plans| plans.cost.nanoseconds() <= COMMIT_NS));
    let large = change(100_000);
    assert!(large.plans.is_none() && large.refusals.is_empty());
    assert!(large.large.is_some() && large.too_large.is_some());
}

#[test]
fn each_record_that_a_reference_is_compared_with_is_counted() {
    let early = (64..96).map(|to| Step::Initial { to, bytes: 1 });
    let references = (0..8).map(|n| Step::Reference { from: 8 * n, to: 8 * n });
    let steps: Vec<Step> = early.chain(references).collect();
    assert!(matches!(verdict(&steps, 0), Err(Defect::Cost { .. })));
    // Without the one or the other it is soon done.
    assert_eq!(verdict(&steps[..32], 0), Ok(()));
    assert_eq!(verdict(&steps[32..], 0), Ok(()));
}

#[test]
fn an_array_may_end_where_the_numbers_do() {
    let version = |low, up| {
        let element = Box::new(common::Ty::Elementary(Elementary::Dint));
        Source(vec![("a".into(), common::Ty::Array(low, up, element))]).image(&[])
    };
    for (old, new) in [
        (version(i64::MAX - 1, i64::MAX), version(i64::MAX - 2, i64::MAX)),
        (version(i64::MIN, i64::MIN + 1), version(i64::MIN, i64::MIN + 2)),
    ] {
        let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
        let plans = Change::between(&a, &b).plans.unwrap();
        assert!(Plan::parse(&plans.forward, &a, &b).is_ok());
    }
}

#[test]
fn plans_of_random_bytes_stay_within_the_state() {
    let mut accepted = 0;
    let versions = Versions::new();
    let (a, b) = versions.images();
    for seed in 1..=CASES {
        let random = &mut Random::new(seed);
        let step = |random: &mut Random| {
            let number = |random: &mut Random| match random.below(4) {
                0 => random.next() as u32,
                1 => random.below(100) as u32,
                _ => 4 * random.below(25) as u32,
            };
            let (from, to, bytes) = (number(random), number(random), number(random));
            match random.below(7) {
                0 => Step::Keep { at: from, bytes },
                1 => Step::Initial { to, bytes },
                2 => Step::Restore { from, to, bytes },
                3 => Step::Save { from, to, bytes },
                4 => Step::Reference { from, to },
                _ => Step::Copy { from, to, bytes },
            }
        };
        let steps: Vec<Step> = (0..random.below(4)).map(|_| step(random)).collect();
        let mut bytes = versions.plan(&steps, random.below(64) as u32);
        for _ in 0..random.below(3) {
            let at = random.below(bytes.len() as u64) as usize;
            // The hashes are compared first, and would hide all else.
            if !(16..80).contains(&at) {
                bytes[at] = random.next() as u8;
            }
        }
        if random.one_in(10) {
            bytes.truncate(random.below(bytes.len() as u64) as usize / RECORD_BYTES * RECORD_BYTES);
        }
        let Ok(plan) = Plan::parse(&bytes, &a, &b) else { continue };
        accepted += 1;
        // This memory panics at an access outside of the new state, which is the larger one.
        let mut memory = TestMemory::new(&[7; 64], 96, &b);
        let ready = Ready::new(plan);
        ready.prepare(0, u64::MAX, &mut memory);
        ready.apply(&mut memory);
    }
    assert!(accepted > CASES / 20, "{accepted}");
}
