//! Quiet windows: that neither a Linux's timers nor Takt's own interrupt a PLC from its guard to its
//! "done", and what is left to a kernel that means harm.

use std::path::Path;

use takt_tests::{
    Aim, File, Host, Outcome, aiming_kernel, initrd_with, long, parse, switching_kernel,
};

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

/// From one frame to the next the windows are elsewhere. A deadline that waits for the end of a window goes off also if that window is gone.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_switch_of_schedules_in_a_storm_of_timers_moves_no_release() {
    let initrd = initrd_with("quiet-switch", &[Path::new(env!("CARGO_BIN_EXE_timers"))]);
    let exec = "timers 2 storm & sleep 0.6; echo storm $((1)); sleep 0.6; echo storm $((2)); wait; echo calm $((3))";
    let file = File::new("2ms")
        .plc("plc", None, "")
        .plc("other", None, "")
        .linux_with(&initrd, exec)
        .schedule("first")
        .window("plc", 0, 200)
        .window("other", 500, 200)
        .window("plc", 1_000, 200)
        .schedule("second")
        .window("plc", 300, 200)
        .window("other", 1_600, 300);
    let dialogue = [
        ("storm 1", "\x1ds"),
        ("[takt] schedule \"second\" holds since ", ""),
        ("storm 2", "\x1ds"),
        ("[takt] schedule \"first\" holds since ", ""),
    ];
    let outcome = file.run("quiet-switch").lasting("4500ms").typing(&dialogue).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("calm 3");
    assert_eq!(outcome.report["schedule"]["current"], "first");
    assert!(outcome.number("linux", "deadlines.moved") > 100, "{}", outcome.output);
    // At least one window in each frame of 2 ms.
    for plc in ["plc", "other"] {
        assert_quiet(&outcome, plc, 2_200);
    }
}

/// Its deadlines are moved out of the windows of others, and not out of its own.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_with_windows_and_a_storm_of_timers_moves_no_release() {
    let initrd = initrd_with("quiet-windows", &[Path::new(env!("CARGO_BIN_EXE_timers"))]);
    let exec = "timers 2 storm; echo calm $((3))";
    let file = File::new("4ms")
        .plc("plc", None, "")
        .linux_with(&initrd, exec)
        .in_windows()
        .schedule("normal")
        .window("linux", 0, 2_600)
        .window("plc", 2_650, 200);
    let outcome = file.run("quiet-windows").lasting("6s").until("calm 3").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("calm 3");
    let moved = outcome.number("linux", "deadlines.moved");
    // Linux 6.12 sets fewer that fall there.
    let least = if outcome.is_on_kernel("6.1.") { 100 } else { 20 };
    assert!(moved > least, "{moved}\n{}", outcome.output);
    assert_quiet(&outcome, "plc", outcome.cycles(4_000) - 10);
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

/// A PLC with a guard as narrow as the lab's wake-ups allow, and a kernel in the place of Linux.
fn beside_a_kernel(kernel: &Path) -> File {
    let file = File::new("1ms").plc("plc", None, "release_guard = \"10us\"").lines(&format!(
        "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
         memory = \"64MiB\"\nkernel = {kernel:?}"
    ));
    file.schedule("normal").window("plc", 0, 300)
}

/// A PLC beside a kernel that aims a timer at its releases, and at its wake-ups. An interrupt that delays one
/// is felt, as the guard is narrow.
pub fn aimed_at(aim: Aim, lane: &'static str) -> Outcome {
    let file = beside_a_kernel(&aiming_kernel(aim));
    let run = file.run(&format!("aimed-{aim:?}-{lane}")).in_lane(lane);
    let outcome = run.lasting("3s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // It has got so far as to do without the board's timer.
    assert_eq!(outcome.number("linux", "illegal_accesses"), 3, "{}", outcome.output);
    outcome
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_kernel_that_aims_deadlines_at_releases_moves_none() {
    let outcome = aimed_at(Aim::Deadline, "lab");
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
    let outcome = aimed_at(Aim::Logged, "lab");
    outcome.assert_shows("aimed");
    assert_quiet(&outcome, "plc", 2_990);
    let latest = outcome.number("plc", "wake_up_latency_ns.max");
    assert!(latest < 6_000, "{latest}\n{}", outcome.output);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_kernel_that_aims_other_timers_at_releases_moves_them_by_one_interrupt() {
    for aim in [Aim::OneShot, Aim::Periodic] {
        let outcome = aimed_at(aim, "lab");
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

/// The kernel would patch its code for as long as a guest likes, each time with an interrupt to all processors.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_kernel_that_switches_its_apic_off_and_on_changes_no_code_of_the_hosts() {
    let kernel = switching_kernel();
    let file = beside_a_kernel(&kernel).save("switching-apic");
    let host = Host::new().with("--memory", "192").with_file(&kernel).with_file(&file);
    let path = file.to_string_lossy();
    let outcome = host.run("patched-code", &[&*path]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("switching");
    let times = |before: &str, after: &str| {
        let line =
            outcome.output.lines().find_map(|line| line.split_once(before)?.1.split_once(after));
        line.and_then(|(count, _)| count.parse::<u32>().ok())
    };
    assert_eq!(times("code was changed ", " times"), Some(0), "{}", outcome.output);
    assert!(
        times("and before that ", " times").is_some_and(|count| count > 0),
        "{}",
        outcome.output
    );
    assert_quiet(&outcome, "plc", 3_490);
}
