//! What stands still beside Takt: a reader, a disk. Takt, its guests and the host's watchdog go on.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_tests::{File, Host, Outcome, SOON, initrd_with, long, plc_image, target};

/// What a test's script has left, by name.
fn left(test: &str, name: &str) -> String {
    let path = target("tests").join(format!("{test}.out")).join(name);
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

/// Its thread looked for room each millisecond, by a timer that came in windows too. The flood fills the pipe, and the Linux what
/// is its own.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_that_waits_for_a_reader_sets_no_timer() {
    let file = File::new("10ms")
        .plc("flood", Some(plc_image("flood")), "")
        .linux("echo 8 > /proc/sys/kernel/printk; while :; do echo t > /proc/sysrq-trigger; done")
        .schedule("normal")
        .window("flood", 1_000, 1_000)
        .save("waiting-linux");
    let files = [&file, &plc_image("flood"), &target("guest/vmlinuz"), &target("guest/initrd.img")];
    let host = files.into_iter().fold(Host::new(), |host, path| host.with_file(path));
    let outcome = host.run("waiting-linux", &[&file.to_string_lossy()]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let told = outcome.output.split_once("[host] it has waited ");
    let told = told.and_then(|(_, rest)| rest.split_once(" times, and has set "));
    let (waits, timers) = told.unwrap_or_default();
    assert!(waits.parse::<u64>().is_ok_and(|waits| waits > 0), "{}", outcome.output);
    assert!(timers.starts_with("0 timers"), "{timers}");
}

/// Two PLCs fail at once. The one with much memory comes first, and the supervisor thread does not clear that itself: the other
/// one starts long before.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_plc_whose_memory_takes_long_to_clear_keeps_no_other_from_its_start() {
    let image = plc_image("fault");
    let failing = |name: &str, memory: &str| {
        format!(
            "[[partition]]\nname = {name:?}\nkind = \"plc\"\ncpu = 0\nmemory = {memory:?}\nimage = {image:?}\n\
             restarts = {{ at_most = 1, within = \"60s\" }}"
        )
    };
    let outcome = File::new("10ms")
        .lines(&failing("large", "640MiB"))
        .lines(&failing("small", "4MiB"))
        .plc("good", None, "")
        .health("large", "memory-violation", "cold-start")
        .health("small", "memory-violation", "cold-start")
        .schedule("normal")
        .window("large", 1_000, 200)
        .window("small", 2_000, 200)
        .window("good", 3_000, 200)
        .run("large-plc")
        .lasting("3s")
        .run();
    // Both fail once more, and have no start left.
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    let between_faults = |name: &str| {
        assert_eq!(outcome.number(name, "restarts"), 1, "{}", outcome.output);
        let at = |number: usize| {
            let fault = &outcome.partition(name)["events"]["list"][number];
            assert_eq!(fault["error"], "memory-violation", "{}", outcome.output);
            fault["at_ns"].as_u64().unwrap_or_default()
        };
        at(1) - at(0)
    };
    // 101 releases after its start, which takes a second, and the start itself.
    let (large, small) = (between_faults("large"), between_faults("small"));
    println!("from fault to fault: {large} ns and {small} ns");
    assert!(large > 1_070_000_000, "its memory is cleared within some frames: {large} ns");
    assert!(small < 1_060_000_000, "it waited for the other one: {small} ns");
    assert_nothing_late(&outcome, "good", 290);
}

