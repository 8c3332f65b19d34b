//! The layout: what an opener compares, and that C and Rust mean the same bytes.

use std::collections::BTreeMap;
use std::process::Command;
use std::{env, fs};

use takt_channel::{
    DEPTH_MAX, Field, Geometry, GeometryError, Kind, MAGIC, MESSAGE_MAX, OpenError, Policy,
    QueuingDestination, QueuingSource, ReturnCode, SPARE, SamplingDestination, SamplingSource,
    Ticks, Tsc, VERSION, offset,
};

use crate::memory::{Queue, Region};

#[test]
fn every_header_field_that_differs_is_invalid_config() {
    let fields = [
        (offset::MAGIC, Field::Magic),
        (offset::VERSION, Field::Version),
        (offset::KIND, Field::Kind),
        (offset::POLICY, Field::Policy),
        (offset::MAXIMUM, Field::Maximum),
        (offset::DEPTH, Field::Depth),
        (offset::SLOTS, Field::Slots),
        (offset::SLOTS + 4, Field::Reserved),
    ];
    for (at, field) in fields {
        let queue = Queue::new(20, 3, Policy::Refuse);
        for region in [&queue.messages, &queue.acknowledgement] {
            let (word, shift) = (at / 8 * 8, at % 8 * 8);
            let honest = region.peek(word);
            region.poke(word, honest ^ 4 << shift);
            let source = QueuingSource::open(
                queue.messages.clone(),
                queue.acknowledgement.clone(),
                &queue.geometry,
            );
            let destination = QueuingDestination::open(
                queue.messages.clone(),
                queue.acknowledgement.clone(),
                &queue.geometry,
            );
            region.poke(word, honest);
            for error in [source.err().unwrap(), destination.err().unwrap()] {
                let OpenError::Header { field: found, .. } = error else { panic!("{error}") };
                assert_eq!((found, error.code()), (field, ReturnCode::InvalidConfig));
            }
        }
    }
}

#[test]
fn ends_of_another_shape_or_direction_do_not_open() {
    let file = Geometry::queuing(20, 3, Policy::Refuse).unwrap();
    let queue = Queue::new(20, 3, Policy::Refuse);
    let open = |geometry: &Geometry| {
        let (own, peer) = (queue.messages.clone(), queue.acknowledgement.clone());
        QueuingSource::open(own, peer, geometry).err()
    };
    assert_eq!(open(&file), None);
    for other in [
        Geometry::queuing(21, 3, Policy::Refuse),
        Geometry::queuing(20, 2, Policy::Refuse),
        Geometry::queuing(20, 3, Policy::Overwrite),
    ] {
        assert!(matches!(open(&other.unwrap()), Some(OpenError::Header { .. })), "{other:?}");
    }
    assert_eq!(open(&Geometry::sampling(20).unwrap()), Some(OpenError::NotQueuing));
    let (messages, acknowledgement) = (queue.messages.clone(), queue.acknowledgement.clone());
    let swapped = QueuingSource::open(acknowledgement, messages.clone(), &file).err();
    let expected = Kind::Acknowledgement as u32;
    let found = Kind::Queuing as u32;
    assert_eq!(swapped, Some(OpenError::Header { field: Field::Kind, expected, found }));
    let sampling = SamplingSource::open(messages.clone(), &file).err();
    assert_eq!(sampling, Some(OpenError::NotSampling));
    let sampling = SamplingDestination::open(messages, &file, Ticks(1)).err();
    assert_eq!(sampling, Some(OpenError::NotSampling));
}

#[test]
fn a_region_that_is_too_small_does_not_open() {
    let geometry = Geometry::sampling(20).unwrap();
    let given = geometry.source_bytes() - 8;
    let error = SamplingSource::open(Region::zeroed(given), &geometry).err();
    assert_eq!(error, Some(OpenError::TooSmall { needed: geometry.source_bytes(), given }));
}

#[test]
fn shapes_beyond_the_limits_do_not_exist() {
    assert_eq!(Geometry::sampling(0), Err(GeometryError::Maximum(0)));
    assert_eq!(Geometry::sampling(MESSAGE_MAX + 1), Err(GeometryError::Maximum(MESSAGE_MAX + 1)));
    assert_eq!(Geometry::queuing(1, 0, Policy::Refuse), Err(GeometryError::Depth(0)));
    let deep = Geometry::queuing(1, DEPTH_MAX + 1, Policy::Refuse);
    assert_eq!(deep, Err(GeometryError::Depth(DEPTH_MAX + 1)));
    assert!(Geometry::queuing(MESSAGE_MAX, DEPTH_MAX, Policy::Refuse).is_ok());
}

