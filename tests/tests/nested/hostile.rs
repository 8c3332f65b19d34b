//! Guests that try to break Takt itself: it neither ends nor grows, whatever they do.

use std::fs;
use std::path::PathBuf;

use takt_tests::{File, initrd_with, plc_image, target};

use crate::devices::{EDU, EDU_INTERRUPT};

/// Where a Linux takes the registers of its first disk from their driver and gives them back.
const DRIVER: &str = "/sys/bus/platform/drivers/virtio-mmio";

/// An empty file for a disk.
fn disk(name: &str) -> String {
    let path = target(&format!("tests/{name}.disk"));
    fs::create_dir_all(target("tests")).unwrap();
    fs::File::create(&path).unwrap().set_len(1 << 20).unwrap();
    format!("[[partition.disk]]\npath = {path:?}\nread_only = false")
}

/// Each PLC that has been written to do harm, and what it needs for that.
const HOSTILE: [(&str, &[&str]); 8] = [
    ("never-done", &[]),
    ("fault", &[]),
    ("stack-overflow", &[]),
    ("write-information", &[]),
    ("flood", &[]),
    ("sweep", &[]),
    ("hostile-peer", &[]),
    ("storm", &[EDU, EDU_INTERRUPT]),
];

/// All of them at once for a minute, again and again from the start, and a Linux that does its worst in
/// turns. No time of this lane means anything; that Takt is there at the end, and as it was, does.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn takt_survives_a_minute_of_all_hostile_guests_and_does_not_grow() {
    let programs: [PathBuf; 3] = [
        env!("CARGO_BIN_EXE_hostile"),
        env!("CARGO_BIN_EXE_hostile-virtio"),
        env!("CARGO_BIN_EXE_hostile-machine"),
    ]
    .map(PathBuf::from);
    let programs = programs.each_ref().map(PathBuf::as_path);
    let exec = format!(
        "echo LNRO0005:00 > {DRIVER}/unbind; echo 1 > /proc/sys/kernel/panic; \
         seed=$(cut -c1-4 /proc/sys/kernel/random/uuid); seed=$((0x$seed)); \
         while :; do seed=$((seed + 1)); hostile $seed 1000; hostile-virtio 0 $seed 100; \
         hostile-machine $seed 100; done"
    );
    let again = "restarts = { at_most = 100, within = \"60s\" }";
    let file =
        HOSTILE.iter().fold(File::new("40ms").plc("good", None, ""), |file, (name, needs)| {
            file.plc(name, Some(plc_image(name)), &format!("{again}\n{}", needs.concat()))
        });
    let mut file = file
        .linux_with(&initrd_with("all-hostile", &programs), &exec)
        .lines(again)
        .lines(&disk("all-hostile"));
    for (name, _) in HOSTILE {
        for error in ["memory-violation", "stack-overflow", "partition-ended"] {
            file = file.health(name, error, "cold-start");
        }
    }
    file = file
        .channels("hostile-peer", "linux")
        .channels("linux", "hostile-peer")
        .schedule("normal")
        .window("good", 0, 2_000);
    for (at, (name, _)) in (1..).zip(HOSTILE) {
        file = file.window(name, at * 4_000, 2_000);
    }
    let outcome = file
        .run("all-hostile")
        .in_lane("emulated")
        .with("--device")
        .with("edu")
        .lasting("90s")
        .run();
    // 4: the last life of one of them ended with its failure.
    assert!([0, 4].contains(&outcome.status), "{}", outcome.output);
    // Nine partitions, each with eight distributions.
    outcome.assert_not_grown(6 << 20);
    assert_eq!(outcome.number("good", "illegal_accesses"), 0);
    for name in ["fault", "stack-overflow"] {
        assert!(outcome.number(name, "restarts") > 1, "{name}\n{}", outcome.output);
    }
    for name in ["flood", "sweep", "linux"] {
        assert!(outcome.number(name, "illegal_accesses") > 1_000, "{name}\n{}", outcome.output);
    }
    for program in ["hostile", "hostile-virtio", "hostile-machine"] {
        outcome.assert_shows(&format!("\n{program}: "));
    }
}
