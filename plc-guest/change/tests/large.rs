//! Plans to a second state: while the old version writes, what a model by names says gets there, and back; and what is no
//! such plan is refused.

mod common;

use common::model::{expected, expected_both_ways, random_state, values};
use common::{Random, Source, TestStates, Ty};
use takt_change::large::{Check, Checked, PAGE, RECORDS};
use takt_change::make::{Change, Large};
use takt_change::plan::{HEADER_BYTES, RECORD_BYTES};
use takt_change::{Conversion, Defect, LargePlan, Plan, Step, is_to_second};
use takt_program::{Elementary, Image};

/// In a build without optimisation a case takes twenty times as long.
const CASES: u64 = if cfg!(debug_assertions) { 2_000 } else { 50_000 };
const HOSTILE: u64 = if cfg!(debug_assertions) { 20_000 } else { 500_000 };

/// Carries pages over in random pieces until none is dirty; `write` may change the old state between two of them, and tells
/// what it has changed. Returns the pages of the new state with references that have become NULL, and how many there are.
fn converge(
    random: &mut Random,
    plan: &LargePlan<'_>,
    old: &mut [u8],
    new: &mut [u8],
    dirty: &mut [bool],
    mut write: impl FnMut(&mut Random, &mut [u8], &mut [bool]),
) -> (Vec<u32>, u32) {
    let mut lost = Vec::new();
    let mut gone = vec![0; dirty.len()];
    while let Some(number) = dirty.iter().position(|dirty| *dirty) {
        dirty[number] = false;
        let mut page = plan.page(number as u32);
        loop {
            let mut states = TestStates { old, new, lost: Vec::new() };
            let done = plan.carry(&mut page, 1 + random.below(2_000), &mut states);
            lost.extend(states.lost.iter().map(|to| to / PAGE));
            if done {
                break;
            }
            write(random, old, dirty);
        }
        gone[number] = u32::from(page.gone);
        write(random, old, dirty);
    }
    (lost, gone.iter().sum())
}

/// Takes over one variable of another state.
fn write_one(
    random: &mut Random,
    source: &Source,
    other: &[u8],
    state: &mut [u8],
    dirty: &mut [bool],
) {
    if source.0.is_empty() {
        return;
    }
    let which = random.below(source.0.len() as u64) as usize;
    let (from, bytes) = (Ty::places(&source.0)[which] as usize, source.0[which].1.bytes() as usize);
    state[from..from + bytes].copy_from_slice(&other[from..from + bytes]);
    dirty[from / PAGE as usize..=(from + bytes - 1) / PAGE as usize].fill(true);
}

#[test]
fn a_state_that_is_written_to_gets_to_its_second_place_and_back() {
    let (mut straddling, mut converted, mut followed, mut lost) = (0, 0, 0, 0);
    for seed in 1..=CASES {
        let random = &mut Random::new(seed);
        let mut serial = 0;
        let mut old = Source::random(random, &mut serial);
        // So the others lie across the border of two pages.
        old.0.insert(0, ("text".into(), Ty::Text(PAGE - 80 + random.below(80) as u32)));
        let new = old.edited(random, &mut serial);
        let initial = random_state(random, &new, false);
        let (old_file, new_file) =
            (old.image(&random_state(random, &old, false)), new.image(&initial));
        let (a, b) = (Image::parse(&old_file).unwrap(), Image::parse(&new_file).unwrap());
        if !Change::between(&a, &b).refusals.is_empty() {
            continue;
        }
        let large = Large::between(&a, &b).unwrap();
        assert!(is_to_second(&large.forward) && Plan::parse(&large.forward, &a, &b).is_err());
        let there = LargePlan::parse(&large.forward, &a, &b).unwrap();
        let back = LargePlan::parse(&large.back, &b, &a).unwrap();

        let mut first = random_state(random, &old, true);
        let mut second = initial.clone();
        let other = random_state(random, &old, true);
        let mut dirty = vec![true; there.pages() as usize];
        let mut writes = random.below(6);
        let write = |random: &mut Random, state: &mut [u8], dirty: &mut [bool]| {
            if writes > 0 && random.one_in(2) {
                writes -= 1;
                write_one(random, &old, &other, state, dirty);
            }
        };
        let (nulls, gone) = converge(random, &there, &mut first, &mut second, &mut dirty, write);
        let (found, wanted) = (values(&new, &second), expected(&old, &first, &new, &initial));
        assert!(found == wanted, "seed {seed}\n{old:?}\n{new:?}");

        // The new version computes, and then the way is back. What it has not written to is not looked at.
        let mut dirty = vec![random.one_in(2); back.pages() as usize];
        nulls.iter().for_each(|page| dirty[*page as usize] = true);
        let during = random_state(random, &new, true);
        for _ in 0..random.below(4) {
            write_one(random, &new, &during, &mut second, &mut dirty);
        }
        let before = first.clone();
        converge(random, &back, &mut second, &mut first, &mut dirty, |_, _, _| {});
        let (found, wanted) =
            (values(&old, &first), expected_both_ways(&new, &second, &old, &before));
        assert!(found == wanted, "seed {seed}, back\n{old:?}\n{new:?}");

        straddling += u64::from(there.pages() > 1);
        let steps = large.forward[HEADER_BYTES..].chunks(RECORD_BYTES);
        converted += u64::from(steps.clone().any(|step| step[0] == 3));
        followed += u64::from(steps.clone().any(|step| step[0] == 7));
        lost += u64::from(gone > 0);
    }
    // The cases are what they are meant to be.
    for count in [straddling, converted, followed, lost] {
        assert!(count > CASES / 100, "{straddling} {converted} {followed} {lost}");
    }
}

