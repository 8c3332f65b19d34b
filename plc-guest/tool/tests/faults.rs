//! What a program does wrong is told with its place, and never touches this machine.

mod common;

use std::fs;
use std::process::{Command, Stdio};

use common::Folder;

const SOURCE: &str = include_str!("programs/faults.c");

/// The line of the source with this comment.
fn line(comment: &str) -> String {
    let index = SOURCE.lines().position(|line| line.contains(&format!("/* {comment} */"))).unwrap();
    format!("faults.c:{}", index + 1)
}

#[test]
fn every_fault_is_told_with_its_line() {
    let folder = Folder::new();
    folder.c_program("faults", SOURCE).expect(0, "faults 1.0.0");
    let faults = [
        (1, "null reference (0x0)", "null"),
        (2, "division by zero", "zero"),
        (3, "it did not end in time", "endless"),
        (4, "which is data, called at", "data"),
        (5, "a call of another operating system", "foreign"),
        (6, "privileged instruction", "privileged"),
        (7, "stack overflow", "stack"),
        (10, "write to read-only memory at 0x68000000, an input", "input"),
        (11, "write to code at 0x40000000", "code"),
        (12, "call of a null function pointer (0x0), called at", "nowhere"),
        (13, "access to 0x7fffffff0000, where nothing is", "wild"),
        (14, "breakpoint or single-step trap", "single step"),
        (15, "illegal instruction", "illegal"),
    ];
    for (number, says, comment) in faults {
        folder.write("t.csv", &format!("what\n0\n{number}\n"));
        let ended = folder.takt_plc(&["test", "faults.plc", "t.csv", "--time-limit", "200"]);
        let ended = ended.expect(3, says).expect(3, "task run, job 1, at 1 ms");
        ended.expect(3, &line(comment));
    }
}

#[test]
fn a_program_that_gives_up_says_why() {
    let folder = Folder::new();
    folder.c_program("faults", SOURCE).expect(0, "");
    folder.write("fails.csv", "what\n8\n");
    let ended = folder.takt_plc(&["test", "faults.plc", "fails.csv"]);
    ended.expect(3, "the program gave up").expect(3, "last log line: no pressure");
    folder.write("stops.csv", "what\n9\n");
    folder
        .takt_plc(&["test", "faults.plc", "stops.csv"])
        .expect(3, "stopped the program with code 5");
}

#[test]
fn system_calls_of_this_machine_are_not_carried_out() {
    let folder = Folder::new();
    folder.c_program("faults", SOURCE).expect(0, "");
    folder.write("t.csv", "what,refused\n16,1\n16,2\n");
    folder.takt_plc(&["test", "faults.plc", "t.csv"]).expect(0, "2 cycles, 2 ms");
}

#[test]
fn nothing_of_the_tool_is_in_reach_of_a_program() {
    let folder = Folder::new();
    // Looks for any mapped memory by asking the kernel to write a log line from there: a bad pointer is an error,
    // and a page of the tool's would be none of the program's regions anyway; so it also reads it itself.
    let source = r#"
        #include "takt.h"
        TAKT_PROGRAM("peek", 1, 0, 0, 0);
        TAKT_INPUT(ULINT, where, 0);
        TAKT_OUTPUT(DINT, result, 0);
        static void run(const takt_job *job) {
            (void)job;
            result = (int)takt_call(2, where, 8, 0, 0);
            result = *(volatile int *)where;
        }
        TAKT_CYCLIC(run, .period = TAKT_MS(1));
    "#;
    folder.c_program("peek", source).expect(0, "");
    // Where Linux puts a program, its heap and its libraries, and addresses that are none.
    for at in [
        "4194304",
        "16#555555554000",
        "16#7ffff7fff000",
        "16#7ffffffde000",
        "0",
        "16#ffff800000000000",
    ] {
        folder.write("t.csv", &format!("where\n{at}\n"));
        folder.takt_plc(&["test", "peek.plc", "t.csv"]).expect(3, "task run, job 0");
    }
}

#[test]
fn signals_from_outside_do_not_concern_a_program() {
    let folder = Folder::new();
    let source = r#"
        #include "takt.h"
        TAKT_PROGRAM("long", 1, 0, 0, 0);
        static void run(const takt_job *job) {
            (void)job;
            for (volatile int i = 0; i < 300000000; i++) continue;
        }
        TAKT_CYCLIC(run, .period = TAKT_MS(1));
    "#;
    folder.c_program("long", source).expect(0, "");
    let mut tool = Command::new(env!("CARGO_BIN_EXE_takt-plc"))
        .args(["test", "long.plc", "--time-limit", "60000"])
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let id = tool.id();
    let mut sent = 0;
    while tool.try_wait().unwrap().is_none() {
        let children = fs::read_to_string(format!("/proc/{id}/task/{id}/children"));
        let Some(child) =
            children.ok().and_then(|all| Some(all.split_whitespace().next()?.to_owned()))
        else {
            continue;
        };
        let maps = fs::read_to_string(format!("/proc/{child}/maps")).unwrap_or_default();
        // Not yet the program, or not any more.
        if maps.is_empty() || maps.contains("takt-plc") {
            continue;
        }
        // Not before: it leaves the group of the tool on its way to the program.
        let stat = fs::read_to_string(format!("/proc/{child}/stat")).unwrap_or_default();
        // Behind the name: state, parent, group.
        let group = stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(2));
        let Some(group) = group else { continue };
        assert_eq!(group, child, "a terminal's signals reach it");
        // A terminal has another size; Ctrl-Z and fg.
        for signal in ["-WINCH", "-TSTP", "-CONT"] {
            Command::new("kill").args([signal, &child]).stderr(Stdio::null()).status().unwrap();
        }
        sent += 1;
    }
    let output = tool.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(sent > 0, "no signal was sent while the program ran");
}