#[test]
fn a_header_is_repaired_without_a_change_to_what_is_behind_it() {
    let geometry = Geometry::sampling(20).unwrap();
    let mut region = Region::source(&geometry);
    let mut source = SamplingSource::open(region.clone(), &geometry).unwrap();
    let mut destination = SamplingDestination::open(region.clone(), &geometry, Ticks(9)).unwrap();
    source.write(b"kept", Tsc(1)).unwrap();
    (0..offset::EPOCH).step_by(8).for_each(|at| region.poke(at, u64::MAX));
    geometry.format_source(&mut region).unwrap();
    assert_eq!(destination.read(&mut [0; 20], Tsc(1)).unwrap().bytes, b"kept");
    assert!(SamplingSource::open(region, &geometry).is_ok());
}

#[test]
fn the_return_codes_have_the_numbers_of_the_standard() {
    use ReturnCode::{
        InvalidConfig, InvalidMode, InvalidParam, NoAction, NoError, NotAvailable, TimedOut,
    };
    let order =
        [NoError, NoAction, NotAvailable, InvalidParam, InvalidConfig, InvalidMode, TimedOut];
    assert_eq!(order.map(|code| code as u32), [0, 1, 2, 3, 4, 5, 6]);
}

/// What the C header says, by compiling and running a program that prints it.
#[test]
fn the_c_header_has_the_same_offsets_and_constants() {
    let expected = |maximum: u32, depth: u32| {
        let geometry = Geometry::queuing(maximum, depth, Policy::Refuse).unwrap();
        (geometry.slot_bytes() as u64, geometry.source_bytes() as u64)
    };
    let mut rust: BTreeMap<String, u64> = [
        ("magic", offset::MAGIC),
        ("version", offset::VERSION),
        ("kind", offset::KIND),
        ("policy", offset::POLICY),
        ("maximum", offset::MAXIMUM),
        ("depth", offset::DEPTH),
        ("slots", offset::SLOTS),
        ("epoch", offset::EPOCH),
        ("first", offset::FIRST),
        ("written", offset::WRITTEN),
        ("read", offset::READ),
        ("header_bytes", offset::SLOT),
        ("acknowledgement_bytes", offset::SLOT),
        ("sequence", offset::SEQUENCE),
        ("stamp", offset::STAMP),
        ("length", offset::LENGTH),
        ("payload", offset::PAYLOAD),
    ]
    .map(|(name, value)| (name.to_owned(), value as u64))
    .into();
    for (name, value) in [
        ("MAGIC", MAGIC),
        ("VERSION", VERSION),
        ("SPARE", SPARE),
        ("MESSAGE_MAX", MESSAGE_MAX),
        ("DEPTH_MAX", DEPTH_MAX),
        ("SAMPLING", Kind::Sampling as u32),
        ("QUEUING", Kind::Queuing as u32),
        ("ACKNOWLEDGEMENT", Kind::Acknowledgement as u32),
        ("REFUSE", Policy::Refuse as u32),
        ("OVERWRITE", Policy::Overwrite as u32),
        ("NO_ERROR", ReturnCode::NoError as u32),
        ("NO_ACTION", ReturnCode::NoAction as u32),
        ("NOT_AVAILABLE", ReturnCode::NotAvailable as u32),
        ("INVALID_PARAM", ReturnCode::InvalidParam as u32),
        ("INVALID_CONFIG", ReturnCode::InvalidConfig as u32),
        ("INVALID_MODE", ReturnCode::InvalidMode as u32),
        ("TIMED_OUT", ReturnCode::TimedOut as u32),
    ] {
        rust.insert(name.to_owned(), value.into());
    }
    for (maximum, depth) in [(1, 1), (40, 2), (41, 3), (MESSAGE_MAX, DEPTH_MAX)] {
        let (slot, region) = expected(maximum, depth);
        rust.insert(format!("slot {maximum}"), slot);
        rust.insert(format!("region {maximum} {depth}"), region);
    }

    let root = env!("CARGO_MANIFEST_DIR");
    let folder = env::temp_dir().join(format!("takt-channel-header-{}", std::process::id()));
    fs::create_dir_all(&folder).unwrap();
    let program = folder.join("layout");
    let compiled = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I"])
        .arg(format!("{root}/include"))
        .arg(format!("{root}/tests/layout.c"))
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let printed = Command::new(&program).output().unwrap();
    fs::remove_dir_all(&folder).unwrap();
    let c: BTreeMap<String, u64> = String::from_utf8(printed.stdout)
        .unwrap()
        .lines()
        .map(|line| line.split_once('=').unwrap())
        .map(|(name, value)| (name.to_owned(), value.parse().unwrap()))
        .collect();
    assert_eq!(c, rust);
}
