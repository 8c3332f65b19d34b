//! Where programs lie, and what the guest is told of them.

use takt_abi::program::{self, Program, WORK_BYTES_EACH, action, view_bytes};
use takt_plan::{Trust, program_table};
use takt_program::build::Object;
use takt_program::{Area, Image, ObjectKind};

use super::Case;
use super::images::{PRIVATE, builder, image, public, signed};

const KIB: u64 = 1 << 10;

/// Programs lie behind each other and behind the guest, page by page, in banks of the asked size.
#[test]
fn programs_lie_behind_the_guest_and_do_not_overlap() {
    let file = Case::new("placed")
        .file("a.plc", &image("a"))
        .file("b.plc", &image("b"))
        .program("a.plc", "bank = \"256KiB\"\nstate = \"8KiB\"\nsecond_state = true")
        .program("b.plc", "second_state = false")
        .good();
    let plc = &file.partitions()[0];
    let table = program_table(plc.programs(), plc.memory_bytes()).unwrap();
    let (a, b) = (table.programs[0], table.programs[1]);
    assert_eq!((table.count, table.programs[2]), (2, Program::NONE));
    assert_eq!(&a.name[..2], b"a\0");
    assert_eq!((a.image, a.bank_bytes, a.state_bytes), (2 << 20, 256 * KIB, 8 * KIB));
    assert_eq!((a.second_bank, a.state), (a.image + 256 * KIB, a.image + 512 * KIB));
    assert_eq!(a.image_bytes, image("a").len() as u64);
    // By itself a bank is a quarter larger than its image, in steps of 64 KiB.
    assert_eq!((b.bank_bytes, b.state_bytes), (64 * KIB, 64 * KIB));
    assert_eq!((a.second_state, b.second_state), (a.state + 8 * KIB, 0));
    assert_eq!(b.image, a.second_state + a.state_bytes);
    assert_eq!(table.work, b.state + b.state_bytes);
    assert_eq!(table.work + table.work_bytes, plc.memory_bytes());
    assert_eq!(plc.programs()[1].bytes(), image("b"));
}

#[test]
fn what_follows_from_errors_is_told() {
    let actions = |keys: &str| {
        let case = Case::new("actions").file("a.plc", &image("a")).program("a.plc", keys);
        let place = case.good().partitions()[0].programs()[0].place;
        [place.on_fault, place.on_overrun, place.on_deadline]
    };
    assert_eq!(actions(""), [action::STOP_PROGRAM, action::SKIP, action::LOG]);
    let keys = "on_fault = \"restart\"\non_overrun = \"stop-partition\"\non_deadline = \"skip\"";
    let expected = [action::RESTART_PROGRAM, action::STOP_PARTITION, action::SKIP];
    assert_eq!(actions(keys), expected);
    let expected = [action::WARM_RESTART_PROGRAM, action::SKIP, action::LOG];
    assert_eq!(actions("on_fault = \"warm-restart\""), expected);
}

#[test]
fn a_memory_that_is_too_small_is_told_what_it_lacks() {
    let mut large = builder("large");
    large.state_bytes = 8 << 20;
    large.object(Object {
        name: "jobs".to_owned(),
        kind: ObjectKind::Queue { message_bytes: 4096, depth: 1024 },
    });
    let large = large.build().unwrap();
    let case = Case::new("tight").file("large.plc", &large);
    case.program("large.plc", "").refused(&["case.toml:9:10:", "a `memory` of at least 17MiB"]);
    // Less of a reserve, and it fits.
    let case = Case::new("fits").file("large.plc", &large);
    let file = case.program("large.plc", "state = \"8MiB\"").good();
    let plc = &file.partitions()[0];
    let table = program_table(plc.programs(), plc.memory_bytes()).unwrap();
    let needed = WORK_BYTES_EACH + 16 * KIB + program::queue_bytes(4096, 1024);
    assert!(table.work_bytes >= needed);
}

/// The guest would find too late that the pages of many small objects, or the tables of a large bank, do not fit.
#[test]
fn whole_pages_of_objects_and_tables_of_banks_are_reckoned_with() {
    let mut many = builder("many");
    for number in 0..64 {
        let name = format!("last-{number}");
        many.object(Object { name, kind: ObjectKind::Mailbox { bytes: 1 } });
    }
    let many = many.build().unwrap();
    // In KiB. Each bank of less than 2 MiB may need two tables.
    let parsed = Image::parse(&many).unwrap();
    let views = view_bytes(parsed.area_bytes(Area::Input), parsed.area_bytes(Area::Output)) / KIB;
    let stack = u64::from(parsed.tasks().next().unwrap().stack_bytes) / KIB;
    let but_objects = WORK_BYTES_EACH / KIB + 2 * 2 * 4 + views + stack;
    // 16 MiB, less 2 MiB for the guest, 128 KiB for the banks and a page for each object.
    let with = |state: u64| {
        let case = Case::new("many").file("many.plc", &many);
        case.program("many.plc", &format!("bank = \"64KiB\"\nstate = \"{state}KiB\""))
    };
    // And a table for each 2 MiB of its state.
    let tables = 14_336 / 2_048 * 4;
    let most = 14_336 - 128 - but_objects - 256 - tables + 4;
    with(most).good();
    with(most + 4).refused(&["a `memory` of at least 17MiB"]);
    let with = |state: u64, more: &str| {
        let case = Case::new("bank").file("a.plc", &image("a"));
        case.program("a.plc", &format!("bank = \"6MiB\"\nstate = \"{state}KiB\"\n{more}"))
    };
    let most = 14_336 - 12_288 - but_objects - 4 * 3 * 4;
    with(most, "").good();
    with(most + 4, "").refused(&["a `memory` of at least 17MiB"]);
    // A second state has the same size, and a table at least.
    let most = (most - 4) / 8 * 4;
    with(most, "second_state = true").good();
    with(most + 4, "second_state = true").refused(&["a `memory` of at least 17MiB"]);
}

#[test]
fn an_image_is_trusted_by_its_signature_if_the_file_has_keys() {
    let trust = |bytes: &[u8], keys: &str| {
        let case = Case::new("trust").file("a.plc", bytes).program("a.plc", keys);
        case.good().partitions()[0].programs()[0].trust
    };
    assert_eq!(trust(&image("a"), ""), Trust::Unsigned);
    assert_eq!(trust(&signed("a"), ""), Trust::NotAsked);
    let keys = format!("keys = [\"{}\", \"{}\"]", public(&[9; 32]), public(&PRIVATE));
    let Trust::Signed(key) = trust(&signed("a"), &keys) else { panic!("not trusted") };
    assert!(keys.contains(&key.iter().map(|byte| format!("{byte:02x}")).collect::<String>()));
}
