//! What a user does with Takt, and sees.

use takt_tests::{Run, System, Value, long};

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
    assert_eq!((&report["schema_version"], &report["lane"]), (&Value::from(2), &"lab".into()));
    assert_eq!(report["host"]["preempt_rt"], true);
}

#[test]
fn the_console_is_usable_linux_switches_off_and_the_escape_ends_the_run() {
    let dialogue = [
        ("linux# ", "echo six times seven is $((6 * 7))\n"),
        ("seven is 42", "\x1d\x1dtyped\n"),
        ("typed", "\npoweroff\n"),
        // The PLC keeps its cycle without Linux, until the user ends it.
        ("[takt] linux: powered off", "\x1dq"),
    ];
    let outcome = System::default().run_typing("console", None, &dialogue);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 1000);
}

#[test]
fn a_second_kernel_boots_with_nothing_but_the_path_changed() {
    let second = System { kernel: "guest/vmlinuz-generic", memory: "256MiB", ..System::default() };
    let outcome = second.run_typing("second-kernel", Some("20s"), &[("linux# ", "\x1dq")]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
    outcome.assert_kept_its_time("plc", 1000);
}

#[test]
fn an_elf_kernel_boots_too() {
    let elf = System { kernel: "appliance/vmlinux", memory: "256MiB", ..System::default() };
    let outcome = elf.run_typing("elf-kernel", Some("20s"), &[("linux# ", "\x1dq")]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
    outcome.assert_shows("PREEMPT_RT");
    outcome.assert_kept_its_time("plc", 1000);
}

#[test]
fn a_linux_that_wants_to_restart_is_a_failure_of_its_partition_only() {
    let outcome = System { exec: "reboot -f", ..System::default() }.run("reboot", "3s");
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    outcome.assert_shows("[takt] linux: asked for a restart");
    outcome.assert_kept_its_time("plc", 2_990);
}
