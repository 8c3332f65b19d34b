//! On Intel's VMX, which Bochs emulates: that Takt does there what it does on AMD's SVM, and that a run can
//! be repeated to the last nanosecond.
//!
//! Bochs is slower than QEMU, so by default there is one machine for both guests, and one for the comparison.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use takt_tests::{BUSY, File, Host, Outcome, Run, initrd_and, long, plc_image, root, target};

/// How Bochs's VMX and SVM are called in reports, and by `--lane`.
const VMX: &str = "vmx";
const SVM: &str = "svm";

/// How long each run of the list is, in which a Linux may start twice, and how many releases a PLC has
/// then, at 1 kHz, at least.
const DURATION: &str = "6s";
const RELEASES: u64 = 5_950;

/// A partition file for one of the runs of [`the_same_on_vmx_as_on_svm_and_twice_to_the_bit`], and what is
/// expected of it.
struct Case {
    path: PathBuf,
    expect: fn(&Outcome),
}

impl Case {
    fn new(name: &str, file: &File, expect: fn(&Outcome)) -> Self {
        Self { path: file.save(name), expect }
    }
}

/// Both guests of the shipped file ran, on a kernel that has found VMX.
fn both_ran(outcome: &Outcome, lane: &str) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert_eq!(outcome.report["lane"], lane);
    let cpu = outcome.report["host"]["cpu"].as_str().unwrap_or_default();
    assert!(cpu.contains(if lane == VMX { "Intel" } else { "AMD" }), "{cpu}");
    outcome.assert_shows("Linux version ");
    outcome.assert_shows("linux# ");
    outcome.assert_shows("[plc] Takt PLC guest");
    assert!(outcome.number("linux", "boot_to_init_ns") > 0);
    outcome.assert_punctual("plc");
}

#[test]
fn both_guests_run_on_vmx() {
    let (duration, releases) = if long() { ("10s", 9_990) } else { ("3s", 2_990) };
    let run = Run::of("configs/plc-and-linux.toml").in_lane(VMX).lasting(duration);
    let outcome = run.run();
    both_ran(&outcome, VMX);
    outcome.assert_kept_its_time("plc", releases);
}

#[test]
fn both_guests_run_on_the_other_svm() {
    if !long() {
        return;
    }
    let run = Run::of("configs/plc-and-linux.toml").in_lane(SVM).lasting("10s");
    let outcome = run.run();
    both_ran(&outcome, SVM);
    outcome.assert_kept_its_time("plc", 9_990);
}

#[test]
fn two_runs_on_vmx_have_the_same_values_to_the_last_nanosecond() {
    let (file, time) = if long() { ("plc-and-linux", "5s") } else { ("plc-alone", "100ms") };
    let mut lab = Command::new(root().join("scripts/lab"));
    let output = lab.args(["--twice", "--lane", VMX]);
    let output = output.arg(root().join(format!("configs/{file}.toml"))).args(["--for", time]);
    let output = output.output().expect("scripts/lab starts");
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && told.contains("both runs: the same "), "{told}");
}

/// A Linux whose timers go off 20,000 times a second, which forks and faults.
fn stressed() -> File {
    let stress = fs::read(target("guest/stress.cpio")).expect("scripts/load-image has run");
    File::new("1ms")
        .plc("plc", None, "release_guard = \"20us\"")
        .linux_with(&initrd_and("vmx-stress-initrd", &stress), "takt-load stress")
        .schedule("normal")
        .window("plc", 0, 300)
}

fn kept_under_stress(outcome: &Outcome) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let told = |line: &str| -> Option<u64> {
        line.split_once("takt-load: stress ")?.1.split(' ').next()?.parse().ok()
    };
    let forks = outcome.output.lines().filter_map(told).max();
    assert!(forks > Some(100), "{forks:?}\n{}", outcome.output);
    outcome.assert_kept_its_time("plc", RELEASES);
    outcome.assert_punctual("plc");
}

