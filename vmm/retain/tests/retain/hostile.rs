//! Files that are cut, changed, or made up: a whole generation or none, never a mixture.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use crate::common::{Own, block, files_are_our_own, image, layout};
use takt_program::{Elementary, Flags};
use takt_retain::{Damage, Generation, LENGTH_MAX, Layout, Store};

fn kept() -> Layout {
    let own = [
        ("n", Own::One(Elementary::Lint), Flags::RETAIN),
        ("mix", Own::Block, Flags::PERSISTENT),
        ("row", Own::Array(-2, 2), Flags::RETAIN),
    ];
    layout(&image(0, &own))
}

/// The generations 1 to `last` of a store in this folder; the seed of each is its number.
fn written(folder: &Path, last: u8) -> Layout {
    let layout = kept();
    let (mut store, found) = Store::open(&folder.join("tank")).unwrap();
    assert!(found.newest.is_none() && found.damaged.is_empty());
    for number in 1..=last {
        let saved = store.save(number.into(), &layout, &block(&layout, number)).unwrap();
        assert_eq!(saved, u64::from(number));
    }
    layout
}

/// The number of the generation that is found, whose values must all be its own; and how many files are damaged.
fn found(folder: &Path, layout: &Layout) -> (u64, usize) {
    let (_, found) = Store::open(&folder.join("tank")).unwrap();
    let number = found.newest.map_or(0, |newest| {
        let restored = layout.restore(&newest);
        assert!(restored.retain && !restored.is_partial(), "{restored}");
        let whole = layout.restore(
            &Generation::decode(
                &Generation::encode(1, 1, layout, &block(layout, newest.number as u8)).unwrap(),
            )
            .unwrap(),
        );
        assert_eq!(restored.block, whole.block, "values of generation {}", newest.number);
        assert_eq!(newest.cycle, newest.number);
        newest.number
    });
    (number, found.damaged.len())
}

#[test]
fn a_file_that_is_cut_at_any_length_leaves_the_last_or_the_last_but_one() {
    let _alone = files_are_our_own();
    let folder = tempfile::tempdir().unwrap();
    let layout = written(folder.path(), 4);
    let [older, newer] = Store::paths(&folder.path().join("tank"));
    let [three, four] = [&older, &newer].map(|path| fs::read(path).unwrap());
    assert_eq!(three.len() as u64, layout.file_bytes());
    for length in 0..=four.len() {
        fs::write(&newer, &four[..length]).unwrap();
        let whole = length == four.len();
        assert_eq!(found(folder.path(), &layout), if whole { (4, 0) } else { (3, 1) }, "{length}");
    }
    // A write over the older file was cut short: what is behind it are the bytes from before.
    let five = Generation::encode(5, 5, &layout, &block(&layout, 5)).unwrap();
    for length in 0..=five.len() {
        let torn: Vec<u8> = five[..length].iter().chain(&three[length..]).copied().collect();
        fs::write(&older, torn).unwrap();
        let number = if length == five.len() { 5 } else { 4 };
        assert_eq!(found(folder.path(), &layout).0, number, "{length}");
    }
}

#[test]
fn a_generation_is_written_over_the_older_one_also_after_a_failure() {
    let _alone = files_are_our_own();
    let folder = tempfile::tempdir().unwrap();
    let layout = written(folder.path(), 3);
    let [_, second] = Store::paths(&folder.path().join("tank"));
    let (mut store, _) = Store::open(&folder.path().join("tank")).unwrap();
    assert!(store.save(4, &layout, &[1, 2, 3]).is_err(), "no block of this layout");
    assert_eq!(store.save(4, &layout, &block(&layout, 4)).unwrap(), 4);
    assert_eq!(Generation::decode(&fs::read(second).unwrap()).unwrap().number, 4);
    drop(store);
    // A longer generation was there before.
    let own = [("n", Own::One(Elementary::Lint), Flags::RETAIN)];
    let short = crate::common::layout(&image(1, &own));
    let (mut store, _) = Store::open(&folder.path().join("tank")).unwrap();
    store.save(5, &short, &block(&short, 5)).unwrap();
    drop(store);
    let (_, found) = Store::open(&folder.path().join("tank")).unwrap();
    assert_eq!((found.newest.unwrap().number, found.damaged.len()), (5, 0));
}

#[test]
fn a_file_that_cannot_be_read_leaves_the_other_one_if_that_is_whole() {
    let _alone = files_are_our_own();
    let folder = tempfile::tempdir().unwrap();
    let layout = written(folder.path(), 4);
    let [older, newer] = Store::paths(&folder.path().join("tank"));
    // The first page of this process's memory, which is not there: reading it is an error of I/O.
    fs::remove_file(&newer).unwrap();
    symlink("/proc/self/mem", &newer).unwrap();
    assert_eq!(found(folder.path(), &layout), (3, 1));
    // The values may be in the file that cannot be read: not to start is better than to start without them.
    fs::write(&older, "").unwrap();
    let error = Store::open(&folder.path().join("tank")).unwrap_err();
    assert!(error.to_string().contains("Input/output error"), "{error}");
}

