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
        ("empty", "error[no-source]: empty: no file in this folder ends with .st"),
        ("nothing.st", "error[cannot-read]: nothing.st: cannot be read: "),
        ("binary.st", "error[not-text]: binary.st:1:3: byte 2 is not UTF-8 text"),
        ("line.st", "error[too-large]: line.st: more than 8388608 bytes"),
        ("/dev/zero", "error[no-source]: /dev/zero: neither a file nor a folder"),
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

/// The messages of a run as JSON: code, file and line of each.
fn told(arguments: &[&str], folder: &Path) -> Vec<(String, String, Option<u64>)> {
    let output = check(&[&["--message-format", "json"], arguments].concat(), folder);
    let text = String::from_utf8(output.stdout).expect("it is text");
    let line = |line| {
        let one: serde_json::Value = serde_json::from_str(line).expect("it is JSON");
        let word = |value: &serde_json::Value| value.as_str().unwrap_or_default().to_owned();
        let place = &one["place"];
        (word(&one["code"]), word(&place["file"]), place["line"].as_u64())
    };
    text.lines().map(line).collect()
}

fn expected(list: &[(&str, &str, Option<u64>)]) -> Vec<(String, String, Option<u64>)> {
    list.iter().map(|(code, file, line)| (code.to_string(), file.to_string(), *line)).collect()
}

#[test]
fn a_file_that_cannot_be_read_hides_no_error_of_another() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, bytes: &[u8]| {
        std::fs::write(folder.path().join(name), bytes).expect("it can be written");
    };
    write("a.st", b"FUNCTION a : INT\nVAR x : INT; END_VAR\n// \xE4\na := 1;\nEND_FUNCTION\n");
    write("b.st", WRONG.as_bytes());
    write("c.st", &[b' '; (8 << 20) + 1]);
    write("e.st", b"P\0R\0O\0G\0");
    let text = error_text(&check(&["e.st"], folder.path()));
    assert!(text.contains("hint: it seems to be text in UTF-16: save it in UTF-8"), "{text}");
    assert_eq!(
        told(&["a.st", "b.st", "c.st", "d.st"], folder.path()),
        expected(&[
            ("not-text", "a.st", Some(3)),
            ("unknown-name", "b.st", Some(3)),
            ("too-large", "c.st", None),
            ("cannot-read", "d.st", None),
        ])
    );
}

#[test]
fn of_too_many_files_those_are_checked_that_may_be_there() {
    let folder = tempfile::tempdir().expect("a folder");
    for number in 0..4100 {
        let name = format!("f{number:04}.st");
        std::fs::write(folder.path().join(name), "").expect("it can be written");
    }
    std::fs::write(folder.path().join("a.st"), WRONG).expect("it can be written");
    assert_eq!(
        told(&["."], folder.path()),
        expected(&[("unknown-name", "./a.st", Some(3)), ("too-large", "./f4095.st", None)])
    );
}

#[test]
fn a_project_file_with_mistakes_hides_no_error_of_a_source() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).expect("it can be written");
    };
    write("main.st", WRONG);
    let both = expected(&[
        ("project-file", "takt-plc.toml", Some(2)),
        ("unknown-name", "main.st", Some(3)),
    ]);
    for second in ["version = \"1\"", "colour = 7", "version = 1.2.0"] {
        write("takt-plc.toml", &format!("name = \"tank\"\n{second}\n"));
        assert_eq!(told(&[], folder.path()), both, "{second}");
    }
    // Where the sources are is not known: what they have is not either.
    for second in ["sorces = [\"src\"]", "libraries = [\"none\"]", "sources = [\"a\""] {
        write("takt-plc.toml", &format!("name = \"tank\"\n{second}\n"));
        let found = told(&[], folder.path());
        assert!(found.iter().all(|(code, ..)| code == "project-file"), "{second}: {found:?}");
        assert!(!found.is_empty(), "{second}");
    }
}

#[test]
fn a_link_to_a_folder_around_it_is_told_and_not_followed() {
    let folder = tempfile::tempdir().expect("a folder");
    let inner = folder.path().join("plant/pumps");
    std::fs::create_dir_all(&inner).expect("it can be made");
    std::fs::write(inner.join("main.st"), WRONG).expect("it can be written");
    std::os::unix::fs::symlink("../..", inner.join("back")).expect("a link");
    // A link to another folder is followed.
    std::fs::create_dir(folder.path().join("other")).expect("it can be made");
    std::fs::write(folder.path().join("other/o.st"), "x").expect("it can be written");
    std::os::unix::fs::symlink("../other", folder.path().join("plant/other")).expect("a link");
    assert_eq!(
        told(&["plant"], folder.path()),
        expected(&[
            ("syntax", "plant/other/o.st", Some(1)),
            ("unknown-name", "plant/pumps/main.st", Some(3)),
            ("folder-loop", "plant/pumps/back", None),
        ])
    );
}

/// What the compiler finds only when it makes code.
#[test]
fn what_build_refuses_check_refuses_with_the_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = "FUNCTION big : INT\nVAR a : ARRAY[1..800000] OF INT; i : INT; END_VAR\na[1] := i;\n\
                i := a[i + 1];\nbig := a[i];\nEND_FUNCTION\n\
                PROGRAM Main\nVAR x AT %QW0 : INT; END_VAR\nx := big();\nEND_PROGRAM\n\
                CONFIGURATION c\nTASK t (INTERVAL := T#1ms, PRIORITY := 1);\nPROGRAM p WITH t : Main;\n\
                END_CONFIGURATION\n";
    std::fs::write(folder.path().join("main.st"), text).expect("it can be written");
    let codes = told(&["main.st"], folder.path());
    let stack = ("stack-too-large".to_owned(), "main.st".to_owned(), Some(12));
    assert!(codes.contains(&stack), "{codes:?}");
    let text = error_text(&check(&["main.st"], folder.path()));
    for part in [
        "main.st:12:6: the task `t` needs 16",
        "`big` takes most: 16",
        "`a` has 1600000",
        "main.st:1:10: `big` is",
    ] {
        assert!(text.contains(part), "{part}: {text}");
    }
}

#[test]
fn the_status_is_told_though_no_message_can_be_written() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("main.st"), WRONG).expect("it can be written");
    for file in ["main.st", "none.st"] {
        let full = std::fs::File::options().write(true).open("/dev/full").expect("it opens");
        let mut command = Command::new(env!("CARGO_BIN_EXE_takt-plc"));
        let command = command.args(["check", file]).current_dir(folder.path()).stderr(full);
        assert_eq!(command.status().expect("the tool starts").code(), Some(2), "{file}");
    }
    let full = std::fs::File::options().write(true).open("/dev/full").expect("it opens");
    let mut command = Command::new(env!("CARGO_BIN_EXE_takt-plc"));
    let command = command.args(["check", "--message-format", "json", "main.st"]);
    let output = command.current_dir(folder.path()).stdout(full).output().expect("the tool starts");
    assert_eq!(output.status.code(), Some(4), "{output:?}");
    assert!(error_text(&output).contains("failed printing to stdout"), "{output:?}");
}
