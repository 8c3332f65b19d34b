//! What shows that a figure was taken under the load that it is said to be of, and that the emulated
//! machine below did not take part in it.

use std::fs;
use std::path::PathBuf;

use takt_tests::{File, Outcome, System, initrd_and, long, target};

/// A PLC of the built-in kind at 1 kHz, and a Linux with stress-ng.
fn beside_stress(name: &str, duration: &str, at_the_end: u64) -> Outcome {
    let stress = fs::read(target("guest/stress.cpio")).expect("scripts/load-image has run");
    let initrd = initrd_and(&format!("{name}-initrd"), &stress);
    let exec = format!("takt-load stress & sleep {at_the_end}; grep LOC: /proc/interrupts");
    let system = System { initrd: &initrd, memory: "256MiB", exec: &exec, ..System::default() };
    system.run(name, duration)
}

/// The largest number that follows `before` on a line of the console.
fn largest(outcome: &Outcome, before: &str) -> u64 {
    let number = |line: &str| -> Option<u64> {
        let (_, rest) = line.split_once(before)?;
        rest.split_whitespace().next()?.parse().ok()
    };
    outcome.output.lines().filter_map(number).max().unwrap_or(0)
}

/// QEMU delivers no interrupt twice: a Linux whose timers go off 20,000 times a second, which forks and
/// faults, died of that within three seconds.
#[test]
fn a_linux_full_of_timers_lives_and_the_plc_keeps_its_time() {
    let (duration, end, releases) = if long() { ("60s", 57, 59_990) } else { ("4s", 2, 3_990) };
    let outcome = beside_stress("stress", duration, end);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("emulated by QEMU ");
    outcome.assert_shows(": each interrupt is delivered once");
    let forks = largest(&outcome, "takt-load: stress ");
    assert!(forks > 100, "{forks} forks\n{}", outcome.output);
    // Of 20,000 a second, some fall together while Linux starts processes.
    let timers = largest(&outcome, "LOC: ");
    assert!(timers > (end - 1) * 10_000, "{timers} interrupts of timers\n{}", outcome.output);
    outcome.assert_kept_its_time("plc", releases);
    outcome.assert_punctual("plc");
}

/// A doorbell's handler takes a lock, and a second delivery waits for it for ever.
#[test]
fn a_linux_is_woken_a_thousand_times_a_second_by_doorbells() {
    let (duration, seconds, releases) = if long() { ("60s", 57, 59_990) } else { ("5s", 2, 4_990) };
    let exec = "takt-port watch receive --hex > /dev/null & \
                while :; do sleep 1; echo rung $(grep uio_pci /proc/interrupts); done";
    let outcome = File::new("1ms")
        .plc("plc", Some(peer()), "")
        .linux(exec)
        .channels("plc", "linux")
        .lines("doorbell = true")
        .channels("linux", "plc")
        .schedule("normal")
        .window("plc", 0, 300)
        .run("doorbells")
        .lasting(duration)
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let line = outcome.output.lines().rfind(|line| line.starts_with("rung "));
    let rings = line.and_then(|line| line.split_whitespace().nth(2)?.parse::<u64>().ok());
    assert!(rings > Some(seconds * 900), "{line:?}\n{}", outcome.output);
    outcome.assert_kept_its_time("plc", releases);
    outcome.assert_punctual("plc");
}

fn peer() -> PathBuf {
    takt_tests::plc_image("peer")
}
