//! Quiet windows: that neither a Linux's timers nor Takt's own interrupt a PLC from its guard to its
//! "done", and what is left to a kernel that means harm.

use std::path::Path;

use takt_tests::{Aim, File, Outcome, aiming_kernel, initrd_with, long, parse};

use crate::evidence::{assert_stressed, stress_until};

/// What a timer of the local APIC that Takt does not see may cost a release: one interrupt, of 1.8 us in
/// the lab.
const ONE_INTERRUPT_NS: u64 = 2_500;

/// How long Linux is full of timers, in seconds, and how long the run is, by when that is over.
fn times() -> (u32, &'static str) {
    if long() { (54, "60s") } else { (2, "4s") }
}

/// Adds a Linux that has three timers of 20 kHz, of a kind each, and beside them measures how late its own
/// sleeps end.
fn with_storm(file: File, name: &str) -> File {
    let initrd = initrd_with(name, &[Path::new(env!("CARGO_BIN_EXE_timers"))]);
    let (seconds, _) = times();
    let exec = format!("timers {seconds} measure & timers {seconds} storm; wait; echo calm again");
    file.linux_with(&initrd, &exec)
}

/// The storm has lasted, and each of its timers has gone off for as long: a storm that stands still
/// would prove nothing.
fn assert_stormy(outcome: &Outcome) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("calm again");
    let line = outcome.output.lines().find(|line| line.starts_with("timers: {\"sleeps\""));
    let counts = parse(line.unwrap_or_default().trim_start_matches("timers: "));
    let (seconds, _) = times();
    // Sleeps and signals wait for the processor too; on Linux 6.12 the former are 4,200 a second.
    for (key, each_second) in [("sleeps", 4_000), ("signals", 5_000), ("expirations", 19_000)] {
        let count = counts[key].as_u64().unwrap_or(0);
        assert!(count >= each_second * u64::from(seconds), "{key}: {count}\n{}", outcome.output);
    }
    let deadlines = &outcome.partition("linux")["deadlines"];
    let of = |key: &str| deadlines[key].as_u64().unwrap_or(0);
    assert!(of("moved") > 100 && of("programmed") > of("moved"), "{deadlines}");
}

/// All releases, each within 10 ns.
fn assert_quiet(outcome: &Outcome, plc: &str, at_least: u64) {
    outcome.assert_kept_its_time(plc, at_least);
    outcome.assert_exact(plc);
}

/// Releases in the run's whole time.
fn releases(period_ms: u64) -> u64 {
    if long() { 59_900 / period_ms } else { 3_900 / period_ms }
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_storm_of_timers_moves_no_release() {
    let file = with_storm(File::new("1ms").plc("plc", None, ""), "quiet-one");
    let file = file.schedule("normal").window("plc", 0, 300);
    let outcome = file.run("quiet-one").lasting(times().1).run();
    assert_stormy(&outcome);
    assert_quiet(&outcome, "plc", releases(1));
    // Linux's own timers are late by what a window can keep them waiting, and by what all the others take.
    let line = outcome.output.lines().find(|line| line.starts_with("timers: {\"late"));
    let late = parse(line.unwrap_or_default().trim_start_matches("timers: "));
    assert!(late["late_ns"]["max"].as_u64().is_some_and(|ns| ns < 450_000), "{late}");
    assert_eq!(outcome.report["tick"]["clear"], "windows");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_storm_of_timers_moves_no_release_of_three_plcs() {
    let file = beside_three_plcs(|file| with_storm(file, "quiet-three"));
    let outcome = file.run("quiet-three").lasting(times().1).run();
    assert_stormy(&outcome);
    for (name, period) in THREE {
        assert_quiet(&outcome, name, releases(period));
    }
}

/// Three PLCs, and how often they are released, in ms.
pub const THREE: [(&str, u64); 3] = [("axis", 1), ("cell", 2), ("climate", 4)];

/// All of [`THREE`] beside a Linux that is added.
pub fn beside_three_plcs(add_linux: impl FnOnce(File) -> File) -> File {
    let file = THREE.iter().fold(File::new("4ms"), |file, (name, _)| file.plc(name, None, ""));
    let mut file = add_linux(file).schedule("normal");
    for start in [0, 1000, 2000, 3000] {
        file = file.window("axis", start, 150);
    }
    file.window("cell", 350, 200).window("cell", 2350, 200).window("climate", 1350, 400)
}

/// The storm is ours; stress-ng is the load that others know.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn stress_ng_moves_no_release_of_three_plcs() {
    let end = if long() { 57 } else { 2 };
    let exec = stress_until(end);
    let file = beside_three_plcs(|file| file.stressed_linux("stress-three", &exec));
    let outcome = file.run("stress-three").lasting(times().1).run();
    assert_stressed(&outcome, end);
    for (name, period) in THREE {
        assert_quiet(&outcome, name, releases(period));
    }
}

/// A PLC beside a kernel that aims a timer at its releases, and at its wake-ups. The guard is as narrow as the lab's
/// wake-ups allow: an interrupt that delays one is felt.
fn aimed_at(aim: Aim) -> Outcome {
    let kernel = aiming_kernel(aim);
    let file = File::new("1ms").plc("plc", None, "release_guard = \"10us\"").lines(&format!(
        "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
         memory = \"64MiB\"\nkernel = {kernel:?}"
    ));
    let file = file.schedule("normal").window("plc", 0, 300);
    let outcome = file.run(&format!("aimed-{aim:?}")).lasting("3s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // It has got so far as to do without the board's timer.
    assert_eq!(outcome.number("linux", "illegal_accesses"), 3, "{}", outcome.output);
    outcome
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_kernel_that_aims_deadlines_at_releases_moves_none() {
    let outcome = aimed_at(Aim::Deadline);
    let moved = outcome.number("linux", "deadlines.moved");
    assert!(moved >= 1_000, "{moved} aimed\n{}", outcome.output);
    // The PLC is done early, and the kernel's timer then goes off as if nothing had been.
    let put_back = outcome.number("linux", "deadlines.put_back");
    assert!(put_back * 10 >= moved * 9, "{put_back} of {moved}\n{}", outcome.output);
    assert_quiet(&outcome, "plc", 2_990);
}

/// The kernel's log is written with interrupts off, for longer than the guard has to spare.
#[test]
fn a_kernel_that_writes_what_kvm_would_log_delays_no_wake_up() {
    let outcome = aimed_at(Aim::Logged);
    outcome.assert_shows("aimed");
    assert_quiet(&outcome, "plc", 2_990);
    let latest = outcome.number("plc", "wake_up_latency_ns.max");
    assert!(latest < 6_000, "{latest}\n{}", outcome.output);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_kernel_that_aims_other_timers_at_releases_moves_them_by_one_interrupt() {
    for aim in [Aim::OneShot, Aim::Periodic] {
        let outcome = aimed_at(aim);
        assert_eq!(outcome.number("linux", "deadlines.programmed"), 0);
        outcome.assert_kept_its_time("plc", 2_990);
        let latest = outcome.number("plc", "release_latency_ns.max");
        // That it hits is what the figure is worth.
        assert!(
            (100..=ONE_INTERRUPT_NS).contains(&latest),
            "{aim:?}: {latest}\n{}",
            outcome.output
        );
    }
}
