//! The end of a run, in order: Linux is asked to switch itself off, and the PLC keeps its time meanwhile.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use takt_tests::{File, Host, Outcome, target};

/// Waits until something listens for the power button.
const HEARING: &str = "until ls -l /proc/*/fd | grep -q input/event0; do usleep 10000; done";

/// What makes the guest deaf to its power button: what listens for it is gone. It may not have begun yet.
const DEAF: &str = "until killall head; do usleep 10000; done";

/// Behind [`DEAF`]: makes the guest restart at a press.
const CONTRARY: &str = "{ head -c 1 /dev/input/event0 > /tmp/pressed; reboot -f; } & true";

fn run(name: &str, file: &File, signals: &str, disk: Option<&PathBuf>) -> Outcome {
    let file = file.save(name);
    let path = file.to_string_lossy().into_owned();
    let host = ["guest/vmlinuz", "guest/initrd.img"]
        .iter()
        .fold(Host::new().with_file(&file), |host, image| host.with_file(&target(image)));
    let host = disk.into_iter().fold(host, |host, disk| host.with_file(disk));
    let disk = disk.map(|disk| disk.to_string_lossy().into_owned());
    let arguments: Vec<&str> =
        [&*path, signals].into_iter().chain(disk.iter().map(String::as_str)).collect();
    let outcome = host.run_as(name, "power-off", &arguments);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome
}

fn assert_ended_with(outcome: &Outcome, status: u8) {
    outcome.assert_shows(&format!("[host] takt has ended with {status}"));
}

fn file(exec: &str, more: &str) -> File {
    File::new("1ms")
        .plc("plc", None, "release_guard = \"20us\"")
        .linux(&format!("{exec}; echo guest ready"))
        .lines(more)
        .schedule("normal")
        .window("plc", 0, 200)
}

/// An ext4 without a journal: after a mount for writing its superblock says so until it is unmounted.
fn disk() -> PathBuf {
    let folder = target("tests");
    fs::create_dir_all(&folder).unwrap();
    let disk = folder.join("power-off.disk");
    fs::File::create(&disk).unwrap().set_len(2 << 20).unwrap();
    let mut mke2fs = Command::new("mke2fs");
    mke2fs.args(["-q", "-F", "-t", "ext4", "-O", "^has_journal"]).arg(&disk);
    assert!(mke2fs.status().expect("mke2fs starts").success());
    disk.canonicalize().unwrap()
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_with_a_disk_has_left_its_file_system_clean_after_sigterm() {
    let disk = disk();
    let exec = "mkdir /mnt; mount /dev/vda /mnt; echo kept > /mnt/file; \
                { sleep 1000 > /mnt/open & }";
    let more =
        format!("power_off = \"10s\"\n[[partition.disk]]\npath = {disk:?}\nread_only = false");
    let exec = format!("{exec}; {HEARING}");
    let outcome = run("power-off", &file(&exec, &more), "1", Some(&disk));
    assert_ended_with(&outcome, 0);
    outcome.assert_shows("linux: asked to power off");
    // The shell may be in the middle of a line.
    outcome.assert_shows("/init: asked to power off");
    for state in ["before: 1", "mounted: 0", "after: 1"] {
        outcome.assert_shows(&format!("[host] state {state}"));
    }
    let linux = outcome.partition("linux");
    assert_eq!(linux["end"], "powered off", "{linux}");
    assert!(linux["power_off"]["took_ns"].as_u64().is_some(), "{linux}");
    // Releases go on while Linux switches itself off.
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_that_does_not_react_has_its_time_and_no_more() {
    let outcome = run("power-off-deaf", &file(DEAF, "power_off = \"500ms\""), "1", None);
    assert_ended_with(&outcome, 0);
    outcome.assert_shows("linux: did not power off, and is stopped");
    let linux = outcome.partition("linux");
    assert_eq!(linux["end"], "stopped by takt", "{linux}");
    assert!(linux["power_off"]["took_ns"].is_null(), "{linux}");
    let asked = linux["power_off"]["asked_ns"].as_u64().expect("it was asked");
    let waited = outcome.report["duration_ns"].as_u64().unwrap_or(0) - asked;
    assert!((500_000_000..600_000_000).contains(&waited), "{waited}");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_that_restarts_instead_is_not_started_again() {
    let exec = format!("{DEAF}; {CONTRARY}; {HEARING}");
    let outcome = run("power-off-restart", &file(&exec, "power_off = \"100s\""), "1", None);
    // A request to restart is not met.
    assert_ended_with(&outcome, 4);
    outcome.assert_shows("linux: not started again, since the run ends");
    let linux = outcome.partition("linux");
    assert!(linux["power_off"]["took_ns"].is_null(), "{linux}");
    let asked = linux["power_off"]["asked_ns"].as_u64().expect("it was asked");
    let waited = outcome.report["duration_ns"].as_u64().unwrap_or(0) - asked;
    assert!(waited < 2_000_000_000, "{waited}");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_second_sigterm_ends_the_run_at_once() {
    let outcome = run("power-off-twice", &file(DEAF, "power_off = \"100s\""), "2", None);
    assert_ended_with(&outcome, 0);
    let linux = outcome.partition("linux");
    let asked = linux["power_off"]["asked_ns"].as_u64().expect("it was asked");
    let waited = outcome.report["duration_ns"].as_u64().unwrap_or(0) - asked;
    assert!(waited < 1_000_000_000, "{waited}");
}
