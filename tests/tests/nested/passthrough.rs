//! Devices of the host in the hands of a PLC: what it writes arrives, what is not its own does not
//! answer, and safe values come last.

use std::fs;
use std::path::{Path, PathBuf};

use takt_tests::{File, Host, Outcome, Run, long, plc_image, target};

use crate::devices::{EDU, EDU_INTERRUPT, PRINTER};

/// A printer, the registers of QEMU's `edu`, and the value for one of these.
fn devices() -> String {
    let value =
        "[[partition.safe_value]]\nmmio = \"edu\"\noffset = \"0x4\"\nwidth = 4\nvalue = \"0x0\"\n";
    format!("{EDU}{value}{PRINTER}")
}

/// Ports but those that are Takt's, and large pages of the devices' area.
const PLACES: u64 = 0x1_0000 - 0x100 + 128;

/// A file that is not there, for what is printed, and the option that puts it there.
fn printer(name: &str) -> (PathBuf, String) {
    let printed = target("tests").join(name);
    let _ = fs::remove_file(&printed);
    let device = format!("parallel={}", printed.display());
    (printed, device)
}

/// Fails unless each scan has printed one byte, none is missing, and then came the safe value, once.
fn assert_printed(outcome: &Outcome, partition: &str, printed: &Path) {
    let printed = fs::read(printed).expect("QEMU has written the file");
    let (last, scans) = printed.split_last().expect("something was printed");
    assert_eq!(*last, 0xa5);
    let odd = scans.iter().enumerate().find(|(scan, byte)| **byte != *scan as u8);
    assert_eq!(odd, None, "of {}", scans.len());
    let releases = outcome.number(partition, "releases");
    assert!(releases.abs_diff(scans.len() as u64) <= 2, "{releases} and {}", scans.len());
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn outputs_are_what_a_plc_writes_and_a_neighbour_reaches_none_of_them() {
    let (printed, device) = printer("passthrough.printed");
    let outcome = File::new("1ms")
        .plc("drive", Some(plc_image("outputs")), &devices())
        .plc("sweep", Some(plc_image("sweep")), "")
        .schedule("normal")
        .window("drive", 0, 200)
        .window("sweep", 300, 400)
        .run("passthrough")
        .lasting("4s")
        .with("--device")
        .with(&device)
        .with("--device")
        .with("edu")
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("takt: 0000:00:06.0 for drive: bus mastering is off");

    outcome.assert_kept_its_time("drive", 3_000);
    assert_printed(&outcome, "drive", &printed);
    assert_eq!(outcome.number("drive", "illegal_accesses"), 0);

    // A store to a register is no exit: nearly free. One to a port is.
    let ticks = |what: &str| {
        let said = format!("ticks of a write to a {what}: ");
        let (_, rest) = outcome.output.split_once(&said).expect("the costs are printed");
        let digits: String = rest.chars().take_while(char::is_ascii_digit).collect();
        digits.parse::<u64>().expect("a number")
    };
    assert!(ticks("register") < 100, "{}", outcome.output);
    assert!(ticks("port") < 30_000, "{}", outcome.output);
    outcome.assert_shows(", 0 wrong");

    // The neighbour has tried everything, and each attempt was counted.
    outcome.assert_shows(&format!("sweep: {PLACES} places tried, 0 answered"));
    assert_eq!(outcome.number("sweep", "illegal_accesses"), PLACES);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn what_a_plc_prints_beside_a_linux_arrives_byte_for_byte() {
    // The test above is the short form.
    // The file names it.
    let _ = plc_image("outputs");
    let (printed, device) = printer("parallel.printed");
    let run = Run::of("configs/parallel.toml").lasting("60s");
    let outcome = run.with("--device").with(&device).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 59_900);
    assert_printed(&outcome, "plc", &printed);
    // The guest looks for an `edu` once, which this machine does not have.
    assert_eq!(outcome.number("plc", "illegal_accesses"), 1, "{}", outcome.output);
}

/// The registers of QEMU's `edu`, and its interrupt.
fn interrupting() -> String {
    format!("{EDU}{EDU_INTERRUPT}")
}

/// The numbers behind `words` in the last line of a partition that has the first of them.
pub fn numbers<const N: usize>(outcome: &Outcome, partition: &str, words: [&str; N]) -> [u64; N] {
    let of = format!("[{partition}] ");
    let mut lines = outcome.output.lines().rev();
    let line = lines.find(|line| line.contains(&of) && line.contains(words[0]));
    let line = line.unwrap_or_else(|| panic!("it says nothing\n{}", outcome.output));
    words.map(|word| {
        let (_, rest) = line.split_once(word).unwrap_or_else(|| panic!("no {word} in {line}"));
        let digits: String = rest.trim_start().chars().take_while(char::is_ascii_digit).collect();
        digits.parse().unwrap_or_else(|_| panic!("no number after {word} in {line}"))
    })
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn interrupts_reach_their_plc_also_after_a_restart_and_no_neighbour() {
    let outcome = File::new("1ms")
        .plc("drive", Some(plc_image("interrupts")), &interrupting())
        .plc("neighbour", None, "")
        .health("drive", "partition-ended", "cold-start")
        .schedule("normal")
        .window("drive", 0, 200)
        .window("neighbour", 300, 300)
        .run("interrupts")
        .lasting("2s")
        .with("--device")
        .with("edu")
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert_eq!(outcome.number("drive", "restarts"), 1, "{}", outcome.output);
    outcome.assert_kept_its_time("neighbour", 1_900);
    outcome.assert_punctual("neighbour");
    outcome.assert_kept_its_time("drive", 1_800);

    // Each came, for the reason that was given, and few needed more than a scan.
    let words = ["raised", "arrived", "wrong", "after"];
    let [raised, arrived, wrong, fewest] = numbers(&outcome, "drive", words);
    assert!(arrived + 1 == raised && wrong == 0, "{}", outcome.output);
    assert!(arrived >= 1_400 && fewest == 1, "{}", outcome.output);
    // The port by which it asks for them is one that it may use.
    assert_eq!(outcome.number("drive", "illegal_accesses"), 0, "{}", outcome.output);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_storm_of_interrupts_is_bounded_and_moves_no_neighbour() {
    let outcome = File::new("500us")
        .plc("storm", Some(plc_image("storm")), &interrupting())
        .plc("neighbour", None, "")
        .schedule("normal")
        .window("storm", 0, 100)
        .window("neighbour", 200, 100)
        .run("storm")
        .lasting("3s")
        .with("--device")
        .with("edu")
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("neighbour", 5_900);
    outcome.assert_punctual("neighbour");
    // A thousand in a second, half as many as it has windows, and what the first tick has left.
    outcome.assert_shows("interrupt 64 of storm: held back");
    let [releases, arrived] = numbers(&outcome, "storm", ["release", "arrived"]);
    assert!((releases / 4..=releases / 2 + 40).contains(&arrived), "{}", outcome.output);
}

/// A count in the last line that the guest `can` has printed.
pub fn count(outcome: &Outcome, before: &str) -> u64 {
    let line = outcome.output.lines().rfind(|line| line.contains("[plc] cycle "));
    let line = line.unwrap_or_else(|| panic!("it says nothing\n{}", outcome.output));
    let mut words = line.split([' ', ',']).filter(|word| !word.is_empty());
    let value = words.find(|word| *word == before).and_then(|_| words.next()?.parse().ok());
    value.unwrap_or_else(|| panic!("no {before} in {line}"))
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn every_can_frame_is_accounted_for() {
    let (duration, frames) = if long() { ("60s", 59_000) } else { ("3s", 2_000) };
    // The file names it.
    let _ = plc_image("can");
    let outcome = Run::of("configs/can.toml").lasting(duration).with("--device").with("can").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", frames);
    assert_eq!(outcome.number("plc", "illegal_accesses"), 0, "{}", outcome.output);

    let sent = count(&outcome, "sent");
    assert!(sent >= frames, "{sent}\n{}", outcome.output);
    // One in each cycle, but for the first, in which the controllers are started.
    assert!(count(&outcome, "cycle").abs_diff(sent) <= 2, "{}", outcome.output);
    assert_eq!(sent, count(&outcome, "received"), "{}", outcome.output);
    for what in ["lost", "disordered", "refused", "foreign", "overruns", "recoveries"] {
        assert_eq!(count(&outcome, what), 0, "{what}\n{}", outcome.output);
    }
    outcome.assert_shows("Active and Active");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_plc_and_a_driver_of_the_hosts_exchange_every_can_frame() {
    const CARD: &str = r#"
[[partition.port_io]]
ports = "0x2400-0x247f"
pci = "0000:00:11.0"
bar = 0
"#;
    let image = plc_image("can-echo");
    let file = File::new("1ms")
        .plc("plc", Some(image.clone()), CARD)
        .schedule("normal")
        .window("plc", 0, 500)
        .save("can-echo");
    let outcome = Host::new()
        .with("--device", "can")
        .with("--module", "can-raw")
        .with("--module", "kvaser_pci")
        .with("--program", env!("CARGO_BIN_EXE_can-echo"))
        .with_file(&file)
        .with_file(&image)
        .run("can-echo", &[&file.to_string_lossy(), "60s"]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 59_000);
    let sent = count(&outcome, "sent");
    assert!(sent >= 58_000, "{sent}\n{}", outcome.output);
    // One or two are on their way when the line is printed.
    let received = count(&outcome, "received");
    assert!(sent - received <= 2, "{received} of {sent}\n{}", outcome.output);
    for what in ["lost", "disordered", "refused", "foreign", "overruns"] {
        assert_eq!(count(&outcome, what), 0, "{what}\n{}", outcome.output);
    }
    outcome.assert_shows(", lost 0, disordered 0, last ");
}
