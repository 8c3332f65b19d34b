//! A folder outside of the repository, and programs run in it.
#![allow(dead_code, reason = "not every test file needs all of it")]

use std::fs;
use std::io::Write;
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;

use serde_json::{Value, json};

/// How a program ended, and all that it said.
pub struct Ended {
    pub status: i32,
    pub text: String,
}

impl Ended {
    #[track_caller]
    pub fn expect(self, status: i32, says: &str) -> Self {
        assert_eq!(self.status, status, "{}", self.text);
        assert!(self.text.contains(says), "expected: {says}\nfound: {}", self.text);
        self
    }
}

/// An empty folder.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    /// One with a program, `main.st`, and its tests, `t.st`.
    pub fn with_tests(main: &str, tests: &str) -> Self {
        let folder = Self::new();
        folder.write("main.st", main);
        folder.write("t.st", tests);
        folder
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path().join(name);
        fs::write(&path, text).unwrap();
        path
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path().join(name)).unwrap()
    }

    /// `takt plc` with these words.
    pub fn takt_plc(&self, words: &[&str]) -> Ended {
        run(Command::new(env!("CARGO_BIN_EXE_takt-plc")).args(words).current_dir(self.path()))
    }

    /// `takt plc` with these words and a Takt at the socket `s` that gives one answer.
    pub fn with_takt(&self, answer: &Value, words: &[&str]) -> Ended {
        let _ = fs::remove_file(self.path().join("s"));
        let listener = UnixListener::bind(self.path().join("s")).unwrap();
        let line = format!("{answer}\n");
        let takt = thread::spawn(move || {
            let (mut stream, _) = listener.accept().unwrap();
            stream.write_all(line.as_bytes()).unwrap();
            stream
        });
        let ended = self.takt_plc(words);
        drop(takt.join().unwrap());
        ended
    }

    /// `takt plc` with these words and this `PATH`.
    pub fn takt_plc_with(&self, path: &Path, words: &[&str]) -> Ended {
        let mut command = Command::new(env!("CARGO_BIN_EXE_takt-plc"));
        run(command.args(words).current_dir(self.path()).env("PATH", path))
    }

    /// `takt plc` with these words, in a folder of this one.
    pub fn takt_plc_in(&self, folder: &str, words: &[&str]) -> Ended {
        let folder = self.path().join(folder);
        run(Command::new(env!("CARGO_BIN_EXE_takt-plc")).args(words).current_dir(folder))
    }

    /// Another program, which finds `takt` as users have it in their path.
    pub fn run(&self, program: &str, words: &[&str]) -> Ended {
        let text = concat!("#!/bin/sh\nshift\nexec ", env!("CARGO_BIN_EXE_takt-plc"), " \"$@\"\n");
        let (source, takt) = (self.write("takt.sh", text), self.path().join("takt"));
        // By another process: what this one is writing, a program that another test starts at this moment has open too, and
        // the kernel executes no file that is open for writing.
        let mut install = Command::new("install");
        assert_eq!(run(install.args(["-m", "755"]).arg(source).arg(&takt)).status, 0);
        let mut command = Command::new(program);
        // What cargo has told this test is about the repository.
        for (name, _) in std::env::vars_os() {
            let text = name.to_string_lossy();
            if text.starts_with("CARGO_") && text != "CARGO_HOME" || text.contains("RUSTFLAGS") {
                command.env_remove(name);
            }
        }
        command.env("TAKT", &takt).env_remove("MAKEFLAGS");
        run(command.args(words).current_dir(self.path()))
    }

    /// Compiles and links a C program with the SDK; gives how linking ended. The image is NAME.plc.
    pub fn c_program(&self, name: &str, source: &str) -> Ended {
        self.c_program_with(name, source, &[])
    }

    pub fn c_program_with(&self, name: &str, source: &str, flags: &[&str]) -> Ended {
        let sdk = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sdk/c");
        let include = format!("-I{}", sdk.display());
        let source = self.write(&format!("{name}.c"), source);
        let runtime = sdk.join("takt.c");
        for (from, to) in [(source.as_path(), name), (&runtime, "takt")] {
            let object = format!("{to}.o");
            let file = from.file_name().unwrap().to_str().unwrap();
            let from = if to == "takt" { from.to_str().unwrap() } else { file };
            let mut words =
                vec!["-O1", "-g", "-std=c11", "-ffreestanding", "-fno-pie", "-fno-builtin"];
            words.extend(["-fno-stack-protector", "-Wall", "-Wextra", "-Werror", &include]);
            words.extend(flags);
            words.extend(["-c", from, "-o", &object]);
            self.run("gcc", &words).expect(0, "");
        }
        let (object, image) = (format!("{name}.o"), format!("{name}.plc"));
        self.takt_plc(&["build", &object, "takt.o", "-o", &image])
    }
}

/// Takt's answer to `status`, of a partition `plc` with a program of this name and hash.
pub fn status_of(program: &str, hash: &str) -> Value {
    let program = json!({"name": program, "state": "running", "image": hash, "tasks": []});
    let partition = json!({
        "name": "plc", "kind": "plc", "cpu": 0, "background": false, "state": "running",
        "start_mode": "cold", "end": null, "restarts": 0, "cpu_time_ns": 0, "cpu_share": 0.0,
        "illegal_accesses": 0, "console_dropped": 0, "releases": null, "programs": [program],
    });
    let schedule = json!({
        "names": ["normal"], "current": "normal", "next": "normal", "last_switch_ns": null,
        "windows": [], "windows_left_out": 0,
    });
    let status = json!({
        "takt": "0", "pid": 1, "system": "s", "file": "plant.toml", "uptime_ns": 0,
        "major_frame_ns": 1_000_000, "schedule": schedule, "partitions": [partition], "channels": [],
    });
    json!({"version": 2, "answer": "status", "status": status})
}

fn run(command: &mut Command) -> Ended {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let mut text = String::from_utf8_lossy(&output.stdout).into_owned();
    text.push_str(&String::from_utf8_lossy(&output.stderr));
    Ended { status: output.status.code().unwrap_or(-1), text }
}
