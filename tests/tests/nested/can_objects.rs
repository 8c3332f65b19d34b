//! CAN objects: inputs and outputs of programs on a bus, with partners, without, and with cards that lie.

use std::fs;

use takt_program::Elementary::{Dword, Lword};
use takt_test_programs::{Entry, Program, cyclic, us};
use takt_tests::{File, Outcome, Run, long, plc_image, save_bytes, target};

use crate::passthrough::numbers;

/// Where the two cards of the emulated machine are.
const KVASER: &str = "[[partition.port_io]]\nports = \"0x2000-0x201f\"\npci = \"0000:00:10.0\"\n\
    bar = 1\n[[partition.can]]\nname = \"bus\"\nport = \"0x2000\"\nbit_rate = \"500kbit/s\"\n";
const MIOE: &str = "[[partition.port_io]]\nports = \"0x2400-0x247f\"\npci = \"0000:00:11.0\"\n\
    bar = 0\n[[partition.can]]\nname = \"bus\"\nport = \"0x2400\"\nstride = 4\n\
    bit_rate = \"500kbit/s\"\n";

/// The lines of a PLC with these programs and further lines.
fn plc(test: &str, programs: &[(&str, Program)], more: &str) -> String {
    let tables = programs.iter().map(|(name, program)| {
        let image = save_bytes(&format!("{test}-{name}.plc"), &program.image());
        format!("[[partition.program]]\nimage = {image:?}\nname = {name:?}\n")
    });
    format!("memory = \"16MiB\"\n{}{more}", tables.collect::<String>())
}

/// A point of a program in an object, with further keys.
fn io(program: &str, point: &str, id: u32, keys: &str) -> String {
    format!(
        "[[partition.io]]\nprogram = {program:?}\npoint = {point:?}\ncan = \"bus\"\n\
         id = \"{id:#x}\"\n{keys}\n"
    )
}

/// What the last row of a controller says.
fn figures<const N: usize>(
    outcome: &Outcome,
    partition: &str,
    can: &str,
    words: [&str; N],
) -> [u64; N] {
    let row = format!("[{partition}] CAN {can}: ");
    let last = outcome.output.lines().rev().find(|line| line.contains(&row));
    let last = last.unwrap_or_else(|| panic!("no row of {can}\n{}", outcome.output));
    words.map(|word| {
        let (_, rest) = last.split_once(&format!("{word} ")).unwrap_or_else(|| panic!("{last}"));
        let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
        digits.parse().unwrap_or_else(|_| panic!("no number behind {word} in {last}"))
    })
}

/// Nothing of these happened at a controller, which gets on well with its bus.
fn assert_clean(outcome: &Outcome, partition: &str) {
    outcome.assert_shows(&format!("[{partition}] CAN bus: error active, "));
    let words = ["foreign", "short", "replaced", "overruns", "bus-offs"];
    assert_eq!(figures(outcome, partition, "bus", words), [0; 5], "{}", outcome.output);
}

fn assert_good(outcome: &Outcome, partitions: &[&str]) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("stops itself"), "{}", outcome.output);
    for partition in partitions {
        for key in ["illegal_accesses", "lost", "late_releases"] {
            assert_eq!(outcome.number(partition, key), 0, "{key}\n{}", outcome.output);
        }
        outcome.assert_punctual(partition);
    }
}

/// A copy of a program on the other card returns two objects whose values have to be the same.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn values_go_out_on_one_card_and_come_back_by_the_other() {
    let count = Program::new("count")
        .task(cyclic("main", us(1_000), 1, Entry::TwoOutputs), 10)
        .output("one", Lword, 0, 0)
        .output("two", Lword, 8, 0);
    let check = Program::new("check")
        .task(cyclic("main", us(1_000), 0, Entry::TwoInputs), 1_000)
        .input("one", Lword, 0)
        .input("two", Lword, 8);
    let copy = Program::new("copy")
        .task(cyclic("main", us(1_000), 0, Entry::CopyInputs), 0)
        .input("one", Lword, 0)
        .input("two", Lword, 8)
        .output("back-one", Lword, 0, 0)
        .output("back-two", Lword, 8, 0);
    let whole = "byte = 0";
    let long_id = "byte = 0\nextended = true";
    let near = io("count", "one", 0x201, whole)
        + &io("count", "two", 0x202, whole)
        + &io("check", "one", 0x301, whole)
        + &io("check", "two", 0x18ff_0301, long_id);
    let far = io("copy", "one", 0x201, whole)
        + &io("copy", "two", 0x202, whole)
        + &io("copy", "back-one", 0x301, whole)
        + &io("copy", "back-two", 0x18ff_0301, long_id);
    let programs = [("count", count), ("check", check)];
    let (duration, seconds) = if long() { ("60s", 60) } else { ("3s", 3) };
    let outcome = File::new("1ms")
        .plc_with("near", &plc("can-near", &programs, &(near + KVASER)))
        .plc_with("far", &plc("can-far", &[("copy", copy)], &(far + MIOE)))
        .schedule("normal")
        .window("near", 0, 300)
        .window("far", 500, 300)
        .run("can-back")
        .lasting(duration)
        .with("--device")
        .with("can")
        .run();
    assert_good(&outcome, &["near", "far"]);
    outcome.assert_shows("check.main: more");
    for partition in ["near", "far"] {
        assert_clean(&outcome, partition);
        let [received, sent] = figures(&outcome, partition, "bus", ["received", "sent"]);
        // Two objects of each job, but for those of the first, and what is on its way.
        let enough = sent >= 2 * 633 * seconds;
        assert!(enough && sent.abs_diff(received) <= 4, "{sent} and {received}");
    }
    outcome.assert_kept_its_time("near", 1_000 * seconds - 100);
    outcome.assert_kept_its_time("far", 1_000 * seconds - 100);
}

