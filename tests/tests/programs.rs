//! The programs that tests run in a Linux guest, here on a folder of plain files.

#[path = "../../devices/port/tests/loopback/mod.rs"]
mod loopback;

use std::fs;
use std::os::fd::{AsRawFd, FromRawFd};
use std::os::unix::fs::{FileExt, symlink};
use std::process::{Command, Output};

use loopback::Loopback;
use takt_port::{Ports, Start, Timeout};
use takt_tests::record::record;

fn run(program: &str, arguments: &[&str], folder: &Loopback) -> Output {
    Command::new(program).args(arguments).arg(folder.path()).output().unwrap()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// What is sent to `receive` before the program starts; its own records come back to it after that.
fn exchange(first: &[u8], count: &str) -> Output {
    let folder = Loopback::new();
    let ports = Ports::open(folder.path()).unwrap();
    ports.sender("send", Start::Attach).unwrap().send(first, Timeout::Zero).unwrap();
    run(env!("CARGO_BIN_EXE_exchange"), &[count], &folder)
}

#[test]
fn exchange_takes_and_answers_every_record() {
    let output = exchange(&record(0), "2500");
    let text = text(&output);
    assert!(output.status.success(), "{text}");
    assert_eq!(text.matches("exchange: messages ").count(), 3, "{text}");
    assert!(text.contains("torn 0, lost 0, duplicated 0, wrong 0, hostile 0"), "{text}");
    assert!(text.contains("exchange: messages 2500, "), "{text}");
}

#[test]
fn exchange_notices_records_that_are_torn_or_come_again() {
    for (first, says) in [(record(7), "duplicated 1,"), ([1; 512], "duplicated 1,")] {
        let output = exchange(&first, "3");
        assert_eq!((output.status.code(), text(&output).contains(says)), (Some(1), true));
    }
    let mut torn = record(0);
    torn[300] = 1;
    let output = exchange(&torn, "3");
    assert_eq!((output.status.code(), text(&output).contains("torn 1,")), (Some(1), true));
    let folder = Loopback::new();
    folder.damage(4096 + 16, &[9]);
    let output = run(env!("CARGO_BIN_EXE_exchange"), &["1"], &folder);
    assert_eq!(output.status.code(), Some(70), "{}", text(&output));
}

/// A folder in which `resource2` is not the same memory as `resource1`.
fn apart() -> Loopback {
    let folder = Loopback::new();
    fs::remove_file(folder.path().join("resource2")).unwrap();
    fs::write(folder.path().join("resource2"), vec![0; 65536]).unwrap();
    fs::write(folder.path().join("config"), [0; 256]).unwrap();
    folder
}

/// Puts memory in the place of `resource1` that cannot be mapped for writing, as a read-only slot
/// cannot be written. It is there for as long as the file lives.
fn make_read_only(folder: &Loopback) -> fs::File {
    let path = folder.path().join("resource1");
    let content = fs::read(&path).unwrap();
    // SAFETY: the name is a string with its zero.
    let memory = unsafe { libc::memfd_create(c"resource1".as_ptr(), libc::MFD_ALLOW_SEALING) };
    assert!(memory >= 0);
    // SAFETY: a new descriptor that has no other owner.
    let memory = unsafe { fs::File::from_raw_fd(memory) };
    memory.write_all_at(&content, 0).unwrap();
    // SAFETY: no memory is involved.
    let sealed = unsafe { libc::fcntl(memory.as_raw_fd(), libc::F_ADD_SEALS, libc::F_SEAL_WRITE) };
    assert_eq!(sealed, 0);
    fs::remove_file(&path).unwrap();
    let descriptor = format!("/proc/{}/fd/{}", std::process::id(), memory.as_raw_fd());
    symlink(descriptor, &path).unwrap();
    memory
}

#[test]
fn hostile_does_all_its_steps_and_the_same_ones_for_the_same_seed() {
    let results = [(), ()].map(|()| {
        let folder = apart();
        let _memory = make_read_only(&folder);
        let output = run(env!("CARGO_BIN_EXE_hostile"), &["3", "20000"], &folder);
        assert!(output.status.success(), "{}", text(&output));
        assert_ne!(fs::read(folder.path().join("config")).unwrap()[..64], [0; 64]);
        (text(&output), fs::read(folder.path().join("resource2")).unwrap())
    });
    assert_eq!(results[0], results[1]);
    let (text, writable) = &results[0];
    assert!(text.contains("read-only 0,") && text.contains("table unchanged"), "{text}");
    let pages = writable.chunks(4096).filter(|page| page.iter().any(|byte| *byte != 0)).count();
    assert_eq!(pages, 16, "some page was never written");
}

#[test]
fn hostile_notices_a_table_that_it_could_change() {
    let folder = apart();
    let output = run(env!("CARGO_BIN_EXE_hostile"), &["1", "5000"], &folder);
    let text = text(&output);
    assert_eq!((output.status.code(), text.contains("table CHANGED")), (Some(1), true), "{text}");
}

#[test]
fn hostile_goes_on_where_it_is_refused() {
    let folder = apart();
    fs::remove_file(folder.path().join("resource2")).unwrap();
    fs::remove_file(folder.path().join("config")).unwrap();
    let output = run(env!("CARGO_BIN_EXE_hostile"), &["1", "1000"], &folder);
    let text = text(&output);
    let says = text.contains("writable 0,") && text.contains("configuration 0,");
    assert!(says && !text.contains("refused 0,"), "{text}");
}

#[test]
fn compare_measures_what_there_is() {
    let output = Command::new(env!("CARGO_BIN_EXE_compare")).arg("200").output().unwrap();
    let text = text(&output);
    assert!(output.status.success(), "{text}");
    for name in ["queuing channel", "sampling channel", "socket pair", "TCP loopback"] {
        let line = text.lines().find(|line| line.starts_with(name)).unwrap();
        let numbers: Vec<u64> = line[18..].split_whitespace().flat_map(str::parse).collect();
        assert_eq!(numbers.len(), 5, "{line}");
        assert!(numbers.iter().all(|n| *n > 0), "{line}");
    }
}
