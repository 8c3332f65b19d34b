//! What a user does with Takt, and sees.

use takt_tests::{File, Run, System, Value, long};

#[test]
fn both_guests_run_from_the_shipped_file() {
    let (duration, releases) = if long() { ("60s", 59_990) } else { ("4s", 3_990) };
    let outcome = Run::of("configs/plc-and-linux.toml").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("Linux version ");
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
    outcome.assert_shows("linux# ");
    outcome.assert_shows("[plc] Takt PLC guest");
    outcome.assert_kept_its_time("plc", releases);
    // The guarded release waits in a loop of five instructions.
    outcome.assert_punctual("plc");
    assert!(outcome.number("linux", "boot_to_init_ns") > 0);
    let report = &outcome.report;
    // Booting takes Linux more than a second of CPU time; what it does with the rest is idle.
    let seconds = report["duration_ns"].as_f64().unwrap_or(0.0) / 1e9;
    let share = outcome.share("linux");
    assert!(share * seconds > 1.0, "Linux's share is {share}\n{}", outcome.output);
    assert_eq!((&report["schema_version"], &report["lane"]), (&Value::from(3), &"lab".into()));
    assert_eq!(report["host"]["preempt_rt"], true);
    // With the 3 MiB of the program at most 5 MiB beyond the guests' memory, all of it locked.
    let own = report["process"]["start"]["anonymous_bytes"].as_u64();
    assert!(own.is_some_and(|own| own <= 2 << 20), "{own:?}");
}

#[test]
fn the_console_is_usable_linux_switches_off_and_the_escape_ends_the_run() {
    let dialogue = [
        ("linux# ", "echo six times seven is $((6 * 7))\n"),
        ("seven is 42", "\x1d\x1dtyped\n"),
        ("typed", "\npoweroff\n"),
        // The PLC keeps its cycle without Linux, until the user ends it.
        ("[takt] linux: partition-ended: powered off -> idle", "\x1dq"),
    ];
    let outcome = System::default().run_typing("console", None, &dialogue);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_second_kernel_boots_with_only_the_path_changed() {
    let second = System { kernel: "guest/vmlinuz-generic", memory: "256MiB", ..System::default() };
    let outcome = second.run_typing("second-kernel", Some("20s"), &[("linux# ", "\x1dq")]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn an_elf_kernel_boots_too() {
    let elf = System { kernel: "appliance/vmlinux", memory: "256MiB", ..System::default() };
    let outcome = elf.run_typing("elf-kernel", Some("20s"), &[("linux# ", "\x1dq")]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
    outcome.assert_shows("PREEMPT_RT");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_that_restarts_comes_back_as_often_as_it_may_and_the_plc_loses_nothing() {
    let file = File::new("1ms")
        .plc("plc", None, "release_guard = \"10us\"")
        .linux("")
        .lines("restarts = { at_most = 1, within = \"60s\" }")
        .schedule("normal")
        .window("plc", 0, 300);
    let dialogue = [
        ("linux# ", "echo I was > /tmp/first; reboot -f\n"),
        ("[takt] linux: partition-reset: asked for a restart -> cold-start", ""),
        // Nothing is left of the first one, and the keyboard's interrupt works on the new machine.
        ("linux# ", "ls /tmp; echo six times seven is $((6 * 7))\n"),
        ("seven is 42", "reboot -f\n"),
        ("asked for a restart -> idle: started again 1 time within 60s", "\x1dq"),
    ];
    let outcome = file.run("reboot").lasting("30s").typing(&dialogue).run();
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    assert_eq!(outcome.output.matches("Linux version ").count(), 2, "{}", outcome.output);
    assert!(!outcome.output.contains("\nfirst"), "{}", outcome.output);
    assert_eq!(outcome.number("linux", "restarts"), 1, "{}", outcome.output);
    assert_eq!(outcome.number("linux", "events.totals.partition-reset"), 2);
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
}

/// A Linux with windows runs in the loop of a PLC, on a thread that may do less.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_with_windows_restarts_as_often_as_it_may() {
    let outcome = File::new("10ms")
        .plc("plc", None, "")
        .linux("reboot -f")
        .in_windows()
        .lines("restarts = { at_most = 1, within = \"60s\" }")
        .schedule("normal")
        .window("plc", 0, 200)
        .window("linux", 500, 8_000)
        .run("reboot-in-windows")
        .lasting("30s")
        .typing(&[("asked for a restart -> idle: started again 1 time within 60s", "\x1dq")])
        .run();
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    assert_eq!(outcome.output.matches("Linux version ").count(), 2, "{}", outcome.output);
    assert_eq!(outcome.number("linux", "restarts"), 1, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", outcome.cycles(10_000) - 10);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_run_that_ends_while_a_linux_is_started_again_is_no_failure() {
    let linux = System { memory: "256MiB", exec: "reboot -f", ..System::default() };
    let outcome = File::new("1ms")
        .plc("plc", None, "release_guard = \"10us\"")
        .other_linux(&linux)
        .schedule("normal")
        .window("plc", 0, 300)
        .run("end-in-restart")
        .lasting("30s")
        .typing(&[("asked for a restart -> cold-start", "\x1dq")])
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert_eq!(outcome.number("linux", "restarts"), 1, "{}", outcome.output);
    assert_eq!(outcome.partition("linux")["end"], "stopped by takt", "{}", outcome.output);
}
