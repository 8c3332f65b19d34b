//! On Intel's VMX, which Bochs emulates: that Takt does there what it does on AMD's SVM, and that a run can
//! be repeated to the last nanosecond.
//!
//! Bochs is slower than QEMU. By default both guests run once, and a PLC alone twice; the rest takes more than an
//! hour of a CPU, most of it two minutes of stress-ng.

use std::process::Command;

use takt_tests::{Aim, BUSY, File, Outcome, Run, long, plc_image, root, timeout_s};

use crate::evidence::{assert_stressed, stress_until};
use crate::quiet::{THREE, aimed_at, beside_three_plcs};

/// Runs a system on VMX twice, in two machines, which must not differ.
fn twice(run: Run<'_>, duration: &'static str) -> Outcome {
    same_twice(&run.in_lane("vmx").lasting(duration))
}

fn same_twice(run: &Run<'_>) -> Outcome {
    let (first, second) = (run.run(), run.run());
    assert!(first.report.is_object(), "{}", first.output);
    assert_eq!(first.report, second.report);
    assert_eq!(first.status, second.status, "{}", second.output);
    first
}

/// Both guests of the shipped file, with a processor of this maker: once, and twice in the long form.
fn both_guests_run(lane: &str, maker: &str) {
    let (duration, releases) = if long() { ("10s", 9_990) } else { ("3s", 2_990) };
    let run = Run::of("configs/plc-and-linux.toml").in_lane(lane).lasting(duration);
    let outcome = if long() { same_twice(&run) } else { run.run() };
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert_eq!(outcome.report["lane"], lane);
    let cpu = outcome.report["host"]["cpu"].as_str().unwrap_or_default();
    assert!(cpu.contains(maker), "{cpu}");
    outcome.assert_shows("emulated by Bochs 3.");
    outcome.assert_shows("Linux version ");
    outcome.assert_shows("linux# ");
    outcome.assert_shows("[plc] Takt PLC guest");
    assert!(outcome.number("linux", "boot_to_init_ns") > 0);
    outcome.assert_kept_its_time("plc", releases);
    // Linux says much while it starts, and what carries that away interrupts nothing.
    outcome.assert_exact("plc");
}

