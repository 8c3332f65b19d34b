//! A Linux with two disks beside a PLC that keeps its time.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_tests::random::Random;
use takt_tests::{File, Host, Outcome, target};

/// Bytes of the file on the first disk.
const BYTES: usize = 512 << 10;

/// Makes two files for the disks of a test: one with an ext4 in which there is a file of noise, and an empty one.
/// Returns them, and the noise's checksum.
fn disks(test: &str) -> (PathBuf, PathBuf, String) {
    let folder = target("tests").join(format!("{test}-files"));
    let _ = fs::remove_dir_all(&folder);
    let tree = folder.join("tree");
    fs::create_dir_all(&tree).unwrap();
    let mut random = Random::new(1);
    let noise: Vec<u8> = (0..BYTES / 8).flat_map(|_| random.number().to_le_bytes()).collect();
    fs::write(tree.join("noise"), noise).unwrap();
    let (first, second) = (folder.join("first.img"), folder.join("second.img"));
    for disk in [&first, &second] {
        fs::File::create(disk).unwrap().set_len(2 << 20).unwrap();
    }
    let mut mke2fs = Command::new("mke2fs");
    // Without a journal: a disk that is only read has nothing to replay.
    mke2fs.args(["-q", "-t", "ext4", "-O", "^has_journal", "-d"]).arg(&tree).arg(&first);
    assert!(mke2fs.status().expect("mke2fs starts").success());
    (first, second, checksum(&tree.join("noise")))
}

fn checksum(path: &Path) -> String {
    let output = Command::new("sha256sum").arg(path).output().expect("sha256sum starts");
    let text = String::from_utf8(output.stdout).unwrap();
    text.split_whitespace().next().expect("a checksum").to_owned()
}

/// A Linux that does something with `/dev/vda`, which it can only read, and `/dev/vdb`, until the
/// console shows the text `done`.
fn run(name: &str, disks: [&Path; 2], exec: &str, more: &str, done: &str) -> Outcome {
    let [first, second] = disks;
    File::new("1ms")
        .plc("plc", None, "")
        .linux(exec)
        .lines(more)
        .lines(&format!("[[partition.disk]]\npath = {first:?}"))
        .lines(&format!("[[partition.disk]]\npath = {second:?}\nread_only = false"))
        .schedule("normal")
        .window("plc", 0, 200)
        .run(name)
        .lasting("60s")
        .until(done)
        .run()
}