/// A program fails, and what it has told on the bus is held or becomes zero, as its table says.
#[test]
fn objects_of_a_program_that_has_failed_are_zero_or_held() {
    let failing = Program::new("failing")
        .task(cyclic("main", us(1_000), 0, Entry::FaultingOutputs), 100)
        .output("held", Lword, 0, 0)
        .output("zeroed", Lword, 8, 0);
    let watch = || {
        let program =
            Program::new("watch").task(cyclic("main", us(1_000), 1, Entry::RiseAndFall), 0);
        program.input("value", Lword, 0)
    };
    let near = io("failing", "held", 0x201, "byte = 0\non_stop = \"hold\"")
        + &io("failing", "zeroed", 0x202, "byte = 0\nsend = \"on-change\"");
    let far = io("held", "value", 0x201, "byte = 0") + &io("zeroed", "value", 0x202, "byte = 0");
    let watching = [("held", watch()), ("zeroed", watch())];
    let outcome = File::new("1ms")
        .plc_with("near", &plc("can-stop", &[("failing", failing)], &(near + KVASER)))
        .plc_with("far", &plc("can-watch", &watching, &(far + MIOE)))
        .schedule("normal")
        .window("near", 0, 300)
        .window("far", 500, 300)
        .run("can-stop")
        .lasting("1500ms")
        .with("--device")
        .with("can")
        .run();
    assert_good(&outcome, &["near", "far"]);
    outcome.assert_shows("program failing, task main: invalid opcode");
    assert_eq!(outcome.output.matches("zeroed.main: fell").count(), 1, "{}", outcome.output);
    outcome.assert_shows("held.main: rose");
    assert!(!outcome.output.contains("held.main: fell"), "{}", outcome.output);
    // 99 complete jobs; what is sent when it changes left once for them, and once for the stop.
    assert_eq!(figures(&outcome, "near", "bus", ["sent"]), [99 + 2], "{}", outcome.output);
    assert_clean(&outcome, "far");
}

/// Another node floods the bus with frames of no object: two in each job of a program that takes one.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn foreign_frames_are_counted_and_no_release_is_lost() {
    let program = Program::new("p")
        .task(cyclic("main", us(2_000), 0, Entry::CopyInputs), 0)
        .input("value", Dword, 0)
        .input("count", Dword, 4)
        .output("told", Lword, 0, 0);
    // With identifiers of both kinds the card's filter lets everything pass.
    let tables = io("p", "value", 0x181, "byte = 0")
        + &io("p", "count", 0x18ff_0181, "count = true\nextended = true")
        + &io("p", "told", 0x201, "byte = 0");
    let frames = "frames_per_job = 1\n";
    let noise =
        "[[partition.port_io]]\nports = \"0x2400-0x247f\"\npci = \"0000:00:11.0\"\nbar = 0\n";
    let outcome = File::new("1ms")
        .plc_with("plc", &plc("can-foreign", &[("p", program)], &(tables + KVASER + frames)))
        .plc("noise", Some(plc_image("can-echo")), noise)
        .schedule("normal")
        .window("plc", 0, 300)
        .window("noise", 500, 300)
        .run("can-foreign")
        .lasting("3500ms")
        .with("--device")
        .with("can")
        .run();
    assert_good(&outcome, &["plc"]);
    let words = ["received", "sent", "foreign", "overruns"];
    let [received, sent, foreign, overruns] = figures(&outcome, "plc", "bus", words);
    // One of two is taken in each job. The card loses the others, and says so.
    assert_eq!(received, 0, "{}", outcome.output);
    assert!(sent >= 900 && foreign.abs_diff(sent) <= 2, "{}", outcome.output);
    assert!(overruns > 100, "{}", outcome.output);
    let [theirs] = numbers(&outcome, "noise", ["foreign"]);
    assert!(theirs.abs_diff(sent) < 600 && theirs > 500, "{}", outcome.output);
}

