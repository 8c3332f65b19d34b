//! What is left in the folder: the page for people, the report and the samples for programs.

use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use takt_figures::load::Course;

use crate::error::{JitterError, writing};
use crate::gate::Breach;
use crate::load::Load;
use crate::measurement::{Manner, Measurement};
use crate::page;
use crate::proof::Proof;

/// The page's name in the folder.
pub const PAGE: &str = "report.html";
/// Version of what this program adds to the report; grows with every change that a reader could
/// stumble over.
const SCHEMA_VERSION: u32 = 2;

/// What is added to Takt's report, under the key `jitter`.
#[derive(Serialize)]
struct Addition<'a> {
    schema_version: u32,
    command: &'a str,
    load: Load,
    asked_ns: Option<u64>,
    progress: Option<&'a Course>,
    proof: Option<&'a Proof>,
    max_latency_ns: Option<u64>,
    max_late: Option<u64>,
    max_lost: Option<u64>,
    breaches: &'a [Breach],
}

/// What a report that is drawn again has of that.
#[derive(Debug, Deserialize)]
pub struct Kept {
    /// The command that has measured.
    pub command: String,
    /// What Linux was to do.
    pub load: Load,
    /// How long it was to last, if that is known.
    pub asked_ns: Option<u64>,
}

impl Kept {
    /// Of a report from this file; `None` if this program has added nothing to it.
    ///
    /// # Errors
    /// If it has not what this program adds.
    pub fn of(report: &Value, path: &Path) -> Result<Option<Self>, JitterError> {
        let format = |source| JitterError::Format { path: path.to_owned(), what: "report", source };
        report.get("jitter").map(Self::deserialize).transpose().map_err(format)
    }
}

/// Writes everything. `report` is Takt's report as it is, `samples` the file with the samples.
///
/// # Errors
/// If the folder cannot be made or written to.
pub fn write(
    folder: &Path,
    measurement: &Measurement,
    report: Value,
    samples: &Path,
) -> Result<(), JitterError> {
    fs::create_dir_all(folder).map_err(writing(folder))?;
    let put = |name: &str, text: &[u8]| {
        let path = folder.join(name);
        fs::write(&path, text).map_err(writing(&path))
    };
    put(PAGE, page::html(measurement)?.as_bytes())?;
    put("report.json", &with_addition(report, measurement)?)?;
    // Read first: it may be the file that is written.
    let samples = fs::read(samples).map_err(crate::error::reading(samples))?;
    put("samples.json", &samples)
}

fn with_addition(mut report: Value, measurement: &Measurement) -> Result<Vec<u8>, JitterError> {
    let Measurement { manner, proof, limits, breaches, .. } = measurement;
    let Manner { command, load, asked } = manner;
    let addition = Addition {
        schema_version: SCHEMA_VERSION,
        command,
        load: *load,
        asked_ns: asked.map(|ns| ns.0),
        progress: measurement.progress(),
        proof: proof.as_ref(),
        max_latency_ns: limits.latency.map(|ns| ns.0),
        max_late: limits.late,
        max_lost: limits.lost,
        breaches,
    };
    let failed = |source| JitterError::Format { path: PAGE.into(), what: "report", source };
    let addition = serde_json::to_value(addition).map_err(failed)?;
    if let Value::Object(report) = &mut report {
        report.insert("jitter".into(), addition);
    }
    let mut text = serde_json::to_vec_pretty(&report).map_err(failed)?;
    text.push(b'\n');
    Ok(text)
}