/// Two images with states of 64 and 96 bytes.
fn versions() -> (Vec<u8>, Vec<u8>) {
    let source = |elements: i64| {
        let element = Box::new(Ty::Elementary(Elementary::Dint));
        Source(vec![("a".into(), Ty::Array(1, elements, element))])
    };
    (source(16).image(&[]), source(24).image(&[]))
}

fn plan(header: &[u8], steps: &[Step]) -> Vec<u8> {
    let mut bytes = header.to_vec();
    bytes[12..16].copy_from_slice(&(steps.len() as u32).to_le_bytes());
    steps.iter().for_each(|step| bytes.extend_from_slice(&step.record()));
    bytes
}

#[test]
fn each_rule_of_a_plan_to_a_second_state_is_kept() {
    let (old, new) = versions();
    let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
    let header = Large::between(&a, &b).unwrap().forward[..HEADER_BYTES].to_vec();
    let verdict =
        |steps: &[Step]| LargePlan::parse(&plan(&header, steps), &a, &b).map(|plan| plan.records());
    let copy = |from, to, bytes| Step::Copy { from, to, bytes };
    assert_eq!(verdict(&[copy(0, 0, 8), copy(8, 92, 4)]), Ok(2), "a copy may keep its place");
    assert_eq!(verdict(&[copy(0, 0, 8), copy(8, 4, 4)]), Ok(2), "and be written twice");
    assert_eq!(verdict(&[copy(61, 0, 4)]), Err(Defect::Range(0)));
    assert_eq!(verdict(&[copy(0, 93, 4)]), Err(Defect::Range(0)));
    assert_eq!(verdict(&[copy(0, 8, u32::MAX)]), Err(Defect::Range(0)));
    assert_eq!(verdict(&[copy(0, 0, 8), copy(7, 8, 4)]), Err(Defect::Order(1)), "read twice");
    let conversion = Conversion::between(Elementary::Int, Elementary::Dint).unwrap();
    let convert = |from, to, count| Step::Convert { from, to, count, conversion };
    assert_eq!(verdict(&[convert(60, 0, 2)]), Ok(1));
    assert_eq!(verdict(&[convert(60, 0, 3)]), Err(Defect::Range(0)));
    assert_eq!(verdict(&[convert(0, 0, u32::MAX)]), Err(Defect::Range(0)));
    assert_eq!(verdict(&[Step::Reference { from: 57, to: 0 }]), Err(Defect::Range(0)));
    for none in [
        Step::Keep { at: 0, bytes: 4 },
        Step::Initial { to: 0, bytes: 4 },
        Step::Save { from: 0, to: 0, bytes: 4 },
        Step::Restore { from: 0, to: 0, bytes: 4 },
    ] {
        assert_eq!(verdict(&[none]), Err(Defect::Record(0)));
    }
    let refused = |bytes: &[u8]| Check::begin(bytes, &a, &b).unwrap_err();
    let mut bytes = plan(&header, &[copy(0, 0, 8)]);
    assert_eq!(LargePlan::parse(&bytes, &b, &a).unwrap_err(), Defect::Images);
    bytes[88] = 1;
    assert_eq!(refused(&bytes), Defect::Room, "nothing is put aside");
    assert_eq!(refused(&bytes[..bytes.len() - 1]), Defect::Header);
    let in_place = Change::between(&a, &b).plans.unwrap().forward;
    assert_eq!(refused(&in_place), Defect::Header);
    let mut long = header.clone();
    long[12..16].copy_from_slice(&(RECORDS + 1).to_le_bytes());
    long.resize(HEADER_BYTES + (RECORDS as usize + 1) * RECORD_BYTES, 0);
    assert_eq!(refused(&long), Defect::Header);
}

