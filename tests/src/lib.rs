//! Runs whole systems: a partition file, in the appliance, in the instruction-counted lab, or in
//! the `emulated` lane where several CPUs are needed.
//!
//! A test writes a partition file, says what is typed at the console, and looks at what a user
//! would see: the output, the exit status and the report. In the lab nothing depends on how fast
//! or how busy the machine below is, so figures may be asserted.

use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::thread;

pub use serde_json::Value;

/// Real time after which a run is given up. It is never what a test waits for.
const TIMEOUT_S: &str = "900";

/// What a run left behind.
#[derive(Debug)]
pub struct Outcome {
    /// Exit status of `scripts/run`, which is that of `takt`.
    pub status: i32,
    /// All that appeared on the console, and what the scripts said.
    pub output: String,
    /// The report.
    pub report: Value,
}

impl Outcome {
    /// The report's entry of one partition.
    #[must_use]
    pub fn partition(&self, name: &str) -> &Value {
        let partitions = self.report["partitions"].as_array();
        let found = partitions.and_then(|all| all.iter().find(|p| p["name"] == name));
        found.unwrap_or_else(|| panic!("no partition {name} in the report\n{}", self.output))
    }

    /// A number of a partition's entry, such as `releases` or `release_latency_ns.max`.
    #[must_use]
    pub fn number(&self, partition: &str, key: &str) -> u64 {
        let value = key.split('.').fold(self.partition(partition), |value, part| &value[part]);
        value.as_u64().unwrap_or_else(|| panic!("{partition}.{key} is {value}\n{}", self.output))
    }

    /// Fails with the output unless `text` is in it.
    pub fn assert_shows(&self, text: &str) {
        assert!(self.output.contains(text), "not shown: {text}\n{}", self.output);
    }

    /// A partition's part of the CPU, from 0 to 1.
    #[must_use]
    pub fn share(&self, partition: &str) -> f64 {
        self.partition(partition)["cpu_share"].as_f64().unwrap_or(-1.0)
    }

    /// Fails unless a PLC kept every release, and there were at least so many.
    pub fn assert_kept_its_time(&self, partition: &str, at_least: u64) {
        for key in ["lost", "late_releases", "overruns", "unrecorded"] {
            assert_eq!(self.number(partition, key), 0, "{key}\n{}", self.output);
        }
        let releases = self.number(partition, "releases");
        assert!(releases >= at_least, "{releases} releases\n{}", self.output);
    }
}

/// The repository.
#[must_use]
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A file below `target/`, where the scripts put the images.
#[must_use]
pub fn target(path: &str) -> PathBuf {
    root().join("target").join(path)
}

/// A folder for partition files and reports of tests.
fn scratch() -> PathBuf {
    let folder = target("tests");
    fs::create_dir_all(&folder).expect("the target folder is writable");
    folder
}

/// A guest image of the PLC's, by the name of its program.
#[must_use]
pub fn plc_image(name: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    let folder = root().join("plc-guest");
    BUILT.get_or_init(|| {
        let mut cargo = Command::new("cargo");
        cargo.args(["build", "--release", "--quiet"]).current_dir(&folder);
        // What this test's cargo tells its programs is not meant for another cargo.
        for (key, _) in
            std::env::vars().filter(|(k, _)| k.starts_with("CARGO") && k != "CARGO_HOME")
        {
            cargo.env_remove(key);
        }
        assert!(cargo.status().expect("cargo starts").success(), "the PLC guests do not build");
    });
    folder.join("target/x86_64-unknown-linux-gnu/release").join(name)
}

/// A partition file: a PLC with a window of 300 us in 1 ms, and Linux in the background.
#[derive(Clone, Debug)]
pub struct System {
    /// Image of the PLC; `None` for the built-in one.
    pub plc: Option<PathBuf>,
    /// Kernel of Linux, below `target/`.
    pub kernel: &'static str,
    /// Initial RAM disk, below `target/`.
    pub initrd: &'static str,
    /// Memory of Linux.
    pub memory: &'static str,
    /// Commands that Linux executes before it gives a shell.
    pub exec: &'static str,
}

impl Default for System {
    fn default() -> Self {
        Self {
            plc: None,
            kernel: "guest/vmlinuz",
            initrd: "guest/initrd.img",
            memory: "128MiB",
            exec: "",
        }
    }
}

