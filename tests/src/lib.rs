//! Runs whole systems: a partition file, in the appliance, in the instruction-counted lab, or in
//! the `emulated` lane where several CPUs or real time are needed.
//!
//! A test writes a partition file, says what is typed at the console, and looks at what a user
//! would see: the output, the exit status and the report. In the lab nothing depends on how fast
//! or how busy the machine below is, so figures may be asserted.

mod dialogue;
mod file;
mod host;
mod initrd;
mod kernel;
pub mod random;
pub mod record;
pub mod trusted_lines;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use dialogue::converse;
pub use file::{BUSY, File, SOON, System};
pub use host::Host;
pub use initrd::{archive, initrd_and, initrd_of, initrd_with};
pub use kernel::{
    Aim, aiming_kernel, deaf_kernel, erring_kernel, restarting_kernel, silent_kernel,
    switching_kernel,
};
pub use serde_json::Value;

/// For `TAKT_TIMEOUT`: after how much real time, in seconds, a run is given up. It is at least this much, a quarter of an hour, and
/// an hour in the long form. It is never what a test waits for.
#[must_use]
pub fn timeout_s(at_least: u32) -> String {
    at_least.max(if long() { 3_600 } else { 900 }).to_string()
}

/// How many lines of a failed run come before all of it.
const LAST_LINES: usize = 20;

/// Longest time in ns that an interrupt of the host takes from a guest in the lab, and then some:
/// 5 us have been seen.
const INTERRUPT_NS: u64 = 10_000;

/// Starts that are no later than this are not among the late ones of a report.
const UNTOLD_NS: u64 = 10;

/// What a run left behind.
#[derive(Debug)]
pub struct Outcome {
    /// Exit status of `scripts/run`, which is that of `takt`.
    pub status: i32,
    /// All that appeared on the console, and what the scripts said.
    pub output: String,
    /// The report; null if there is none.
    pub report: Value,
    /// The trace's events; null if there is none.
    pub trace: Value,
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

    /// Fails with the output unless `text` is in it, if need be with lines of others in its middle.
    pub fn assert_shows(&self, text: &str) {
        let shown = dialogue::end_of(text, self.output.as_bytes()).is_some();
        assert!(shown, "not shown: {text}\n{}", self.output);
    }

    /// A partition's part of the CPU, from 0 to 1.
    #[must_use]
    pub fn share(&self, partition: &str) -> f64 {
        self.partition(partition)["cpu_share"].as_f64().unwrap_or(-1.0)
    }

    /// A background partition's part of the time that the windows left.
    #[must_use]
    pub fn received(&self, partition: &str) -> f64 {
        let of = |key| self.number(partition, key) as f64;
        of("donation.received_ns") / of("donation.offered_ns")
    }

    /// Latest less earliest start after a release, in ns.
    #[must_use]
    pub fn jitter_ns(&self, partition: &str) -> u64 {
        let of = |key| self.number(partition, key);
        of("release_latency_ns.max") - of("release_latency_ns.min")
    }

    /// Whether Takt ran on a kernel whose version begins like this: some bounds are those of one kernel's paths.
    #[must_use]
    pub fn is_on_kernel(&self, version: &str) -> bool {
        self.report["host"]["kernel"].as_str().is_some_and(|kernel| kernel.starts_with(version))
    }

    /// Fails unless a PLC started each scan within 10 ns of its release, but for those that an
    /// interrupt of the host fell onto.
    ///
    /// With one CPU the host's tick and Linux's timers go off there, 250 times a second each, and
    /// they creep along the frames, because the kernel measures the TSC's frequency only to some
    /// millionths. Whether they meet a release during a run depends on when it began.
    pub fn assert_punctual(&self, partition: &str) {
        let of = |key| self.number(partition, key);
        assert!(of("release_latency_ns.p50") <= 10, "{partition}\n{}", self.output);
        let latest = of("release_latency_ns.max");
        assert!(latest <= INTERRUPT_NS, "{partition}: {latest}\n{}", self.output);
        let late = self.partition(partition)["late_starts"].as_array();
        let causes: Vec<&Value> = late.into_iter().flatten().map(|start| &start["cause"]).collect();
        let explained = causes.iter().all(|cause| **cause == "host_interrupt");
        assert!(
            explained && (latest <= UNTOLD_NS || !causes.is_empty()),
            "{partition}: {causes:?}"
        );
    }

    /// Fails unless a PLC started each scan within 10 ns of its release, whatever interrupted the host.
    pub fn assert_exact(&self, partition: &str) {
        let latest = self.number(partition, "release_latency_ns.max");
        let late = &self.partition(partition)["late_starts"];
        assert!(latest <= UNTOLD_NS, "{partition}: {latest} ns, {late:#}\n{}", self.output);
    }