#[test]
fn files_belong_to_one_process_and_have_a_folder() {
    let _alone = files_are_our_own();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tank");
    let (_store, _) = Store::open(&path).unwrap();
    assert!(Store::open(&path).unwrap_err().to_string().contains("another process"));
    assert!(Store::open(&folder.path().join("none/tank")).is_err());
}

#[test]
fn each_byte_counts() {
    let layout = kept();
    let good = Generation::encode(1, 1, &layout, &block(&layout, 1)).unwrap();
    for at in 0..good.len() {
        for bit in [1, 0x80] {
            let mut bad = good.clone();
            bad[at] ^= bit;
            assert!(Generation::decode(&bad).is_err(), "byte {at}");
        }
    }
    let mut long = good.clone();
    long[16..24].copy_from_slice(&(LENGTH_MAX + 1).to_le_bytes());
    assert_eq!(Generation::decode(&long), Err(Damage::Length(LENGTH_MAX + 1)));
    let mut other = good;
    other[8] = 2;
    assert_eq!(Generation::decode(&other), Err(Damage::Version(2)));
}

/// A file that an attacker made has a right checksum.
fn with_checksum(mut bytes: Vec<u8>) -> Vec<u8> {
    use sha2::{Digest, Sha256};
    let length = bytes.len() as u64;
    if bytes.len() >= 104 {
        bytes[..8].copy_from_slice(b"TAKTKEEP");
        bytes[8..12].copy_from_slice(&1u32.to_le_bytes());
        bytes[16..24].copy_from_slice(&length.to_le_bytes());
        let end = bytes.len() - 32;
        let checksum = Sha256::digest(&bytes[..end]);
        bytes[end..].copy_from_slice(&checksum);
    }
    bytes
}

/// After the highest number no newer generation could be told from an older one.
#[test]
fn a_number_that_no_file_gets_to_is_damage() {
    let layout = kept();
    for number in [0, u64::MAX] {
        let bytes = Generation::encode(number, 1, &layout, &block(&layout, 1)).unwrap();
        assert_eq!(Generation::decode(&bytes), Err(Damage::Number(number)));
    }
    let _alone = files_are_our_own();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tank");
    let last = Generation::encode(u64::MAX - 1, 1, &layout, &block(&layout, 1)).unwrap();
    fs::write(&Store::paths(&path)[0], last).unwrap();
    let (mut store, _) = Store::open(&path).unwrap();
    assert!(store.save(2, &layout, &block(&layout, 2)).is_err(), "there is no number left");
    assert!(store.save(2, &layout, &block(&layout, 2)).is_err(), "and there stays none");
}

/// Numbers that look random, the same each time (splitmix64).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, below: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ (mixed >> 31)) % below as u64) as usize
    }
}

/// Any values with a right checksum are read, or refused; what is read fits into the program.
#[test]
fn values_of_an_attacker_stay_within_the_block() {
    let layout = kept();
    let good = Generation::encode(1, 1, &layout, &block(&layout, 1)).unwrap();
    let (mut numbers, mut read) = (Numbers(1), 0);
    for _ in 0..100_000 {
        let mut bytes = good.clone();
        if numbers.next(4) == 0 {
            bytes[12] = numbers.next(8) as u8;
        }
        bytes.truncate(bytes.len() - numbers.next(4).saturating_sub(2) * numbers.next(64));
        for _ in 0..numbers.next(6) {
            let at = 72 + numbers.next(bytes.len() - 72);
            bytes[at] = [0, 1, 0x7f, 0x80, 0xff, numbers.next(256) as u8][numbers.next(6)];
        }
        if let Ok(generation) = Generation::decode(&with_checksum(bytes)) {
            read += 1;
            let restored = layout.restore(&generation);
            assert_eq!(restored.block.len(), layout.initial().len());
            assert!(!restored.to_string().is_empty() || !restored.is_partial());
        }
    }
    assert!((10_000..90_000).contains(&read), "{read} were read: neither all nor none");
}

#[test]
fn any_bytes_are_a_generation_or_none() {
    let mut numbers = Numbers(2);
    for _ in 0..100_000 {
        let bytes: Vec<u8> = (0..numbers.next(300)).map(|_| numbers.next(256) as u8).collect();
        assert!(Generation::decode(&bytes).is_err());
        let _ = Generation::decode(&with_checksum(bytes));
    }
}