/// An ext4 with a file for a disk.
fn slow_image(test: &str) -> PathBuf {
    let folder = target("tests").join(test);
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

/// A Linux with windows, whose thread the host's watchdog looks at, with a disk in a file system that stands still
/// whenever it says that it is writing, until it says the cue.
fn with_slow_disk(test: &str, initrd: &Path, exec: &str, cues: &[&str]) -> Outcome {
    let image = slow_image(test);
    let kernel = target("guest/vmlinuz");
    let file = File::new("10ms")
        .watchdog("1s")
        .plc("plc", None, "")
        .lines(&format!(
            "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nmemory = \"128MiB\"\n\
             kernel = {kernel:?}\ninitrd = {initrd:?}\ncmdline = \"{SOON} takt.exec=\\\"{exec}\\\"\"\n\
             restarts = {{ at_most = 1, within = \"60s\" }}\n\
             [[partition.disk]]\npath = \"/mnt/disk\"\nread_only = false",
        ))
        .health("linux", "partition-reset", "cold-start")
        .health("linux", "partition-ended", "shut-down")
        .schedule("normal")
        .window("plc", 0, 200)
        .window("linux", 500, 8_000)
        .save(test);
    let _ = fs::remove_dir_all(target("tests").join(format!("{test}.out")));
    let (file, image) = (path(&file), path(&image));
    let arguments: Vec<&str> = [&*file, &*image].into_iter().chain(cues.iter().copied()).collect();
    let outcome = ["loop", "ext4"]
        .iter()
        .fold(host(), |host, module| host.with("--module", module))
        .with("--memory", "512")
        .with_file(Path::new(&file))
        .with_file(Path::new(&image))
        .with_file(&kernel)
        .with_file(initrd)
        .run_as(test, "slow-disk", &arguments);
    let console = left(test, "console");
    assert_eq!(outcome.status, 0, "{}\n{console}", outcome.output);
    let outcome = Outcome { output: console, ..outcome };
    // As the health table has it for the end of this Linux.
    assert_eq!(left(test, "exit"), "4\n", "{}", outcome.output);
    assert_nothing_late(&outcome, "plc", outcome.cycles(10_000) - 10);
    outcome
}

/// Where a text is first shown.
fn place(outcome: &Outcome, text: &str) -> usize {
    let found = outcome.output.find(text);
    found.unwrap_or_else(|| panic!("no {text:?}\n{}", outcome.output))
}

/// It has written and flushed for long when its disk stands still, and is started again under requests that the disk is
/// busy with. Where its thread waited for the disk it would be taken for stuck, and the machine restarted.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_disk_that_stands_still_holds_up_neither_its_linux_nor_a_new_start_nor_the_watchdog() {
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
    let outcome = with_slow_disk("slow-disk", &target("guest/initrd.img"), &exec, &["restarting"]);
    // It was reset, and started again, while nothing could be written.
    let at = |text: &str| place(&outcome, text);
    let restarted = at("partition-reset: asked for a restart -> cold-start");
    outcome.assert_shows(&format!("{} MiB flushed", 2 * loops));
    assert!(at("] restarting") < restarted && restarted < at("[host] the file system is thawed"));
    assert!(at("[host] the file system is thawed") < at("] alive"));
    assert_eq!(outcome.number("linux", "restarts"), 1);
}

/// A reset by the guest itself, twice: Linux's driver is taken from the disk while Linux writes, and waits for its
/// requests; then a driver that does not wait resets the disk under them, three times.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_disk_that_stands_still_is_reset_at_once_and_touches_no_request_that_it_has_lost() {
    let loops = if long() { 1_024 } else { 8 };
    let driver = "/sys/bus/platform/drivers/virtio-mmio";
    let exec = format!(
        "say() {{ echo $1 > /dev/kmsg; }}; \
         w() {{ [ -b /dev/vda ] && dd if=/dev/zero of=/dev/vda bs=64k seek=1 count=32 conv=fsync; }}; \
         n=0; while [ $n -lt {loops} ]; do w 2> /dev/null; n=$((n+1)); done; \
         echo; echo $((2*n)) MiB flushed; echo writing; \
         (while w; do :; done) > /dev/null 2>&1 & sleep 1; \
         (echo LNRO0005:00 > {driver}/unbind; say taken) & sleep 1; say waiting; wait; \
         echo; echo writing; reset-disk 0; echo status $?; \
         echo LNRO0005:00 > {driver}/bind; echo; w && say alive; sync; poweroff -f"
    );
    let initrd = target(&initrd_with("reset-disk", &[env!("CARGO_BIN_EXE_reset-disk").as_ref()]));
    let outcome =
        with_slow_disk("reset-disk", &initrd, &exec, &["waiting", "reset-under-requests"]);
    outcome.assert_shows(&format!("{} MiB flushed", 2 * loops));
    // Linux's driver waited until the first thaw, the other one for nothing.
    let thawed = outcome.output.match_indices("[host] the file system is thawed");
    let thawed: Vec<usize> = thawed.map(|(at, _)| at).collect();
    let at = |text: &str| place(&outcome, text);
    assert!(at("] waiting") < thawed[0] && thawed[0] < at("] taken"), "{}", outcome.output);
    assert!(at("] reset-under-requests") < thawed[1] && thawed[1] < at("] alive"));
    outcome.assert_shows("\nstatus 0");
    let line = outcome.output.lines().find_map(|line| line.strip_prefix("reset-disk: "));
    let line = line.unwrap_or_else(|| panic!("no figures\n{}", outcome.output));
    println!("{line}");
    let longest = line.split_once("the longest of ").and_then(|(_, rest)| rest.split_once(" ns"));
    let longest: Option<u64> = longest.and_then(|(ns, _)| ns.parse().ok());
    // A frame, in which Linux has 8 ms, and not the seconds until the thaw.
    assert!(longest.is_some_and(|ns| ns < 10_000_000), "{line}");
    assert_eq!(outcome.number("linux", "restarts"), 0);
}

fn path(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}
