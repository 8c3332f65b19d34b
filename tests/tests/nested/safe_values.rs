//! What is on the outputs when takt dies, and what becomes of the machine.

use takt_tests::{File, Host, long, plc_image};

/// A parallel port, and what is to be on it when its owner has ended.
const DEVICES: &str = r#"
[[partition.port_io]]
ports = "0x378-0x37a"

[[partition.safe_value]]
port = "0x378"
width = 1
value = "0xa5"
"#;

#[test]
fn outputs_are_safe_after_takt_was_killed_or_has_panicked() {
    let image = plc_image("outputs");
    let file = File::new("1ms")
        .plc("drive", Some(image.clone()), DEVICES)
        .schedule("normal")
        .window("drive", 0, 200)
        .save("killed");
    let kills = if long() { "20" } else { "4" };
    let outcome = Host::new()
        .hooked()
        .with("--device", "parallel=/dev/null")
        .with_file(&file)
        .with_file(&image)
        .run("kill-takt", &[&file.to_string_lossy(), kills, "20261121"]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("wrong: "), "{}", outcome.output);
    outcome.assert_shows(&format!("killed {kills} times"));
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn the_hosts_watchdog_restarts_the_machine_when_takt_hangs_or_is_killed() {
    let file = File::new("1ms")
        .watchdog("2s")
        .plc("plc", None, "")
        .schedule("normal")
        .window("plc", 0, 300)
        .save("stopped");
    for signal in ["STOP", "KILL"] {
        let outcome = Host::new()
            .with("--device", "watchdog")
            .with("--module", "i6300esb")
            .with_file(&file)
            .run("stop-takt", &[&file.to_string_lossy(), signal]);
        outcome.assert_shows("the machine has survived an orderly end");
        assert!(!outcome.output.contains("wrong: "), "{}", outcome.output);
        // There is no result of a machine that was restarted.
        outcome.assert_shows("the appliance ended without a result");
        assert_eq!(outcome.status, 3, "{}", outcome.output);
    }
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn the_appliance_finds_its_watchdog_by_itself() {
    // That of the chipset, which every machine of QEMU's has here.
    let run = |time: &str| {
        File::new("1ms")
            .watchdog(time)
            .plc("plc", None, "")
            .schedule("normal")
            .window("plc", 0, 300)
            .run("served")
            .lasting("5s")
            .run()
    };
    let outcome = run("5s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 4_900);
    // A time that it does not know is refused before anything starts.
    let outcome = run("1s");
    assert_eq!(outcome.status, 3, "{}", outcome.output);
    outcome.assert_shows("cannot serve the host's watchdog, /dev/watchdog: ");
}