#[test]
fn plans_to_a_second_state_of_random_bytes_stay_within_both() {
    let (old, new) = versions();
    let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
    let header = Large::between(&a, &b).unwrap().forward[..HEADER_BYTES].to_vec();
    let mut accepted = 0;
    for seed in 1..=HOSTILE {
        let random = &mut Random::new(seed);
        let step = |random: &mut Random| {
            let number = |random: &mut Random| match random.below(4) {
                0 => random.next() as u32,
                1 => random.below(100) as u32,
                _ => 4 * random.below(20) as u32,
            };
            let (from, to, bytes) = (number(random), number(random), number(random));
            let conversion = Conversion::between(Elementary::Int, Elementary::Lint).unwrap();
            match random.below(8) {
                0 => Step::Reference { from, to },
                1 => Step::Convert { from, to, count: bytes, conversion },
                2 => Step::Keep { at: from, bytes },
                _ => Step::Copy { from, to, bytes },
            }
        };
        let steps: Vec<Step> = (0..random.below(4)).map(|_| step(random)).collect();
        let mut bytes = plan(&header, &steps);
        for _ in 0..random.below(3) {
            let at = random.below(bytes.len() as u64) as usize;
            // The hashes are compared first, and would hide all else.
            if !(16..80).contains(&at) {
                bytes[at] = random.next() as u8;
            }
        }
        let Ok(mut check) = Check::begin(&bytes, &a, &b) else { continue };
        let plan = loop {
            match check.some(1 + random.below(3) as u32) {
                Ok(Checked::Partly(next)) => check = next,
                Ok(Checked::Whole(plan)) => break Some(plan),
                Err(_) => break None,
            }
        };
        let Some(plan) = plan else { continue };
        accepted += 1;
        let (old, mut new) = ([0x50; 64], [0; 96]);
        for number in 0..plan.pages() + 1 {
            let mut page = plan.page(number);
            let mut pieces = 0;
            let states = &mut TestStates { old: &old, new: &mut new, lost: Vec::new() };
            while !plan.carry(&mut page, 1, states) {
                pieces += 1;
                assert!(pieces <= PAGE, "a piece carries something over");
            }
        }
    }
    assert!(accepted > HOSTILE / 20, "{accepted}");
}

/// A megabyte of instances that grow: far more than fits between two cycles.
#[test]
fn instances_that_grow_take_a_second_state() {
    let source = |fields: &[(&str, Elementary)]| {
        let fields = fields.iter().map(|(name, ty)| ((*name).into(), Ty::Elementary(*ty)));
        let instance = Ty::Structure("S".into(), fields.collect());
        Source(vec![("s".into(), Ty::Array(1, 4096, Box::new(instance)))])
    };
    let old = source(&[("a", Elementary::Lint), ("b", Elementary::Int)]);
    let new = source(&[("n", Elementary::Dint), ("a", Elementary::Lint), ("b", Elementary::Dint)]);
    let (old, new) = (old.image(&[]), new.image(&[]));
    let (a, b) = (Image::parse(&old).unwrap(), Image::parse(&new).unwrap());
    let change = Change::between(&a, &b);
    assert!(change.plans.is_none() && change.too_large.is_some() && change.refusals.is_empty());
    let large = change.large.unwrap();
    assert_eq!(large.records, 2 * 4096);
    assert_eq!(large.nanoseconds, 4096 * (250 + 2 + 250 + 200));
    assert_eq!(LargePlan::parse(&large.forward, &a, &b).unwrap().pages(), 16);
}