fn three_kept_their_time(outcome: &Outcome) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for (name, releases) in [("axis", RELEASES), ("cell", RELEASES / 2), ("climate", RELEASES / 4)]
    {
        outcome.assert_kept_its_time(name, releases);
        outcome.assert_punctual(name);
    }
    outcome.assert_shows("linux# ");
}

/// A PLC that never says that it is done, and right behind it a good one.
fn never_done() -> File {
    File::new("1ms")
        .plc("greedy", Some(plc_image("never-done")), "")
        .plc("plc", None, "")
        .linux(BUSY)
        .schedule("normal")
        .window("greedy", 0, 300)
        .window("plc", 350, 100)
}

fn overran_alone(outcome: &Outcome) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let overruns = outcome.number("greedy", "overruns");
    assert!(overruns >= RELEASES, "{overruns} overruns\n{}", outcome.output);
    assert!(outcome.number("greedy", "overrun_ns.max") <= 10_000, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", RELEASES);
    outcome.assert_punctual("plc");
    outcome.assert_shows("linux# ");
}

/// A Linux that starts again as often as it may.
fn restarting() -> File {
    File::new("1ms")
        .plc("plc", None, "release_guard = \"20us\"")
        .linux("reboot -f")
        .lines("restarts = { at_most = 1, within = \"60s\" }")
        .schedule("normal")
        .window("plc", 0, 300)
}

fn restarted_once(outcome: &Outcome) {
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    assert_eq!(outcome.output.matches("Linux version ").count(), 2, "{}", outcome.output);
    outcome.assert_shows("asked for a restart -> idle: started again 1 time within 60s");
    assert_eq!(outcome.number("linux", "restarts"), 1, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", RELEASES);
}

/// Two PLCs that exchange records, and a busy Linux.
fn peers() -> File {
    File::new("1ms")
        .plc("left", Some(plc_image("peer")), "")
        .plc("right", Some(plc_image("peer")), "")
        .linux(BUSY)
        .channels("left", "right")
        .channels("right", "left")
        .schedule("normal")
        .window("left", 0, 200)
        .window("right", 400, 200)
}

fn exchanged_whole_records(outcome: &Outcome) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for name in ["left", "right"] {
        outcome.assert_kept_its_time(name, RELEASES);
        let last = outcome.output.lines().rfind(|line| line.contains(&format!("[{name}] cycle ")));
        let last = last.unwrap_or_else(|| panic!("{name} says nothing\n{}", outcome.output));
        for none in ["wrong 0", "hostile 0", "refused 0"] {
            assert!(last.contains(none), "{none} in {last}");
        }
        outcome.assert_punctual(name);
    }
}

#[test]
fn the_same_on_vmx_as_on_svm_and_twice_to_the_bit() {
    if !long() {
        return;
    }
    let three = Case {
        path: root().join("configs/three-plcs.toml").canonicalize().unwrap(),
        expect: three_kept_their_time,
    };
    let cases = [
        three,
        Case::new("vmx-never-done", &never_done(), overran_alone),
        Case::new("vmx-restart", &restarting(), restarted_once),
        Case::new("vmx-ports", &peers(), exchanged_whole_records),
        Case::new("vmx-stress", &stressed(), kept_under_stress),
    ];
    let paths: Vec<PathBuf> = cases.iter().map(|case| case.path.clone()).collect();
    let machine = |name| {
        Host::new().with("--lane", VMX).with("--memory", "512").run_each(name, DURATION, &paths)
    };
    let (first, second) = (machine("vmx-first"), machine("vmx-second"));
    for (case, (one, other)) in cases.iter().zip(first.iter().zip(&second)) {
        (case.expect)(one);
        assert_eq!(one.report, other.report, "{}", case.path.display());
        assert_eq!(one.output, other.output, "{}", case.path.display());
    }
}
