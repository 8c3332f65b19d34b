//! What `takt run` has left behind: its report and its samples.
//!
//! The report is also kept as it is, to be written beside the page. The files come from a run that this program need
//! not have started, so their text is taken for what anybody could have written, and their sizes have limits.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Error as _, IgnoredAny};
use takt_figures::load;
use takt_figures::report::{self, Host, Partition, Releases, Report};
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
    /// When the schedule changed last, since the epoch; `None` if it never did.
    pub last_switch_ns: Option<u64>,
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

    /// What the load of a partition has got done.
    pub fn load(&self, partition: &str) -> Option<&load::Course> {
        self.loads.iter().find(|course| course.partition == partition)
    }

    /// Those that make the load.
    pub fn linuxes(&self) -> impl Iterator<Item = &Partition> {
        self.partitions.iter().filter(|partition| partition.kind == "linux")
    }
}

/// Reads both files. The report also comes as it is.
///
/// # Errors
/// If one cannot be read, is not of this version of Takt, or is not of the run of the other.
pub fn read(report: &Path, samples: &Path) -> Result<(serde_json::Value, Figures), JitterError> {
    const REPORT: &str = "report";
    let raw: serde_json::Value = json(report, REPORT, true, report::SCHEMA_VERSION)?;
    let format = |source| JitterError::Format { path: report.to_owned(), what: REPORT, source };
    let mut parsed = Report::deserialize(&raw).map_err(format)?;
    add_releases(&raw, &mut parsed.partitions).map_err(format)?;
    let Report { lane, emulator, host, system, duration_ns, schedule, partitions, .. } = parsed;
    let Samples { partitions: mut courses, mut loads, .. } =
        json(samples, "samples file", false, samples::SCHEMA_VERSION)?;
    of_one_run(&partitions, &courses).map_err(|text| JitterError::OtherRun {
        report: report.to_owned(),
        samples: samples.to_owned(),
        text,
    })?;
    for course in &mut courses {
        // Takt writes no more; a plot of millions would be of no use to anybody.
        course.points.truncate(POINTS_MAX);
    }
    for load in &mut loads {
        load.points.truncate(load::POINTS_MAX);
    }
    let last_switch_ns = schedule.last_switch_ns;
    let figures = Figures {
        lane,
        emulator,
        host,
        system,
        duration_ns,
        last_switch_ns,
        partitions,
        courses,
        loads,
    };
    Ok((raw, figures))
}

/// Every PLC has releases. Where one of their keys is missing or wrong, [`Report`] takes the partition for one without
/// any, and no limit would hold for it.
fn add_releases(
    raw: &serde_json::Value,
    partitions: &mut [Partition],
) -> Result<(), serde_json::Error> {
    let raw = raw["partitions"].as_array().into_iter().flatten();
    for (raw, partition) in raw.zip(partitions) {
        if partition.kind == "plc" && partition.releases.is_none() {
            let named = |error| serde_json::Error::custom(format!("{}: {error}", partition.name));
            partition.releases = Some(Releases::deserialize(raw).map_err(named)?);
        }
    }
    Ok(())
}

/// Tells what speaks against it that a report and samples are of one run: both count each release, and both have the
/// latest start exactly.
fn of_one_run(partitions: &[Partition], courses: &[Course]) -> Result<(), String> {
    for Partition { name, releases, .. } in partitions {
        let Some(releases) = releases else { continue };
        let Some(course) = courses.iter().find(|course| course.name == *name) else {
            return Err(format!("the samples have no partition {name}"));
        };
        let counts = &course.latency_ns;
        let sampled = counts.iter().fold(0u64, |sum, (_, count)| sum.saturating_add(*count));
        if sampled != releases.releases {
            return Err(format!(
                "{name} has {} releases in the report and {sampled} in the samples",
                releases.releases
            ));
        }
        let reported = releases.release_latency_ns.map(|summary| summary.max);
        let sampled = counts.iter().map(|(ns, _)| *ns).max();
        if sampled != reported {
            let words = |ns: Option<u64>| ns.map_or("none".into(), |ns| format!("{ns} ns late"));
            return Err(format!(
                "the latest start of {name} is {} in the report and {} in the samples",
                words(reported),
                words(sampled)
            ));
        }
    }
    Ok(())
}

/// What a report and samples have in any version.
#[derive(Deserialize)]
struct Head {
    schema_version: u32,
    /// Only a report has it.
    lane: Option<IgnoredAny>,
}

/// Reads a file of this version. The version is looked at first: in another one anything else may be different.
fn json<T: DeserializeOwned>(
    path: &Path,
    what: &'static str,
    is_report: bool,
    known: u32,
) -> Result<T, JitterError> {
    let file = File::open(path).map_err(reading(path))?;
    let mut text = Vec::new();
    file.take(FILE_MAX + 1).read_to_end(&mut text).map_err(reading(path))?;
    if text.len() as u64 > FILE_MAX {
        return Err(JitterError::TooLarge { path: path.to_owned(), most: FILE_MAX });
    }
    let format = |source| JitterError::Format { path: path.to_owned(), what, source };
    let Head { schema_version: found, lane } = serde_json::from_slice(&text).map_err(format)?;
    // The version of a file of the other kind says nothing.
    if found != known && lane.is_some() == is_report {
        return Err(JitterError::Version { path: path.to_owned(), what, found, known });
    }
    serde_json::from_slice(&text).map_err(format)
}
