//! The programs as a user has them, with an ssh and an scp that only say what they were told.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const SHELL: &str = env!("CARGO_BIN_EXE_takt-shell");
const COPY: &str = env!("CARGO_BIN_EXE_takt-copy");
/// Two Linuxes with the key: `linux` and `other`.
const FILE: &str = "../plan/tests/partition_files/good/vsock.toml";

/// A folder with these programs, each of which prints its words and ends with 7.
fn programs(names: &[&str]) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(names.concat());
    fs::create_dir_all(&folder).unwrap();
    for name in names {
        let path = folder.join(name);
        // Of several tests at once, none may see half of it.
        let new = folder.join(format!("{name}.{:?}", std::thread::current().id()));
        let text = new.with_extension("text");
        fs::write(&text, "#!/bin/sh\nprintf '%s\\n' \"$@\"\nexit 7\n").unwrap();
        // By another process: what this one is writing, a program that another test starts at this moment has open too, and
        // the kernel executes no file that is open for writing.
        let install = Command::new("install").args(["-m", "755"]).arg(&text).arg(&new).status();
        assert!(install.unwrap().success());
        fs::rename(&new, &path).unwrap();
    }
    folder
}

fn run(program: &str, words: &[&str], path: &Path) -> Output {
    Command::new(program).args(words).env("PATH", path).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn ssh_gets_the_way_the_user_and_the_command_and_its_status_counts() {
    let path = programs(&["ssh", "scp"]);
    let words = [FILE, "other", "--user", "root", "--", "ls", "-l", "a b"];
    let output = run(SHELL, &words, &path);
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(7), "{said}{}", text(&output.stderr));
    let way = format!("-o\nProxyCommand='{SHELL}' connect 3 22\n");
    assert!(said.starts_with(&way), "{said}");
    assert!(said.ends_with("\n--\nroot@other.s.takt\nls\n-l\na b\n"), "{said}");
}

#[test]
fn scp_gets_the_same_and_the_paths_with_the_name_of_the_guest() {
    let path = programs(&["ssh", "scp"]);
    let output = run(COPY, &[FILE, "-a", "./b:c", "linux:/srv/x y"], &path);
    assert_eq!(output.status.code(), Some(2), "it is no option: {}", text(&output.stdout));
    let output = run(COPY, &[FILE, "--", "-a", "./b:c", "linux:/srv/x y"], &path);
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(7), "{said}{}", text(&output.stderr));
    let way = format!("-o\nProxyCommand='{SHELL}' connect 4294967294 22\n");
    assert!(said.starts_with(&way), "{said}");
    assert!(said.ends_with("\n-r\n--\n-a\n./b:c\nlinux.s.takt:/srv/x y\n"), "{said}");
}

#[test]
fn what_is_wrong_before_ssh_is_said_with_a_status_of_its_own() {
    let (all, none) = (programs(&["ssh", "scp"]), programs(&[]));
    for (program, words, path, status, says) in [
        (SHELL, &[FILE][..], &all, 2, "takt-shell: name the partition: "),
        (SHELL, &[FILE, "plc"], &all, 2, "those that have it: linux, other"),
        (SHELL, &["no-such.toml"], &all, 2, "no-such.toml"),
        (SHELL, &[FILE, "linux"], &none, 3, "is OpenSSH's client installed"),
        (COPY, &[FILE, "a", "b"], &all, 2, "none of these paths is in a partition"),
        (COPY, &[FILE, "a", "plc:b"], &all, 2, "for a file of this machine write ./plc:b"),
        (COPY, &[FILE, "a", "linux:b"], &none, 3, "cannot run scp"),
    ] {
        let output = run(program, words, path);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(status), "{words:?}: {said}");
        assert!(said.contains(says), "{words:?}: {said}");
    }
}

/// The number of this host itself, at which there may be sockets or not, and nothing at the largest port.
#[test]
fn a_way_that_leads_nowhere_says_so() {
    let output = run(SHELL, &["connect", "1", "4294967294"], Path::new("/"));
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{said}");
    let [no_sockets, no_guest] = ["no sockets to its guests", "cannot reach port 4294967294"];
    assert!(said.contains(no_sockets) || said.contains(no_guest), "{said}");
}

#[test]
fn the_status_is_told_though_no_message_can_be_written() {
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let status = Command::new(SHELL).arg("no-such-file.toml").stderr(full).status().unwrap();
    assert_eq!(status.code(), Some(2));
}
