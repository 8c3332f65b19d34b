//! What `takt run` has left behind: its report and its samples.
//!
//! The report is also kept as it is, to be written beside the page. The files come from a run that this program need
//! not have started, so their text is taken for what anybody could have written, and their sizes have limits.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::Deserialize as _;
use serde::de::DeserializeOwned;
use takt_figures::load;
use takt_figures::report::{self, Host, Partition, Report};
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

    /// Those that make the load.
    pub fn linuxes(&self) -> impl Iterator<Item = &Partition> {
        self.partitions.iter().filter(|partition| partition.kind == "linux")
    }
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