#[test]
fn a_linux_reads_one_disk_and_writes_the_other_and_the_plc_keeps_its_time() {
    let (first, second, noise) = disks("disk");
    let exec = "mkdir /mnt; mount -r /dev/vda /mnt; sha256sum /mnt/noise; \
                dd if=/mnt/noise of=/dev/vdb bs=64k conv=fsync; \
                echo 1 > /proc/sys/vm/drop_caches; \
                head -c 524288 /dev/vdb | sha256sum; \
                dd if=/mnt/noise of=/dev/vda count=1 || echo refused; \
                cat /sys/block/vdb/serial; echo; \
                echo virtio1 > /sys/bus/virtio/drivers/virtio_blk/unbind; \
                echo virtio1 > /sys/bus/virtio/drivers/virtio_blk/bind; \
                head -c 524288 /dev/vdb | sha256sum; echo all done";
    let outcome = run("disk", [&first, &second], exec, "", "\nall done");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("\nall done");
    assert_eq!(outcome.output.matches(&format!("\n{noise}")).count(), 3, "{}", outcome.output);
    outcome.assert_shows("\nrefused");
    outcome.assert_shows("\ntakt-1\r\n");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_disk_goes_past_the_page_cache_and_gives_space_back_where_the_hosts_file_system_allows_it() {
    let (first, _, noise) = disks("disk-direct");
    let folder = first.parent().unwrap();
    let (tree, volume) = (folder.join("volume"), folder.join("volume.img"));
    fs::create_dir_all(&tree).unwrap();
    fs::copy(folder.join("tree/noise"), tree.join("disk.img")).unwrap();
    fs::File::create(&volume).unwrap().set_len(8 << 20).unwrap();
    let mut mke2fs = Command::new("mke2fs");
    mke2fs.args(["-q", "-t", "ext4", "-d"]).arg(&tree).arg(&volume);
    assert!(mke2fs.status().expect("mke2fs starts").success());

    // Reads and writes of a sector too, which lies in the middle of a block of the host's file system.
    let exec = "sha256sum /dev/vda; dd if=/dev/vda of=/sector bs=512 skip=3 count=1; \
                dd if=/sector of=/dev/vda bs=512 seek=1000 count=1 oflag=direct; \
                dd if=/dev/vda of=/again bs=512 skip=1000 count=1 iflag=direct; \
                cmp /sector /again && echo the same; \
                sum() { dd bs=4096 $@ | sha256sum | cut -c 1-64; }; \
                first=$(sum if=/dev/vda count=1); last=$(sum if=/dev/vda skip=127 count=1); \
                blkdiscard -o 4096 -l 516096 /dev/vda; echo 3 > /proc/sys/vm/drop_caches; \
                [ $(sum if=/dev/vda skip=1 count=126) = $(sum if=/dev/zero count=126) ] && echo cleared; \
                [ $(sum if=/dev/vda count=1) = $first ] && echo the first is kept; \
                [ $(sum if=/dev/vda skip=127 count=1) = $last ] && echo the last is kept; echo all done";
    let file = File::new("1ms")
        .plc("plc", None, "")
        .linux(exec)
        .lines("[[partition.disk]]\npath = \"/volume/disk.img\"\nread_only = false\ndirect = true")
        .schedule("normal")
        .window("plc", 0, 200)
        .save("disk-direct");
    let volume = volume.canonicalize().unwrap();
    let host = Host::new().with("--module", "loop").with("--module", "ext4");
    let host = host.with_file(&file).with_file(&volume);
    let host = ["guest/vmlinuz", "guest/initrd.img"]
        .iter()
        .fold(host, |host, image| host.with_file(&target(image)));
    let arguments = [&*file.to_string_lossy(), &*volume.to_string_lossy(), "/volume"];
    let outcome = host.run_as("disk-direct", "direct-disk", &arguments);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("/volume/disk.img cannot be used with direct = true: Invalid argument");
    outcome.assert_shows("[host] in memory: 2");
    outcome.assert_shows(&format!("\n{noise}"));
    for line in ["the same", "cleared", "the first is kept", "the last is kept"] {
        outcome.assert_shows(&format!("\n{line}"));
    }
    // Two blocks of 4 KiB are left of it on the host, of 128.
    outcome.assert_shows("[host] disk sectors: 16");
    let flags = outcome.output.split_once("[host] disk flags:\t").expect("flags").1;
    let flags = i32::from_str_radix(flags.lines().next().unwrap().trim(), 8).unwrap();
    assert!(flags & libc::O_DIRECT != 0, "{flags:o}");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

/// What was written by one life of Linux, the next finds, and its device as at power-on.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_linux_that_starts_again_finds_its_disks_as_it_left_them() {
    let (first, second, noise) = disks("disk-restart");
    let exec = "mkdir /mnt; mount -r /dev/vda /mnt; head -c 524288 /dev/vdb | sha256sum; \
                dd if=/mnt/noise of=/dev/vdb bs=64k conv=fsync; cat /dev/vdb > /dev/null & \
                reboot -f";
    let limit = "restarts = { at_most = 1, within = \"60s\" }";
    let outcome = run("disk-restart", [&first, &second], exec, limit, "within 60s");
    // A partition whose last life ended with a restart has failed.
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    assert_eq!(outcome.number("linux", "restarts"), 1, "{}", outcome.output);
    assert_eq!(outcome.output.matches(&format!("\n{noise}")).count(), 1, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
}
