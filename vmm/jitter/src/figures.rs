//! What `takt run` has left behind: its report and its samples.
//!
//! Of the report only what is shown is looked at; all of it is kept as it is, to be written beside
//! the page. The files come from a run that this program need not have started, so their text is
//! taken for what anybody could have written, and their sizes have limits.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use takt_figures::load;
use takt_figures::report::{self, Stuck, Summary};
use takt_figures::samples::{self, Course, POINTS_MAX, Samples};

use crate::error::{JitterError, reading};

/// Largest file that is read. The samples of 32 partitions have 10 MB at most.
const FILE_MAX: u64 = 64 << 20;

/// All that is shown.
#[derive(Debug, Default)]
pub struct Figures {
    /// How Takt was run.
    pub lane: String,
    /// What emulates the machine, if it is emulated.
    pub emulator: Option<String>,
    /// Where.
    pub host: Host,
    /// Name of the system.
    pub system: String,
    /// From the epoch to the end of the run.
    pub duration_ns: u64,
    /// In the order of the partition file.
    pub partitions: Vec<Partition>,
    /// Of partitions with releases, by their names.
    pub courses: Vec<Course>,
    /// What loads have got done.
    pub loads: Vec<load::Course>,
}

impl Figures {
    /// The course of a partition.
    pub fn course(&self, partition: &Partition) -> Option<&Course> {
        self.courses.iter().find(|course| course.name == partition.name)
    }

    /// The Linux that makes the load; a system has one at most.
    pub fn linux(&self) -> Option<&Partition> {
        self.partitions.iter().find(|partition| partition.kind == "linux")
    }
}

/// The part of the report that is shown.
#[derive(Debug, Deserialize)]
struct Report {
    schema_version: u32,
    lane: String,
    emulator: Option<String>,
    host: Host,
    system: String,
    duration_ns: u64,
    partitions: Vec<Partition>,
}

/// The machine below Takt.
#[derive(Debug, Default, Deserialize)]
pub struct Host {
    /// Kernel release.
    pub kernel: String,
    /// True for a PREEMPT_RT kernel.
    pub preempt_rt: bool,
    /// Processor.
    pub cpu: String,
    /// Frequency of the time-stamp counter.
    pub tsc_khz: u32,
}

/// One partition.
#[derive(Debug, Default, Deserialize)]
pub struct Partition {
    /// Its name.
    pub name: String,
    /// `plc` or `linux`.
    pub kind: String,
    /// How it ended.
    pub end: String,
    /// CPU time of its thread, as a part of the run's duration.
    pub cpu_share: f64,
    /// Only for partitions with windows and a scan.
    #[serde(flatten)]
    pub releases: Option<Releases>,
    /// Only for a background partition.
    pub donation: Option<Donation>,
    /// Only for a Linux that has got so far.
    pub boot_to_init_ns: Option<u64>,
    /// Only for a Linux whose kernel did nothing any more.
    pub stuck: Option<Stuck>,
}

/// How a partition kept its time; `takt_figures::report::Releases` tells what each figure is.
#[derive(Debug, Default, Deserialize)]
pub struct Releases {
    pub releases: u64,
    pub start_up_windows: u64,
    pub lost: u64,
    pub late_releases: u64,
    pub overruns: u64,
    pub unrecorded: u64,
    pub release_latency_ns: Option<Summary>,
    pub execution_ns: Option<Summary>,
    pub wake_up_latency_ns: Option<Summary>,
    pub entry_ns: Option<Summary>,
    pub exit_ns: Option<Summary>,
    pub late_starts: Vec<LateStart>,
    pub longest_scans: Vec<LongScan>,
}

/// A release that started late; as `takt_figures::worst::LateStart`.
#[derive(Debug, Deserialize)]
pub struct LateStart {
    pub release: u64,
    pub at_ns: u64,
    pub latency_ns: u64,
    pub parts: Vec<Part>,
}

/// A scan that took long; as `takt_figures::worst::LongScan`.
#[derive(Debug, Deserialize)]
pub struct LongScan {
    pub release: u64,
    pub at_ns: u64,
    pub execution_ns: u64,
    pub finished: bool,
    pub usual_ns: u64,
    pub parts: Vec<Part>,
}

/// A cause, and how much it explains.
#[derive(Debug, Deserialize)]
pub struct Part {
    /// Its name.
    pub cause: String,
    /// How much.
    pub explains_ns: u64,
    /// How often the guest was left, if that is the cause.
    pub exits: Option<u64>,
}

/// What a background partition was left, and what it got of that.
#[derive(Debug, Deserialize)]
pub struct Donation {
    /// Time that nobody with a window used.
    pub offered_ns: u64,
    /// What of it was used.
    pub received_ns: u64,
    /// The share of the CPU that is its own in any case.
    pub minimum_share: f64,
}

/// Reads both files. The report also comes as it is.
///
/// # Errors
/// If one cannot be read, or is not of this version of Takt.
pub fn read(report: &Path, samples: &Path) -> Result<(serde_json::Value, Figures), JitterError> {
    const REPORT: &str = "report";
    let raw: serde_json::Value = json(report, REPORT)?;
    let format = |source| JitterError::Format { path: report.to_owned(), what: REPORT, source };
    let parsed = Report::deserialize(&raw).map_err(format)?;
    check_version(report, REPORT, parsed.schema_version, report::SCHEMA_VERSION)?;
    let Samples { schema_version, partitions: mut courses, mut loads } =
        json(samples, "samples file")?;
    check_version(samples, "samples file", schema_version, samples::SCHEMA_VERSION)?;
    for course in &mut courses {
        // Takt writes no more; a plot of millions would be of no use to anybody.
        course.points.truncate(POINTS_MAX);
    }
    for load in &mut loads {
        load.points.truncate(load::POINTS_MAX);
    }
    let Report { lane, emulator, host, system, duration_ns, partitions, .. } = parsed;
    Ok((raw, Figures { lane, emulator, host, system, duration_ns, partitions, courses, loads }))
}

fn check_version(
    path: &Path,
    what: &'static str,
    found: u32,
    known: u32,
) -> Result<(), JitterError> {
    if found == known {
        return Ok(());
    }
    Err(JitterError::Version { path: path.to_owned(), what, found, known })
}

fn json<T: DeserializeOwned>(path: &Path, what: &'static str) -> Result<T, JitterError> {
    let file = File::open(path).map_err(reading(path))?;
    let mut text = Vec::new();
    file.take(FILE_MAX + 1).read_to_end(&mut text).map_err(reading(path))?;
    if text.len() as u64 > FILE_MAX {
        return Err(JitterError::TooLarge { path: path.to_owned(), most: FILE_MAX });
    }
    serde_json::from_slice(&text).map_err(|source| JitterError::Format {
        path: path.to_owned(),
        what,
        source,
    })
}
