//! Shell scripts on the appliance's kernel, beside takt: for what has to be done to takt, or without
//! it.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;

use crate::dialogue::converse;
use crate::{BUILT, Outcome, Value, built, read_json, root, say_end, scratch, timeout_s};

/// A script of `tests/host`, and what it needs.
#[derive(Debug)]
pub struct Host(Command);

impl Host {
    /// A machine for a script. What it is to have is told by [`with`](Self::with).
    #[must_use]
    pub fn new() -> Self {
        let mut command = Command::new(root().join("scripts/host"));
        command.env("TAKT_TIMEOUT", timeout_s(0));
        Self(command)
    }

    /// With an option of `scripts/host`.
    #[must_use]
    pub fn with(mut self, option: &str, value: &str) -> Self {
        self.0.args([option, value]);
        self
    }

    /// With Takt as it is built with the hooks of tests.
    #[must_use]
    pub fn hooked(mut self) -> Self {
        self.0.arg("--hooks");
        self
    }

    /// On a processor that says that it can divide its cache and the way to memory.
    #[must_use]
    pub fn allocating(mut self) -> Self {
        self.0.arg("--allocation");
        self
    }

    /// Not given up before so much real time, in seconds; see [`timeout_s`].
    #[must_use]
    pub fn given_up_after(mut self, least_timeout_s: u32) -> Self {
        self.0.env("TAKT_TIMEOUT", timeout_s(least_timeout_s));
        self
    }

    /// With a file at the path that it has here.
    #[must_use]
    pub fn with_file(mut self, path: &Path) -> Self {
        self.0.arg("--file").arg(path);
        self
    }

    /// Runs a script of `tests/host`. What it leaves as `/out/report.json` is the report.
    #[must_use]
    pub fn run(self, script: &str, arguments: &[&str]) -> Outcome {
        self.run_as(script, script, arguments)
    }

    /// The same for one of several tests with this script: what it leaves is under the test's own name.
    #[must_use]
    pub fn run_as(self, name: &str, script: &str, arguments: &[&str]) -> Outcome {
        let out = scratch().join(format!("{name}.out"));
        let report = out.join("report.json");
        let _ = fs::remove_file(&report);
        let outcome = self.leaving(&out, script, arguments);
        Outcome { report: read_json(&report), ..outcome }
    }

    /// Runs one partition file after the other, each for this time: cheaper than a machine for each.
    #[must_use]
    pub fn run_each(self, name: &str, duration: &str, files: &[PathBuf]) -> Vec<Outcome> {
        let lines: Vec<String> =
            files.iter().map(|file| format!("{} {duration}", file.display())).collect();
        self.run_list(name, "run-each", &lines, files)
    }

    /// The same, each for its own time, in a machine with all that they name.
    #[must_use]
    pub fn run_all(name: &str, runs: &[(PathBuf, &str)]) -> Vec<Outcome> {
        let (mut needed, mut memory) = (BTreeSet::new(), 0);
        for (file, _) in runs {
            for need in needs_of(file) {
                match need.split_once(' ') {
                    Some(("file", path)) => _ = needed.insert(PathBuf::from(path)),
                    Some(("memory", bytes)) => memory = memory.max(bytes.parse().unwrap_or(0)),
                    _ => {}
                }
            }
        }
        // Beside the guests: what a report needs, and the files of the runs.
        let mebibytes = (memory >> 20_u64) + 64;
        let host = Self::new().with("--memory", &mebibytes.to_string());
        let host = needed.iter().fold(host, |host, path| host.with_file(path));
        let files: Vec<PathBuf> = runs.iter().map(|(file, _)| file.clone()).collect();
        let lines: Vec<String> =
            runs.iter().map(|(file, time)| format!("{} {time}", file.display())).collect();
        host.run_list(name, "run-each", &lines, &files)
    }

    /// Lets a script of `tests/host` run the partition files, with a line of its list for each. The list is called `name`,
    /// which no other test uses.
    #[must_use]
    pub fn run_list(
        self,
        name: &str,
        script: &str,
        lines: &[String],
        files: &[PathBuf],
    ) -> Vec<Outcome> {
        let out = scratch().join(format!("{name}.out"));
        let _ = fs::remove_dir_all(&out);
        let list = scratch().join(format!("{name}.list"));
        let lines: String = lines.iter().map(|line| format!("{line}\n")).collect();
        fs::write(&list, lines).expect("the list can be written");
        let list = list.canonicalize().expect("the list is there");
        let host = files.iter().fold(self.with_file(&list), |host, file| host.with_file(file));
        let list = list.to_string_lossy();
        let machine = host.leaving(&out, script, &[&*list]);
        assert_eq!(machine.status, 0, "{}", machine.output);
        let outcome = |file: &PathBuf| {
            let left = |kind| out.join(file.file_name().unwrap_or_default()).with_extension(kind);
            let read = |kind| fs::read_to_string(left(kind)).unwrap_or_default();
            Outcome {
                status: read("status").trim().parse().unwrap_or(-1),
                // What the scripts said names the emulator.
                output: read("console") + &machine.output,
                report: read_json(&left("json")),
                trace: Value::Null,
            }
        };
        files.iter().map(outcome).collect()
    }

    /// Runs a script of `tests/host`, with what it leaves in `/out` to be put into `out`.
    fn leaving(mut self, out: &Path, script: &str, arguments: &[&str]) -> Outcome {
        self.0.arg("--out").arg(out);
        self.0.arg(root().join("tests/host").join(script)).args(arguments);
        self.0.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        built(&mut self.0);
        let mut child = self.0.spawn().expect("scripts/host starts");
        let output = converse(&mut child, &[]);
        let status = child.wait().expect("scripts/host ends").code().unwrap_or(-1);
        say_end("scripts/host", status, &output);
        BUILT.store(true, Ordering::Relaxed);
        Outcome { status, output, report: Value::Null, trace: Value::Null }
    }
}

/// What a partition file needs of a machine, as `takt check --needs` says it to the scripts.
fn needs_of(file: &Path) -> Vec<String> {
    let mut check = Command::new("cargo");
    check.args(["run", "--release", "--quiet", "--bin", "takt", "--", "check", "--needs"]);
    let output = check.arg(file).current_dir(root()).output().expect("cargo starts");
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {told}{errors}", file.display());
    told.lines().map(str::to_owned).collect()
}

impl Default for Host {
    fn default() -> Self {
        Self::new()
    }
}
