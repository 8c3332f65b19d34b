//! `takt plc shadow`: a new version beside the one that runs in a PLC.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use serde_json::json;
use takt_change::make::Change;
use takt_plan::parse_duration;
use takt_points::not_asked_for;
use takt_program::Image;
use takt_protocol::{Request, Values, from_hex};
use takt_scheduler::time::Nanos;

use super::live::print;
use super::test::{failed, host};
use super::versions::find;
use super::{hex, image, read};
use crate::live::{Which, times, values};
use crate::shadow::{Comparison, Line, Output, Tolerance, Versions, Watched};
use crate::{Failure, status};

/// How long a job may take on this machine.
const JOB: Duration = Duration::from_secs(1);
/// How often it is told how far it is.
const TELL: Duration = Duration::from_secs(5);

/// Arguments of `shadow`.
#[derive(clap::Args)]
pub struct Shadow {
    #[command(flatten)]
    which: Which,
    /// The program's name in the partition file.
    program: String,
    /// The image of the new version.
    image: PathBuf,
    /// End after so long.
    #[arg(long = "for", value_name = "DURATION", value_parser = parse_duration)]
    duration: Nanos,
    /// Largest difference that an output may have: for all, or for those of a name; `*` is any text. 0 without it.
    #[arg(long = "tolerance", value_name = "[NAME=]NUMBER")]
    tolerances: Vec<Tolerance>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl Shadow {
    pub fn run(self) -> Result<(), Failure> {
        let Self { which, program, image: path, duration, tolerances, json } = self;
        let new_bytes = read(&path)?;
        let new = image(&path, &new_bytes)?;
        let plc = which.load()?;
        find(&plc, &program)?;
        let programs = (0..).zip(plc.partition().programs());
        let found = programs.filter(|(_, known)| known.name == program);
        let Some((place, running)) = found.filter_map(|(at, p)| Some((at, p.image()?))).next()
        else {
            return Err(Failure::input(format!("{program} has no image")));
        };
        let change = Change::between(&running, &new);
        if let [first, ..] = &change.refusals[..] {
            let message = format!(
                "it is no version to which {program} can change while it runs: {first}; `takt plc diff` tells all reasons"
            );
            return Err(Failure { status: status::NOT_AS_EXPECTED, message });
        }
        let points = plc.points(&[format!("{program}.*")])?;
        let mut comparison = Comparison::new(points, &tolerances)
            .map_err(|name| Failure::input(format!("no output of {program} is named `{name}`")))?;
        let both = [running, new];
        let mut versions = Versions::new(both, &change, times(&plc), JOB).map_err(host)?;
        let mut connected = plc.connect()?;
        connected.ask(&Request::Watch {
            partition: connected.name(),
            ranges: Watched::ranges(&running, place),
            interval: Nanos::ZERO,
        })?;
        let (mut first, mut left, mut told) = (None, None, Instant::now());
        while let Some(values) = values(&mut connected, left)? {
            let release_ns = values.release_ns;
            let line = line(values, &running, place)?;
            let passed = release_ns.saturating_sub(*first.get_or_insert(release_ns));
            if passed > duration.0 {
                break;
            }
            left = Some(Nanos(duration.0 - passed));
            if let Some(outputs) = versions.take(line).map_err(failed)? {
                comparison.take(&outputs);
            }
            if told.elapsed() > TELL {
                told = Instant::now();
                tell!("takt plc: {} cycles compared", versions.extent.cycles);
            }
        }
        tell(&program, json, &both, &versions, &comparison)
    }
}

fn tell(
    program: &str,
    json: bool,
    [running, new]: &[Image<'_>; 2],
    versions: &Versions<'_>,
    comparison: &Comparison,
) -> Result<(), Failure> {
    let extent = versions.extent;
    if json {
        let outputs: Vec<_> = comparison.outputs.iter().map(as_json).collect();
        let image = |image: &Image<'_>| json!({"version": image.version().to_string(), "hash": hex(&image.hash())});
        print(
            &json!({
                "program": program, "running": image(running), "new": image(new),
                "cycles": extent.cycles, "missing": extent.missing, "begun": extent.begun,
                "longest": extent.longest, "strayed": extent.strayed,
                "first_strayed": extent.first_strayed, "outputs": outputs,
            })
            .to_string(),
        )?;
    } else {
        print(&format!(
            "{}: {} runs, {} beside it for {} cycles; {} missing, begun {} times, longest stretch {} cycles",
            program,
            running.version(),
            new.version(),
            extent.cycles,
            extent.missing,
            extent.begun,
            extent.longest
        ))?;
        print(&format!(
            "  {:<32} {:>20} {:>12} {:>12} {:>12} {:>12}",
            "output", "largest difference", "at cycle", "first out", "cycles out", "stood still"
        ))?;
        for output in &comparison.outputs {
            print(&row(output))?;
        }
    }
    let worse = |message| Err(Failure { status: status::NOT_AS_EXPECTED, message });
    if let Some(cycle) = extent.first_strayed {
        return worse(format!(
            "in {} cycles, first in {cycle}, the version that runs came to something else here than in the PLC: a message, a \
                 value that was written or forced, or a preemption. What is told of the new one may have the same cause",
            extent.strayed
        ));
    }
    match extent.cycles {
        0 => worse("no two cycles followed each other, so nothing was compared".to_owned()),
        _ if comparison.is_within() => Ok(()),
        _ => worse("outputs are out of tolerance".to_owned()),
    }
}

/// What is watched of a cycle.
fn line(values: Values, running: &Image<'_>, place: u8) -> Result<Line, Failure> {
    let watched = from_hex(&values.bytes).and_then(|bytes| Watched::from_bytes(running, &bytes));
    Ok(Line {
        cycle: values.cycle,
        time_ns: values.time_ns,
        unsettled: values.unsettled >> place & 1 == 1,
        watched: watched.ok_or_else(not_asked_for)?,
    })
}

fn row(output: &Output) -> String {
    let or_dash = |cycle: Option<u64>| cycle.map_or("-".to_owned(), |cycle| cycle.to_string());
    let difference = match output.largest {
        None => "-".to_owned(),
        Some((difference, _)) if difference.is_infinite() => "differs".to_owned(),
        Some((difference, _)) => difference.to_string(),
    };
    format!(
        "  {:<32} {difference:>20} {:>12} {:>12} {:>12} {:>12}",
        output.point.name,
        or_dash(output.largest.map(|(_, cycle)| cycle)),
        or_dash(output.first_out),
        output.cycles_out,
        output.still
    )
}

fn as_json(output: &Output) -> serde_json::Value {
    // JSON has no infinity.
    let difference =
        output.largest.map(|(d, _)| if d.is_finite() { json!(d) } else { json!("differs") });
    json!({
        "name": output.point.name, "tolerance": output.tolerance, "largest": difference,
        "at_cycle": output.largest.map(|(_, cycle)| cycle), "first_out": output.first_out,
        "cycles_out": output.cycles_out, "still": output.still,
    })
}
