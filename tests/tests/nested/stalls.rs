//! What stands still beside Takt: a reader, a disk. Takt, its guests and the host's watchdog go on.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_tests::{File, Host, Outcome, long, plc_image, target};

/// What a script has left, by name.
fn left(script: &str, name: &str) -> String {
    let path = target("tests").join(format!("{script}.out")).join(name);
    fs::read_to_string(path).unwrap_or_default()
}

/// A script with the host's watchdog, which restarts the machine after a second without a heartbeat: then
/// nothing is left of the run, and the script has no exit status of its own.
fn host() -> Host {
    Host::new().with("--device", "watchdog").with("--module", "i6300esb")
}

fn assert_nothing_late(outcome: &Outcome, name: &str, releases: u64) {
    outcome.assert_kept_its_time(name, releases);
    outcome.assert_punctual(name);
}

#[test]
fn a_reader_that_stops_costs_what_it_does_not_read_and_nothing_else() {
    let seconds = if long() { 10 } else { 2 };
    let flood = || Some(plc_image("flood"));
    let file = File::new("10ms")
        .watchdog("1s")
        .plc("good", None, "")
        .plc("one", flood(), "")
        .plc("other", flood(), "")
        .schedule("normal")
        .window("good", 0, 200)
        .window("one", 1_000, 2_500)
        .window("other", 5_000, 2_500)
        .window("good", 9_000, 200)
        .save("stalled-reader");
    let _ = fs::remove_dir_all(target("tests/stalled-reader.out"));
    let outcome = host()
        .with_file(&file)
        .with_file(&plc_image("flood"))
        .run("stalled-reader", &[&file.to_string_lossy(), &seconds.to_string()]);
    let console = left("stalled-reader", "console");
    assert_eq!(outcome.status, 0, "{}\n{console}", outcome.output);
    let outcome = Outcome { output: console, ..outcome };
    assert_eq!(left("stalled-reader", "exit"), "0\n", "{}", outcome.output);

    assert_nothing_late(&outcome, "good", 200 * seconds);

    // The signal is answered without a reader: within 100 ms, a frame, and what the script takes.
    let end: u64 = left("stalled-reader", "end").trim().parse().expect("a number");
    assert!(end <= 12, "the run ended {end}0 ms after the signal");
    let unread = outcome.report["output"]["unread_bytes"].as_u64().unwrap_or(0);
    assert!(unread > 0, "somebody has read on\n{}", outcome.report["output"]);

    // What was lost is counted, and was said when it flowed again. The guests have printed far more than a
    // pipe and the lanes hold.
    for name in ["one", "other"] {
        let dropped = outcome.number(name, "console_dropped");
        assert!(dropped > 100_000 * seconds, "{name}: {dropped}\n{}", outcome.output);
        let told = outcome.output.lines().filter_map(|line| {
            let line = line.strip_prefix("[takt] console: ")?;
            line.strip_suffix(&format!(" bytes of {name} dropped"))?.parse::<u64>().ok()
        });
        let told: u64 = told.sum();
        assert!(told > 0 && told <= dropped, "{name}: {told} of {dropped}");
    }
    // The quiet guest beside them lost nothing, nor did Takt.
    assert_eq!(outcome.number("good", "console_dropped"), 0, "{}", outcome.output);
    assert_eq!(outcome.report["output"]["takt_dropped_bytes"], 0);
    outcome.assert_shows("[takt] test: starting good, one, other");
}

/// An ext4 with a file for a disk.
fn slow_image() -> PathBuf {
    let folder = target("tests/slow-disk");
    let _ = fs::remove_dir_all(&folder);
    let tree = folder.join("tree");
    fs::create_dir_all(&tree).unwrap();
    fs::File::create(tree.join("disk")).unwrap().set_len(4 << 20).unwrap();
    let image = folder.join("image");
    fs::File::create(&image).unwrap().set_len(8 << 20).unwrap();
    let mut mke2fs = Command::new("mke2fs");
    mke2fs.args(["-q", "-t", "ext4", "-O", "^has_journal", "-d"]).arg(&tree).arg(&image);
    assert!(mke2fs.status().expect("mke2fs starts").success());
    image.canonicalize().unwrap()
}

/// A Linux with windows, whose thread the host's watchdog looks at, has written and flushed for long when its
/// disk stands still, and is started again under requests that the disk is busy with. Where the thread waited
/// for the disk it would be taken for stuck, and the machine restarted.
#[test]
fn a_disk_that_stands_still_holds_up_neither_its_linux_nor_a_new_start_nor_the_watchdog() {
    let image = slow_image();
    // Two megabytes each, and a flush. What a terminal has not sent yet is lost at a reboot: the kernel's log is not.
    let loops = if long() { 1_024 } else { 32 };
    let exec = format!(
        "say() {{ echo $1 > /dev/kmsg; }}; \
         if head -c 4 /dev/vda | grep -q done; then sync; say alive; poweroff -f; fi; \
         echo done > /dev/vda; sync; \
         w() {{ dd if=/dev/zero of=/dev/vda bs=64k seek=1 count=32 conv=fsync; }}; n=0; \
         while [ $n -lt {loops} ]; do w 2> /dev/null; n=$((n+1)); done; \
         echo; echo $((2*n)) MiB flushed; echo writing; \
         (while :; do w; done) > /dev/null 2>&1 & sleep 1; say restarting; reboot -nf"
    );
    let initrd = target("guest/initrd.img");
    let kernel = target("guest/vmlinuz");
    let file = File::new("10ms")
        .watchdog("1s")
        .plc("plc", None, "")
        .lines(&format!(
            "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nmemory = \"128MiB\"\n\
             kernel = {:?}\ninitrd = {:?}\ncmdline = \"console=ttyS0 takt.exec=\\\"{exec}\\\"\"\n\
             restarts = {{ at_most = 1, within = \"60s\" }}\n\
             [[partition.disk]]\npath = \"/mnt/disk\"\nread_only = false",
            kernel, initrd,
        ))
        .health("linux", "partition-reset", "cold-start")
        .health("linux", "partition-ended", "shut-down")
        .schedule("normal")
        .window("plc", 0, 200)
        .window("linux", 500, 8_000)
        .save("slow-disk");
    let _ = fs::remove_dir_all(target("tests/slow-disk.out"));
    let outcome = ["loop", "ext4"]
        .iter()
        .fold(host(), |host, module| host.with("--module", module))
        .with("--memory", "512")
        .with_file(&file)
        .with_file(&image)
        .with_file(&kernel)
        .with_file(&initrd)
        .run("slow-disk", &[&path(&file), &path(&image)]);
    let console = left("slow-disk", "console");
    assert_eq!(outcome.status, 0, "{}\n{console}", outcome.output);
    let outcome = Outcome { output: console, ..outcome };
    assert_nothing_late(&outcome, "plc", 500);
    // It was reset, and started again, while nothing could be written.
    let at = |text: &str| {
        let found = outcome.output.find(text);
        found.unwrap_or_else(|| panic!("no {text:?}\n{}", outcome.output))
    };
    let restarted = at("partition-reset: asked for a restart -> cold-start");
    outcome.assert_shows(&format!("{} MiB flushed", 2 * loops));
    assert!(at("] restarting") < restarted && restarted < at("[host] the file system is thawed"));
    assert!(at("[host] the file system is thawed") < at("] alive"));
    assert_eq!(outcome.number("linux", "restarts"), 1);
}

fn path(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}
