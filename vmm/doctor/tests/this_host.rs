//! `takt-doctor` as it is called, on whatever host runs this.

use std::process::{Command, Output};

use serde_json::Value;

fn doctor(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_takt-doctor")).args(arguments).output().unwrap()
}

fn shipped(file: &str) -> String {
    format!("{}/../../configs/{file}", env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn what_this_host_can_is_told_as_it_is() {
    let output = doctor(&[&shipped("plc-alone.toml"), "--json", "--for", "300ms"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let status = match report["verdict"].as_str().unwrap() {
        "good" => 0,
        "unseen" | "warning" => 1,
        "cannot" => 3,
        other => panic!("{other}"),
    };
    assert_eq!(output.status.code(), Some(status));
    assert_eq!(report["windowed_cpus"], Value::from(vec![0]));
    let findings = report["findings"].as_array().unwrap();
    let page =
        std::fs::read_to_string(format!("{}/../../docs/doctor.md", env!("CARGO_MANIFEST_DIR")));
    let page = page.unwrap();
    for finding in findings {
        let check = finding["check"].as_str().unwrap();
        let headed =
            page.lines().any(|l| l.starts_with("### ") && l.contains(&format!("`{check}`")));
        assert!(headed, "{check} is not in docs/doctor.md");
        let bad = finding["severity"] != "good";
        assert!(finding["cost"].is_string() == bad && finding["remedy"].is_string() == bad);
    }
    // A KVM that emulates kernel-mode code must not pass for one that does not.
    let of = |check: &str| findings.iter().find(|finding| finding["check"] == check);
    let takt = std::path::Path::new(env!("CARGO_BIN_EXE_takt-doctor")).with_file_name("takt");
    let Ok(probe) = Command::new(takt).arg("probe").output() else {
        assert_eq!(of("kvm").unwrap()["severity"], "unseen");
        return;
    };
    let probe = String::from_utf8(probe.stdout).unwrap();
    if probe.starts_with("KVM runs kernel-mode guest code at hardware speed") {
        assert_eq!(of("virtualisation").unwrap()["severity"], "good");
    } else if probe.starts_with("KVM emulates kernel-mode guest code") {
        let found = of("virtualisation").unwrap();
        assert_eq!(found["severity"], "cannot");
        let text = found["found"].as_str().unwrap();
        assert!(text.starts_with("KVM emulates kernel-mode guest code"), "{text}");
        assert_eq!(status, 3);
    } else {
        assert!(of("kvm").is_some_and(|finding| finding["severity"] != "good"));
    }
}

#[test]
fn people_get_a_table_without_colours_when_it_is_not_for_a_terminal() {
    let output = doctor(&["--for", "100ms"]);
    let (table, progress) =
        (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
    assert!(table.starts_with("a PLC as most are"), "{table}");
    assert!(table.contains("\n\nThis host ") && !table.contains('\x1b'), "{table}");
    assert!(progress.contains("takt-doctor: being a PLC\n") && !progress.contains('\x1b'));
}

#[test]
fn wrong_usage_and_a_wrong_file_are_no_findings() {
    for arguments in [&["--for", "3"][..], &["--for", "25000000s"], &["--no-such"], &["/no/file"]] {
        let output = doctor(arguments);
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{arguments:?}");
    }
    let help = doctor(&["--help"]);
    assert_eq!(help.status.code(), Some(0));
    let text = String::from_utf8(help.stdout).unwrap();
    assert!(text.contains("Exit status: 0 ") && text.contains("3 the host cannot"), "{text}");
}

#[test]
fn a_status_is_told_though_nothing_can_be_written() {
    let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
    for (file, expected) in [("plc-alone.toml", 3), ("no-such-file.toml", 2)] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_takt-doctor"));
        let command = command.args([&shipped(file), "--for", "10ms"]).stdout(full()).stderr(full());
        assert_eq!(command.status().unwrap().code(), Some(expected), "{file}");
    }
}

#[test]
fn a_reader_that_goes_is_told_nothing() {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut command = Command::new(env!("CARGO_BIN_EXE_takt-doctor"));
    let command = command.args([&shipped("plc-alone.toml"), "--for", "10ms"]).stdout(writer);
    let output = command.stderr(std::process::Stdio::piped()).output().unwrap();
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(141), "{told}");
    assert!(!told.contains("cannot write") && !told.contains("panicked"), "{told}");
}