    /// Releases that a partition with this period, in us, has in such a run. It had a few less if it ended its
    /// start-up after the epoch.
    #[must_use]
    pub fn cycles(&self, period_us: u64) -> u64 {
        let duration_ns = self.report["duration_ns"].as_u64().unwrap_or(0);
        assert!(duration_ns > 0, "no report\n{}", self.output);
        duration_ns / 1_000 / period_us
    }

    /// Fails unless a Linux of [`File::compiling_linux`] has compiled until the end.
    pub fn assert_compiled(&self) {
        assert!(!self.output.contains("takt-load: compile failed"), "{}", self.output);
        // 171 objects beside a small PLC, in the minute of the long form.
        let at_least = if long() { 40 } else { 1 };
        let objects = self.compiled();
        assert!(objects >= at_least, "Linux has compiled {objects} objects\n{}", self.output);
        self.assert_loaded_until_the_end("compile");
    }

    /// Objects that a Linux of [`File::compiling_linux`] has compiled.
    #[must_use]
    pub fn compiled(&self) -> u64 {
        self.done("compile").into_iter().max().unwrap_or(0)
    }

    /// Fails unless a load of Linux went on in its last 10 s, or since it began, and no kernel stood still.
    pub fn assert_loaded_until_the_end(&self, load: &str) {
        // A load tells twice a second what it has done.
        const LINES: usize = 20;
        let done = self.done(load);
        let last = &done[done.len().saturating_sub(LINES + 1)..];
        // The last line may be half written.
        assert!(last.first() < last.iter().max(), "{load}: {last:?}\n{}", self.output);
        for partition in self.report["partitions"].as_array().into_iter().flatten() {
            assert!(partition["stuck"].is_null(), "{partition:#}\n{}", self.output);
        }
    }

    /// What a load of Linux said again and again that it had done.
    fn done(&self, load: &str) -> Vec<u64> {
        let before = format!("takt-load: {load} ");
        let told = |line: &str| -> Option<u64> {
            line.split_once(&before)?.1.split(' ').next()?.parse().ok()
        };
        self.output.lines().filter_map(told).collect()
    }

    /// Fails unless a PLC kept every release, and there were at least so many.
    pub fn assert_kept_its_time(&self, partition: &str, at_least: u64) {
        for key in ["lost", "late_releases", "overruns", "unrecorded"] {
            assert_eq!(self.number(partition, key), 0, "{key}\n{}", self.output);
        }
        let releases = self.number(partition, "releases");
        assert!(releases >= at_least, "{releases} releases\n{}", self.output);
    }

    /// Fails unless Takt had no more descriptors at the end than at the start, and no more memory but
    /// `figures`: what those of the report need on their way. Distributions take more the longer their
    /// values are, 80 KiB each for values of a second.
    pub fn assert_not_grown(&self, figures: u64) {
        let of = |when: &str, what: &str| self.report["process"][when][what].as_u64();
        assert!(of("start", "descriptors").is_some(), "{}", self.report["process"]);
        assert!(
            of("end", "descriptors") <= of("start", "descriptors"),
            "{}",
            self.report["process"]
        );
        let grown = of("end", "anonymous_bytes").zip(of("start", "anonymous_bytes"));
        let grown = grown.map(|(end, start)| end.saturating_sub(start));
        assert!(grown.is_some_and(|bytes| bytes < figures), "{grown:?}");
    }
}

/// The repository.
#[must_use]
pub fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// A file below `target/`, where the scripts put the images: with `TAKT_SUITE`, below that suite's
/// folder there.
#[must_use]
pub fn target(path: &str) -> PathBuf {
    let suite = std::env::var_os("TAKT_SUITE").unwrap_or_default();
    root().join("target").join(suite).join(path)
}

/// A folder for partition files and reports of tests.
fn scratch() -> PathBuf {
    let folder = target("tests");
    fs::create_dir_all(&folder).expect("the target folder is writable");
    folder
}

/// Writes a file for tests; returns its path.
#[must_use]
pub fn save_bytes(name: &str, bytes: &[u8]) -> PathBuf {
    let path = scratch().join(name);
    fs::write(&path, bytes).expect("the target folder is writable");
    path.canonicalize().expect("the file is there")
}