impl System {
    fn toml(&self) -> String {
        let image = self.plc.as_ref().map_or(String::new(), |p| format!("image = {p:?}\n"));
        let exec = match self.exec {
            "" => String::new(),
            commands => format!(" takt.exec=\\\"{commands}\\\""),
        };
        format!(
            r#"version = 1
[system]
name = "test"
major_frame = "1ms"
[[partition]]
name = "plc"
kind = "plc"
cpu = 0
memory = "4MiB"
release_guard = "10us"
{image}
[[partition]]
name = "linux"
kind = "linux"
cpu = 0
background = true
memory = "{memory}"
kernel = {kernel:?}
initrd = {initrd:?}
cmdline = "console=ttyS0{exec}"
[[schedule]]
name = "normal"
[[schedule.window]]
partition = "plc"
offset = "0us"
duration = "300us"
"#,
            memory = self.memory,
            kernel = target(self.kernel),
            initrd = target(self.initrd),
        )
    }

    /// Runs it for a time, with nobody at the console.
    #[must_use]
    pub fn run(&self, name: &str, duration: &str) -> Outcome {
        self.run_typing(name, Some(duration), &[])
    }

    /// Runs it with somebody who types: each text after the console has shown another.
    #[must_use]
    pub fn run_typing(
        &self,
        name: &str,
        duration: Option<&str>,
        dialogue: &[(&str, &str)],
    ) -> Outcome {
        run_text(name, &self.toml(), duration, dialogue)
    }
}

/// Runs a partition file that is given as text.
#[must_use]
pub fn run_text(
    name: &str,
    text: &str,
    duration: Option<&str>,
    dialogue: &[(&str, &str)],
) -> Outcome {
    let file = scratch().join(format!("{name}.toml"));
    fs::write(&file, text).expect("the partition file can be written");
    run(&file, duration, dialogue)
}

/// Runs a partition file in the lab.
#[must_use]
pub fn run(file: &Path, duration: Option<&str>, dialogue: &[(&str, &str)]) -> Outcome {
    run_in_lane("lab", file, duration, dialogue)
}

/// Runs a partition file in a lane of `scripts/run`. Outside the lab, no time may be asserted.
#[must_use]
pub fn run_in_lane(
    lane: &str,
    file: &Path,
    duration: Option<&str>,
    dialogue: &[(&str, &str)],
) -> Outcome {
    let report = file.with_extension("json");
    let report = scratch().join(report.file_name().expect("a partition file has a name"));
    let _ = fs::remove_file(&report);
    let mut command = Command::new(root().join("scripts/run"));
    command
        .args(["--lane", lane])
        .arg(file)
        .arg("--report")
        .arg(&report)
        .env("TAKT_TIMEOUT", TIMEOUT_S);
    if let Some(duration) = duration {
        command.args(["--for", duration]);
    }
    let stdin = if dialogue.is_empty() { Stdio::null() } else { Stdio::piped() };
    let mut child = command
        .stdin(stdin)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("scripts/run starts");
    let output = converse(&mut child, dialogue);
    let status = child.wait().expect("scripts/run ends").code().unwrap_or(-1);
    let report = fs::read_to_string(&report)
        .ok()
        .and_then(|text| serde_json::from_str(&text).ok())
        .unwrap_or(Value::Null);
    Outcome { status, output, report }
}

/// Reads all output, and answers the next cue of the dialogue whenever it appears.
fn converse(child: &mut Child, dialogue: &[(&str, &str)]) -> String {
    let mut errors = child.stderr.take().expect("stderr is a pipe");
    let errors = thread::spawn(move || {
        let mut text = String::new();
        let _ = errors.read_to_string(&mut text);
        text
    });
    let mut console = child.stdout.take().expect("stdout is a pipe");
    let mut keyboard = child.stdin.take();
    let mut dialogue = dialogue.iter();
    let mut next = dialogue.next();
    let (mut seen, mut answered) = (Vec::new(), 0);
    let mut buffer = [0; 4096];
    while let Ok(read @ 1..) = console.read(&mut buffer) {
        seen.extend_from_slice(&buffer[..read]);
        while let (Some((cue, answer)), Some(keyboard)) = (next, &mut keyboard) {
            let fresh = &seen[answered..];
            let Some(at) = fresh.windows(cue.len()).position(|w| w == cue.as_bytes()) else {
                break;
            };
            answered += at + cue.len();
            keyboard.write_all(answer.as_bytes()).expect("somebody reads the keyboard");
            next = dialogue.next();
        }
    }
    let errors = errors.join().unwrap_or_default();
    String::from_utf8_lossy(&seen).into_owned() + &errors
}

/// True if tests that take long are wanted too.
#[must_use]
pub fn long() -> bool {
    std::env::var_os("TAKT_TEST_LONG").is_some()
}