#[test]
fn both_guests_run_on_vmx() {
    both_guests_run("vmx", "Intel");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn both_guests_run_on_another_svm() {
    both_guests_run("svm", "AMD");
}

#[test]
fn two_runs_on_vmx_have_the_same_values_to_the_last_nanosecond() {
    let (file, time) = if long() { ("plc-and-linux", "4s") } else { ("plc-alone", "100ms") };
    let mut lab = Command::new(root().join("scripts/lab"));
    let output = lab.args(["--twice", "--lane", "vmx"]);
    let output = output.arg(root().join(format!("configs/{file}.toml"))).args(["--for", time]);
    let output = output.env("TAKT_TIMEOUT", timeout_s(0)).output().expect("scripts/lab starts");
    let told = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && told.contains("both runs: the same "), "{told}");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn three_plcs_and_linux_share_a_cpu() {
    let outcome = twice(Run::of("configs/three-plcs.toml"), "4s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for (name, releases) in [("axis", 3_990), ("cell", 1_990), ("climate", 990)] {
        outcome.assert_kept_its_time(name, releases);
        outcome.assert_exact(name);
    }
    outcome.assert_shows("linux# ");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn an_overrun_of_a_plc_that_is_never_done_ends_at_its_windows_end() {
    let file = File::new("1ms")
        .plc("greedy", Some(plc_image("never-done")), "")
        .plc("plc", None, "")
        .linux(BUSY)
        .schedule("normal")
        .window("greedy", 0, 300)
        .window("plc", 350, 100);
    let outcome = twice(file.run("vmx-overrun"), "4s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let overruns = outcome.number("greedy", "overruns");
    assert!(overruns >= 3_980, "{overruns} overruns\n{}", outcome.output);
    assert!(outcome.number("greedy", "overrun_ns.max") <= 10_000, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 3_980);
    outcome.assert_punctual("plc");
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_linux_restarts_beside_a_plc_that_loses_nothing() {
    let file = File::new("1ms")
        .plc("plc", None, "")
        .linux("reboot -f")
        .lines("restarts = { at_most = 1, within = \"60s\" }")
        .schedule("normal")
        .window("plc", 0, 300);
    let outcome = twice(file.run("vmx-restart"), "6s");
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    assert_eq!(outcome.output.matches("Linux version ").count(), 2, "{}", outcome.output);
    outcome.assert_shows("asked for a restart -> idle: started again 1 time within 60s");
    assert_eq!(outcome.number("linux", "restarts"), 1, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 5_980);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn two_plcs_exchange_whole_records() {
    let file = File::new("1ms")
        .plc("left", Some(plc_image("peer")), "")
        .plc("right", Some(plc_image("peer")), "")
        .linux(BUSY)
        .channels("left", "right")
        .channels("right", "left")
        .schedule("normal")
        .window("left", 0, 200)
        .window("right", 400, 200);
    let outcome = twice(file.run("vmx-ports"), "4s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for name in ["left", "right"] {
        outcome.assert_kept_its_time(name, 3_980);
        let last = outcome.output.lines().rfind(|line| line.contains(&format!("[{name}] cycle ")));
        let last = last.unwrap_or_else(|| panic!("{name} says nothing\n{}", outcome.output));
        for none in ["wrong 0", "hostile 0", "refused 0"] {
            assert!(last.contains(none), "{none}: {last}");
        }
    }
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn two_runs_beside_stress_ng_are_the_same() {
    let file = File::new("1ms").plc("plc", None, "");
    let file = file.stressed_linux("vmx-stress-twice", &stress_until(7));
    let file = file.schedule("normal").window("plc", 0, 300);
    let outcome = twice(file.run("vmx-stress-twice"), "10s");
    assert_stressed(&outcome, 7);
    outcome.assert_kept_its_time("plc", 9_900);
    outcome.assert_exact("plc");
}

/// How long Linux has stress-ng, and how long the run is that holds it, in seconds.
fn stressed() -> (u64, u64) {
    if long() { (57, 60) } else { (2, 5) }
}

/// Adds a Linux with stress-ng: timers at 20 kHz, forks, page faults and system calls.
fn with_stress(file: File, name: &str) -> File {
    file.stressed_linux(name, &stress_until(stressed().0))
}

/// No release of these PLCs, with their periods in ms, is moved by 10 ns.
fn assert_exact_under_stress(name: &str, file: &File, plcs: &[(&str, u64)]) {
    let (end, seconds) = stressed();
    let duration = if long() { "60s" } else { "5s" };
    let outcome = file.run(name).in_lane("vmx").lasting(duration).run();
    assert_stressed(&outcome, end);
    for (plc, period) in plcs {
        outcome.assert_kept_its_time(plc, (1_000 * seconds - 100) / period);
        outcome.assert_exact(plc);
    }
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_linux_full_of_timers_lives_and_the_plc_keeps_its_time() {
    let file = with_stress(File::new("1ms").plc("plc", None, ""), "vmx-stress");
    let file = file.schedule("normal").window("plc", 0, 300);
    assert_exact_under_stress("vmx-stress", &file, &[("plc", 1)]);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn stress_ng_moves_no_release_of_three_plcs() {
    let file = beside_three_plcs(|file| with_stress(file, "vmx-stress-three"));
    assert_exact_under_stress("vmx-stress-three", &file, &THREE);
}

/// An interrupt takes longer than on SVM, as this kernel flushes a cache behind it.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_kernel_that_aims_a_one_shot_timer_at_releases_moves_them_by_one_interrupt() {
    const ONE_INTERRUPT_NS: u64 = 6_000;
    let outcome = aimed_at(Aim::OneShot, "vmx");
    outcome.assert_kept_its_time("plc", 2_990);
    let latest = outcome.number("plc", "release_latency_ns.max");
    assert!((100..=ONE_INTERRUPT_NS).contains(&latest), "{latest}\n{}", outcome.output);
}

/// As on SVM; this processor lets KVM see XCR0 changed.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_plc_that_spoils_its_processor_finds_it_as_new_when_it_starts_again() {
    let outcome = File::new("4ms")
        .plc("spoil", Some(plc_image("spoil")), "")
        .health("spoil", "numeric-error", "warm-start")
        .schedule("normal")
        .window("spoil", 1_000, 600)
        .run("vmx-spoil")
        .in_lane("vmx")
        .lasting("500ms")
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("[spoil] spoilt ");
    assert!(!outcome.output.contains("[spoil] state 0x24 is as before:"), "{}", outcome.output);
    assert_eq!(outcome.number("spoil", "restarts"), 1, "{}", outcome.output);
    outcome.assert_shows("[spoil] left of 46 states: 0");
}