/// A guest image of the PLC's, by the name of its program.
#[must_use]
pub fn plc_image(name: &str) -> PathBuf {
    static BUILT: OnceLock<()> = OnceLock::new();
    let folder = root().join("plc-guest");
    BUILT.get_or_init(|| {
        let mut cargo = Command::new("cargo");
        cargo.args(["build", "--workspace", "--release", "--quiet"]).current_dir(&folder);
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

/// A run of a partition file. In the lab, unless another lane is named; outside it, no time may be
/// asserted.
#[derive(Clone, Debug)]
pub struct Run<'a> {
    verb: Option<&'a str>,
    file: PathBuf,
    lane: &'a str,
    options: Vec<&'a str>,
    dialogue: Vec<(&'a str, &'a str)>,
    traced: bool,
    /// See [`timeout_s`].
    least_timeout_s: u32,
}

impl<'a> Run<'a> {
    /// Of a file of the repository.
    #[must_use]
    pub fn of(file: &str) -> Self {
        let file = root().join(file);
        Self {
            verb: None,
            file,
            lane: "lab",
            options: Vec::new(),
            dialogue: Vec::new(),
            traced: false,
            least_timeout_s: 0,
        }
    }

    /// Of a partition file that is written for the test of this name.
    #[must_use]
    pub fn of_text(name: &str, text: &str) -> Self {
        let file = scratch().join(format!("{name}.toml"));
        fs::write(&file, text).expect("the partition file can be written");
        Self { file, ..Self::of("") }
    }

    /// Ends after this time, if not before.
    #[must_use]
    pub fn lasting(mut self, duration: &'a str) -> Self {
        self.options.extend(["--for", duration]);
        self
    }

    /// In another lane.
    #[must_use]
    pub fn in_lane(self, lane: &'a str) -> Self {
        Self { lane, ..self }
    }

    /// With another option for `scripts/run`.
    #[must_use]
    pub fn with(mut self, option: &'a str) -> Self {
        self.options.push(option);
        self
    }

    /// With an option that only Takt with the hooks of tests has, without its dashes.
    #[must_use]
    pub fn hooked(self, option: &'a str) -> Self {
        self.with("--hook").with(option)
    }

    /// Not given up before so much real time, in seconds; see [`timeout_s`].
    #[must_use]
    pub fn given_up_after(self, least_timeout_s: u32) -> Self {
        Self { least_timeout_s, ..self }
    }

    /// As `scripts/run jitter`.
    #[must_use]
    pub fn for_jitter(self) -> Self {
        Self { verb: Some("jitter"), ..self }
    }

    /// With a trace.
    #[must_use]
    pub fn traced(self) -> Self {
        Self { traced: true, ..self }
    }

    /// With somebody who types: each text after the console has shown another.
    #[must_use]
    pub fn typing(mut self, dialogue: &[(&'a str, &'a str)]) -> Self {
        self.dialogue.extend(dialogue);
        self
    }

    /// Ended by its user when the console has shown this text. How long a Linux takes to get there differs
    /// from one kernel to the next. It must not be in its command line, which the kernel shows.
    #[must_use]
    pub fn until(self, text: &'a str) -> Self {
        self.typing(&[(text, "\x1dq")])
    }

    /// Runs it.
    #[must_use]
    pub fn run(&self) -> Outcome {
        let name = self.file.file_stem().expect("a partition file has a name").to_owned();
        let output_file = |kind: &str| {
            let mut name = name.clone();
            name.push(kind);
            let path = scratch().join(name);
            let _ = fs::remove_file(&path);
            path
        };
        let (report, trace) = (output_file(".json"), output_file(".trace.json"));
        let mut command = Command::new(root().join("scripts/run"));
        command
            .args(self.verb)
            .args(["--lane", self.lane])
            .arg(&self.file)
            .arg("--report")
            .arg(&report);
        if self.traced {
            command.arg("--trace").arg(&trace);
        }
        command.args(&self.options).env("TAKT_TIMEOUT", timeout_s(self.least_timeout_s));
        built(&mut command);
        let stdin = if self.dialogue.is_empty() { Stdio::null() } else { Stdio::piped() };
        let mut child = command
            .stdin(stdin)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("scripts/run starts");
        let output = converse(&mut child, &self.dialogue);
        let status = child.wait().expect("scripts/run ends").code().unwrap_or(-1);
        say_end("scripts/run", status, &output);
        BUILT.store(true, Ordering::Relaxed);
        Outcome { status, output, report: read_json(&report), trace: read_json(&trace) }
    }
}

/// Says how a run ended. The test runner shows it before the message of a failed assertion, whose text is
/// all of the output: a reader that cuts the text finds the status and the last lines here.
fn say_end(script: &str, status: i32, output: &str) {
    let lines: Vec<&str> = output.lines().collect();
    let last = &lines[lines.len().saturating_sub(LAST_LINES)..];
    println!("{script} has ended with {status}; its last lines:\n{}\n", last.join("\n"));
}

/// Whether a script has run to its end, which has built what there is to build, or has failed for that.
static BUILT: AtomicBool = AtomicBool::new(false);

/// Tells a script that all is built already: to find that out takes a second for each run.
fn built(script: &mut Command) {
    if BUILT.load(Ordering::Relaxed) {
        script.env("TAKT_BUILT", "yes");
    }
}

/// What a text in JSON says; null if it is none.
#[must_use]
pub fn parse(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or(Value::Null)
}

fn read_json(path: &Path) -> Value {
    fs::read_to_string(path).map_or(Value::Null, |text| parse(&text))
}

/// True if tests that take long are wanted too.
#[must_use]
pub fn long() -> bool {
    std::env::var_os("TAKT_TEST_LONG").is_some()
}