/// Memory in place of four cards. Its bytes stay as they are, so the card that it looks like lies.
#[test]
fn cards_that_lie_or_are_none_stall_nothing_and_are_told() {
    fs::create_dir_all(target("tests")).expect("the folder can be made");
    let shared = target("tests/can-shared");
    let mut bytes = vec![0; 1 << 20];
    // The status of each: no node acknowledges, there is always one more frame, off the bus. The last is none.
    for (offset, status) in [(0, 0x40), (0x100, 0x05), (0x200, 0x80)] {
        bytes[offset + 2] = status;
    }
    bytes[0x300..0x320].fill(0xff);
    fs::write(&shared, bytes).expect("the file can be written");

    let program = Program::new("p")
        .task(cyclic("main", us(1_000), 0, Entry::NewInput), 0)
        .input("now", Lword, 0)
        .input("value", Lword, 8)
        .output("jobs", Lword, 0, 0);
    let cards = [("alone", 0), ("endless", 0x100), ("off", 0x200), ("none", 0x300)].map(
        |(name, offset)| {
            format!(
                "[[partition.can]]\nname = {name:?}\nmmio = \"card\"\noffset = \"{offset:#x}\"\n\
                 bit_rate = \"125kbit/s\"\n"
            )
        },
    );
    let ramp = "[[partition.io]]\npoint = \"now\"\n\
        simulate = { shape = \"ramp\", low = 1, high = 1000000000001, period = \"1000s\" }\n";
    let object = |point: &str, card: &str, id: u32, at: &str| {
        format!("[[partition.io]]\n{point}\ncan = {card:?}\nid = \"{id:#x}\"\nbyte = {at}\n")
    };
    let mut tables = ramp.to_owned();
    for (n, card) in ["alone", "endless", "off", "none"].into_iter().enumerate() {
        tables += &object(&format!("at = \"%QB{n}\""), card, 0x201, "0");
        tables += &object(&format!("at = \"%IW{}\"", 4 + n), card, 0x181, "0");
    }
    let more = format!(
        "[[partition.mmio]]\nname = \"card\"\naddress = \"0xd0000000\"\nsize = \"4KiB\"\n\
         pci = \"0000:00:08.0\"\nbar = 2\n{}{tables}",
        cards.concat()
    );
    let outcome = File::new("1ms")
        .plc_with("plc", &plc("can-lies", &[("p", program)], &more))
        .schedule("normal")
        .window("plc", 0, 300)
        .run("can-lies")
        .lasting("4s")
        .with("--device")
        .with(&format!("shared={}", shared.display()))
        .run();
    assert_good(&outcome, &["plc"]);
    outcome.assert_kept_its_time("plc", 3_900);
    outcome.assert_shows("[plc] CAN none: no controller answers");
    outcome.assert_shows("[plc] CAN none: not started");
    outcome.assert_shows("[plc] CAN alone: error warning, ");
    outcome.assert_shows("[plc] CAN off: recovering, ");
    let words = ["received", "sent", "foreign", "replaced", "bus-offs"];
    let of = |can: &str| figures(&outcome, "plc", can, words);
    let [received, sent, foreign, replaced, offs] = of("alone");
    assert!(
        (received, sent, foreign, offs) == (0, 0, 0, 0) && replaced > 2_500,
        "{}",
        outcome.output
    );
    // Four frames in each job, and what is sent is always taken.
    let [received, sent, foreign, ..] = of("endless");
    assert_eq!((received + foreign) / 4, sent, "{}", outcome.output);
    assert!(sent > 2_500, "{}", outcome.output);
    let [received, sent, _, _, offs] = of("off");
    assert_eq!((received, sent, offs), (0, 0, 1), "{}", outcome.output);
}

/// The example: a drive and its motor, each in a PLC of its own.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_drive_and_its_motor_meet_on_a_bus_beside_a_linux() {
    let outcome =
        Run::of("configs/can-programs.toml").lasting("5s").with("--device").with("can").run();
    assert_good(&outcome, &["drive", "motor"]);
    let said = outcome.output.lines().filter(|line| line.contains("the motor has its speed, told"));
    assert_eq!(said.count(), 1, "{}", outcome.output);
    assert!(!outcome.output.contains("the motor is silent"), "{}", outcome.output);
    for partition in ["drive", "motor"] {
        outcome.assert_kept_its_time(partition, 450);
        outcome.assert_shows(&format!("[{partition}] CAN line: error active, "));
        let words = ["received", "sent", "foreign", "short", "replaced", "overruns", "bus-offs"];
        let [received, sent, bad @ ..] = figures(&outcome, partition, "line", words);
        assert!(sent > 250 && sent.abs_diff(received) <= 2, "{sent} and {received}");
        assert_eq!(bad, [0; 5], "{}", outcome.output);
    }
}
