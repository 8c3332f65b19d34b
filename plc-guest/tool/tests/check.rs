//! `takt plc check` as a user calls it.

use std::path::Path;
use std::process::{Command, Output};

const WRONG: &str = "PROGRAM p\nVAR level : INT; END_VAR\nlevl := 3;\nEND_PROGRAM\n";

fn check(arguments: &[&str], folder: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_takt-plc"))
        .arg("check")
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the tool starts")
}

fn error_text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

#[test]
fn a_mistake_is_shown_with_its_line_and_a_hint() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("main.st"), WRONG).expect("it can be written");
    let output = check(&["main.st"], folder.path());
    assert_eq!(output.status.code(), Some(2));
    let text = error_text(&output);
    for part in [
        "error[unknown-name]: main.st:3:1: ",
        " 3 | levl := 3;",
        "   | ^^^^",
        "did you mean `level`?",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn the_same_mistake_is_one_object_of_json() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("main.st"), WRONG).expect("it can be written");
    let output = check(&["--message-format", "json", "."], folder.path());
    let text = String::from_utf8(output.stdout).expect("it is text");
    let lines: Vec<serde_json::Value> =
        text.lines().map(|line| serde_json::from_str(line).expect("it is JSON")).collect();
    assert_eq!(lines.len(), 1);
    assert_eq!(lines[0]["code"], "unknown-name");
    assert_eq!(lines[0]["severity"], "error");
    assert_eq!(lines[0]["place"]["line"], 3);
    assert_eq!(lines[0]["place"]["end_column"], 5);
}

#[test]
fn what_is_no_source_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(folder.path().join("empty")).expect("it can be made");
    std::fs::write(folder.path().join("binary.st"), [0x7F, b'E', 0xFF, 0]).expect("it is written");
    std::fs::write(folder.path().join("line.st"), "x".repeat(10 << 20)).expect("it is written");
    for (path, message) in [
        ("empty", "empty: no file in this folder ends with .st"),
        ("nothing.st", "cannot read nothing.st"),
        ("binary.st", "binary.st: byte 2 is not UTF-8 text"),
        ("line.st", "line.st: more than 8388608 bytes"),
        ("/dev/zero", "/dev/zero: neither a file nor a folder"),
    ] {
        let output = check(&[path], folder.path());
        assert_eq!(output.status.code(), Some(2), "{path}");
        let text = error_text(&output);
        assert!(text.contains(message), "{path}: {text}");
    }
}

#[test]
fn a_project_without_a_mistake_is_checked_without_a_word() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = "PROGRAM p\nVAR t : TON; END_VAR\nt(IN := NOT t.Q, PT := T#1s);\nEND_PROGRAM\n";
    std::fs::write(folder.path().join("main.st"), text).expect("it can be written");
    let output = check(&["."], folder.path());
    assert_eq!((output.status.code(), error_text(&output)), (Some(0), String::new()));
}

#[test]
fn a_time_as_a_number_is_refused_with_the_way_by_nanoseconds() {
    let folder = tempfile::tempdir().expect("a folder");
    let checked = |value: &str| {
        let text = format!(
            "PROGRAM Main\nVAR t : TIME; r : LREAL; END_VAR\nt := T#1s;\nr := {value};\nt := T#2s * r;\nEND_PROGRAM\n"
        );
        std::fs::write(folder.path().join("main.st"), text).expect("it can be written");
        let output = check(&["main.st"], folder.path());
        (output.status.code(), error_text(&output))
    };
    let (status, text) = checked("TIME_TO_LREAL(t)");
    assert_eq!(status, Some(2));
    assert!(text.contains("hint: by nanoseconds: `LINT_TO_LREAL(TIME_TO_LINT(...))`"), "{text}");
    assert_eq!(checked("LINT_TO_LREAL(TIME_TO_LINT(t))"), (Some(0), String::new()));
}
