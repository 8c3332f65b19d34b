//! From an empty folder to a tested image, with the documented commands only. Needs cargo, gcc and make.

mod common;

use common::Folder;

#[test]
fn a_rust_project_is_made_built_inspected_and_tested() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "rust"]).expect(0, "tank");
    let words = ["build", "--release", "--offline", "--manifest-path", "tank/Cargo.toml"];
    folder.run("cargo", &words).expect(0, "Finished");
    let library = "tank/target/release/libtank.a";
    folder.takt_plc(&["build", library, "-o", "tank.plc"]).expect(0, "2 tasks, 5 points");
    let shown = folder.takt_plc(&["inspect", "tank.plc"]).expect(0, "tank 0.1.0");
    let shown = shown.expect(0, "every 10 ms, priority 0, budget 500 us");
    shown.expect(0, "%IX4.0").expect(0, "retain forceable");
    let table = "tank/tests/tank.csv";
    folder.takt_plc(&["test", "tank.plc", table]).expect(0, "11 cycles, 110 ms");
}

#[test]
fn a_panic_in_rust_is_told_with_message_and_line() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "panics", "--lang", "rust"]).expect(0, "");
    let source = r#"#![no_std]
use takt_sdk::{Cyclic, Job};
takt_sdk::program!("panics", 1, 0, 0);
takt_sdk::input!(INDEX: u32, "index", 0);
takt_sdk::point!(ROW: [i32; 3] = [5, 6, 7], "row");
takt_sdk::output!(FOUND: i32, "found", 0);
takt_sdk::queue!(JOBS, "jobs", bytes = 4, depth = 2);
takt_sdk::flags!(A, "a");
takt_sdk::mailbox!(LAST, "last", bytes = 4);
takt_sdk::semaphore!(LOCK, "lock", ceiling = 0);
takt_sdk::init!(start);
takt_sdk::task!("run", run, Cyclic::DEFAULT);
fn start(_: &Job) {
    takt_sdk::call::log("hello");
}
fn run(_: &Job) {
    let value = ROW.get()[INDEX.get() as usize];
    JOBS.send(&value.to_le_bytes()).unwrap();
    let mut bytes = [0; 4];
    assert_eq!(JOBS.receive(&mut bytes, 0), Ok(4));
    LAST.write(&bytes).unwrap();
    assert_eq!(LAST.read(&mut bytes), Ok((4, true)));
    A.set(6).unwrap();
    assert_eq!(A.wait_any(3, 10), Ok(2));
    let locked = LOCK.with(0, || i32::from_le_bytes(bytes)).unwrap();
    FOUND.set(locked);
}
"#;
    folder.write("panics/src/lib.rs", source);
    let words = ["build", "--release", "--offline", "--manifest-path", "panics/Cargo.toml"];
    folder.run("cargo", &words).expect(0, "Finished");
    let library = "panics/target/release/libpanics.a";
    folder.takt_plc(&["build", library, "-o", "p.plc"]).expect(0, "");
    folder.write("good.csv", "index,found,row[2]\n0,5,7\n2,7,\n");
    folder.takt_plc(&["test", "p.plc", "good.csv"]).expect(0, "[0 ns init] hello");
    folder.write("bad.csv", "index\n3\n");
    let ended = folder.takt_plc(&["test", "p.plc", "bad.csv"]).expect(3, "the program gave up");
    ended.expect(3, "src/lib.rs:17: index out of bounds: the len is 3 but the index is 3");
}

#[test]
fn a_c_project_is_made_built_inspected_and_tested() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "c"]).expect(0, "tank");
    folder.run("make", &["-C", "tank", "test"]).expect(0, "11 cycles, 110 ms");
    folder.takt_plc(&["inspect", "tank/tank.plc", "--json"]).expect(0, "\"period_ns\": 10000000");
    folder.takt_plc(&["new", "tank", "--lang", "c"]).expect(2, "tank is there already");
    folder.takt_plc(&["new", "Tank 2", "--lang", "c"]).expect(2, "small letters");
}

#[test]
fn function_blocks_are_used_in_c() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "filter", "--lang", "c"]).expect(0, "");
    let source = r#"#include "takt.h"
#include "blocks.h"
TAKT_PROGRAM("filter", 0, 1, 0, 0);
TAKT_INPUT(LREAL, measured, 0);
TAKT_OUTPUT(LREAL, valve, 0);
static struct takt_pid level = {.tuning = {.proportional = 4.0, .high = 10.0}};
static void control(const takt_job *job) {
    valve = takt_pid_update(&level, 1.5, measured, job->period_ns);
}
TAKT_CYCLIC(control, .period = TAKT_MS(10));
"#;
    folder.write("filter/tank.c", source);
    folder.write("filter/tests/tank.csv", "measured,valve\n1,2\n0.5,4\n");
    folder.run("make", &["-C", "filter", "test"]).expect(0, "2 cycles, 20 ms");
}

#[test]
fn function_blocks_are_used_in_rust() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "filter", "--lang", "rust"]).expect(0, "");
    let source = r#"#![no_std]
use core::time::Duration;
use takt_blocks::{Pid, Statistics, Tuning};
use takt_sdk::{Cyclic, Job};
takt_sdk::program!("filter", 0, 1, 0);
takt_sdk::input!(MEASURED: f64, "measured", 0);
takt_sdk::output!(VALVE: f64, "valve", 0);
takt_sdk::task!("control", control, Cyclic::DEFAULT);
fn control(job: &Job) {
    let mut level = Pid::new(Tuning { proportional: 4.0, high: 10.0, ..Tuning::default() });
    let mut spread = Statistics::<4>::new();
    spread.update(MEASURED.get());
    let elapsed = Duration::from_nanos(job.period_ns);
    VALVE.set(level.update(1.5, MEASURED.get(), elapsed) + spread.standard_deviation());
}
"#;
    folder.write("filter/src/lib.rs", source);
    folder.write("filter/tests/tank.csv", "measured,valve\n1,2\n0.5,4\n");
    folder.run("make", &["-C", "filter", "test"]).expect(0, "2 cycles");
}

#[test]
fn the_rust_project_is_tested_by_make() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "two-tanks", "--lang", "rust"]).expect(0, "");
    folder.run("make", &["-C", "two-tanks", "test"]).expect(0, "two-tanks: 11 cycles, 110 ms");
}

#[test]
fn rust_and_c_make_the_same_control_program() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "a", "--lang", "rust"]).expect(0, "");
    folder.takt_plc(&["new", "b", "--lang", "c"]).expect(0, "");
    assert_eq!(folder.read("a/tests/tank.csv"), folder.read("b/tests/tank.csv"));
}
