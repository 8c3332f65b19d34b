//! The command line as a user or a script meets it: statuses, streams, and that nothing starts.

#[path = "../plan/tests/fixtures/mod.rs"]
mod fixtures;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use fixtures::{FOLDER, defects};

/// Where the partition files for tests are, which messages name from there.
const PLAN: &str = "plan";

fn takt(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_takt")).args(arguments).current_dir(PLAN).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn the_service_in_the_documentation_starts_nothing_again_that_has_ended_for_good() {
    let service = fs::read_to_string("../docs/service.md").unwrap();
    // A bad file, a host that cannot, and a failed partition, which `shut-down` is.
    assert!(service.contains("\nRestartPreventExitStatus=2 3 4\n"));
}

#[test]
fn a_bad_file_gives_status_2_one_message_and_starts_nothing() {
    let root = Path::new(PLAN).join(FOLDER);
    let absolute = root.canonicalize().unwrap();
    let defects = defects(&root);
    assert!(defects.len() >= 300, "the fixtures are gone: {} left", defects.len());
    for defect in defects {
        let name = defect.path.strip_prefix(PLAN).unwrap().to_str().unwrap();
        // One fixture is about a machine of two CPUs, which this one need not be.
        if name.ends_with("cpu-that-this-machine-lacks.toml") {
            continue;
        }
        let expected = defect.message().replace("$FOLDER", absolute.to_str().unwrap());
        for command in ["run", "check"] {
            let output = takt(&[command, name]);
            assert_eq!(output.status.code(), Some(2), "{name}");
            assert_eq!(text(&output.stdout), "", "{name}");
            assert_eq!(text(&output.stderr), expected, "{name}");
        }
    }
}

#[test]
fn a_reader_that_goes_is_told_nothing() {
    let file = "tests/partition_files/good/plc-alone.toml";
    for arguments in [&["check", file][..], &["check", file, "--needs"], &["probe"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = Command::new(env!("CARGO_BIN_EXE_takt"));
        let command = command.args(arguments).current_dir(PLAN).stdout(writer);
        let output = command.stderr(std::process::Stdio::piped()).output().unwrap();
        assert_eq!((output.status.code(), text(&output.stderr)), (Some(141), String::new()));
    }
}

#[test]
fn a_good_file_is_drawn() {
    let output = takt(&["check", "tests/partition_files/good/plc-alone.toml"]);
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
    assert!(text(&output.stdout).contains("CPU 0"), "{}", text(&output.stdout));
}

/// Where RAM begins above the first MiB, if this user is shown that.
fn ram() -> Option<u64> {
    let list = fs::read_to_string("/proc/iomem").ok()?;
    let ram = list.lines().filter_map(|line| line.split_once(" : System RAM")?.0.split_once('-'));
    ram.filter_map(|(start, _)| u64::from_str_radix(start, 16).ok()).find(|start| *start > 0xf_ffff)
}

#[test]
fn memory_that_is_ram_of_this_host_is_refused_before_a_run() {
    let Some(start) = ram() else { return println!("this user is not shown where RAM is") };
    let plain = fs::read_to_string("plan/tests/partition_files/good/plc-alone.toml").unwrap();
    let memory = format!(
        "[[partition.mmio]]\nname = \"card\"\nphysical = \"{start:#x}\"\naddress = \"0xd0000000\"\nsize = \"4KiB\"\n\n[[schedule]]"
    );
    let path = std::env::temp_dir().join(format!("takt-ram-{}.toml", std::process::id()));
    fs::write(&path, plain.replace("[[schedule]]", &memory)).unwrap();
    let output = takt(&["check", path.to_str().unwrap()]);
    fs::remove_file(&path).unwrap();
    assert_eq!(output.status.code(), Some(3));
    // The file may be for another machine.
    assert!(text(&output.stdout).contains("CPU 0"), "{}", text(&output.stdout));
    assert!(text(&output.stderr).contains("RAM"), "{}", text(&output.stderr));
}

#[test]
fn wrong_usage_gives_status_2_and_says_so_on_standard_error() {
    for arguments in [
        &[][..],
        &["fly"],
        &["run"],
        &["run", "x.toml", "--for", "soon"],
        &["run", "x.toml", "--for", "-1s"],
        &["check"],
        &["check", "a.toml", "b.toml"],
    ] {
        let output = takt(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty() && output.stdout.is_empty(), "{arguments:?}");
    }
}

#[test]
fn a_status_is_told_though_nothing_can_be_written() {
    let full = || fs::File::options().write(true).open("/dev/full").unwrap();
    for (words, status) in [(["check", "none.toml"], 2), (["probe", "--json"], 3)] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_takt"));
        let command = command.args(words).stdout(full()).stderr(full());
        assert_eq!(command.status().unwrap().code(), Some(status), "{words:?}");
    }
}

#[test]
fn help_and_version_are_answers() {
    for arguments in [&["--help"][..], &["run", "--help"], &["--version"]] {
        let output = takt(arguments);
        assert_eq!((output.status.code(), output.stderr.len()), (Some(0), 0), "{arguments:?}");
    }
    let help = text(&takt(&["run", "--help"]).stdout);
    assert!(help.contains("Ctrl-] q") && help.contains("Exit status"), "{help}");
}

#[test]
fn the_probe_says_what_it_found_in_one_line() {
    let output = takt(&["probe"]);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{output:?}");
    assert_eq!(text(&output.stdout).lines().count(), 1, "{output:?}");
}

#[test]
fn the_probe_tells_programs_what_takt_doctor_reads() {
    let output = takt(&["probe", "--json"]);
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
    let told: takt_host::kvm::Examination = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(told.schema_version, takt_host::kvm::SCHEMA_VERSION);
    let opens = fs::File::options().read(true).write(true).open("/dev/kvm").is_ok();
    assert_eq!(opens, !matches!(told.kvm, takt_host::kvm::Found::Closed { .. }));
}
