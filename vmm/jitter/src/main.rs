//! `takt-jitter`: runs a partition file under a load, and shows how punctual its releases were.
//!
//! It has two halves. The first starts `takt run` beside it and waits; the second draws what that has
//! left behind. `takt-jitter render` is the second alone: in the appliance only `takt` runs, and its
//! figures are drawn outside.
//!
//! It is a program of its own because a drawing library is nothing that the process which keeps
//! partitions apart should contain.

mod axis;
mod cause;
mod command;
mod distribution;
mod error;
mod figures;
mod gate;
mod guard;
mod load;
mod measure;
mod measurement;
mod output;
mod page;
mod plot;
mod proof;
mod terminal;

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use takt_plan as config;
use takt_scheduler::time::Nanos;

use error::JitterError;
use figures::Figures;
use gate::Limits;
use load::Load;
use measurement::{Manner, Measurement};
use output::Kept;

/// Exit statuses beside those of `takt run`; `--help` tells them.
mod status {
    pub const USAGE: u8 = 2;
    pub const HOST_CANNOT: u8 = 3;
    pub const GATE_CLOSED: u8 = 5;
}

const AFTER_HELP: &str = "\
Exit status: 0 good; 2 bad partition file or usage; 3 the host cannot; 4 a partition failed;
5 a limit (--max-...) is exceeded, or one is given and the load is not proved, a partition was not
there all the time, the schedule has changed, or the run was ended before the time of --for.
Ctrl-C ends the measurement; what was measured until then is shown.";

/// Measures how punctual the releases of a partition file are under a load.
#[derive(Parser)]
#[command(name = "takt-jitter", version, after_help = AFTER_HELP)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Cli {
    #[command(subcommand)]
    render: Option<Half>,
    #[command(flatten)]
    run: Run,
}

#[derive(Subcommand)]
enum Half {
    /// Draw what a `takt run --report --samples` has left behind.
    Render(Render),
}

#[derive(Args)]
struct Run {
    // Missing only where `render` is asked for.
    /// The partition file.
    #[arg(required = true)]
    file: Option<PathBuf>,
    /// Measure for this time, such as 60s; otherwise until Ctrl-C.
    #[arg(long = "for", value_name = "DURATION", value_parser = nanos)]
    duration: Option<Nanos>,
    /// What the Linux guest does meanwhile.
    #[arg(long, value_enum, default_value_t = Load::None)]
    load: Load,
    /// Also leave takt's own report here.
    #[arg(long, value_name = "OUT.json")]
    report: Option<PathBuf>,
    #[command(flatten)]
    rest: Common,
    /// Options for `takt run`, behind `--`.
    #[arg(last = true, value_name = "OPTION")]
    takt: Vec<String>,
}

#[derive(Args)]
struct Render {
    /// The report.
    #[arg(long, value_name = "REPORT.json")]
    report: PathBuf,
    /// The samples.
    #[arg(long, value_name = "SAMPLES.json")]
    samples: PathBuf,
    // What these say is also in a report that this program has left.
    /// The command that has measured, for the page; otherwise that of the report.
    #[arg(long, value_name = "TEXT")]
    command: Option<String>,
    /// What the Linux guest was to do meanwhile; otherwise that of the report.
    #[arg(long, value_enum)]
    load: Option<Load>,
    /// How long the run was to last, such as 60s; otherwise that of the report.
    #[arg(long = "for", value_name = "DURATION", value_parser = nanos)]
    duration: Option<Nanos>,
    #[command(flatten)]
    rest: Common,
}

#[derive(Args)]
struct Common {
    /// Write report.html, report.json and samples.json into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Fail if a release was later than this, such as 5us.
    #[arg(long, value_name = "DURATION", value_parser = nanos)]
    max_latency: Option<Nanos>,
    /// Fail if more releases than this came later than the guard can absorb.
    #[arg(long, value_name = "N")]
    max_late: Option<u64>,
    /// Fail if more releases than this never happened; 0 if only other limits are given.
    #[arg(long, value_name = "N")]
    max_lost: Option<u64>,
}

impl Common {
    fn limits(&self) -> Limits {
        Limits { latency: self.max_latency, late: self.max_late, lost: self.max_lost }
    }
}

fn nanos(text: &str) -> Result<Nanos, String> {
    config::parse_duration(text).map_err(|e| e.to_string())
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(answer) => {
            let status = if answer.use_stderr() { status::USAGE } else { 0 };
            let _ = answer.print();
            return ExitCode::from(status);
        }
    };
    let outcome = match (cli.render, &cli.run.file) {
        (Some(Half::Render(render)), _) => self::render(&render),
        (None, Some(file)) => run(file, &cli.run),
        // clap asks for one of them.
        (None, None) => Ok(status::USAGE),
    };
    ExitCode::from(outcome.unwrap_or_else(|error| {
        // Without a reader, the status still tells.
        let _ = writeln!(io::stderr(), "takt-jitter: {}", terminal::plain(&error.to_string()));
        status::HOST_CANNOT
    }))
}

fn run(file: &Path, run: &Run) -> Result<u8, JitterError> {
    let folder = measure::Folder::new()?;
    let report = run.report.clone().unwrap_or_else(|| folder.path("report.json"));
    let samples = folder.path("samples.json");
    let measured = measure::run(&measure::Order {
        file,
        duration: run.duration,
        load: run.load,
        report: &report,
        samples: &samples,
        more: &run.takt,
    })?;
    if !measured.has_figures() {
        return Ok(measured.status);
    }
    let command = command::line(std::env::args_os());
    let manner = Manner { command, load: run.load, asked: run.duration };
    let gate = show(&run.rest, figures::read(&report, &samples)?, &samples, manner)?;
    Ok(if measured.status == 0 { gate } else { measured.status })
}

fn render(render: &Render) -> Result<u8, JitterError> {
    let Render { report, samples, .. } = render;
    let (raw, figures) = figures::read(report, samples)?;
    let kept = Kept::of(&raw, report)?;
    let load = render.load.or(kept.as_ref().map(|kept| kept.load));
    let asked = render.duration.or(kept.as_ref().and_then(|kept| kept.asked_ns.map(Nanos)));
    let command = render.command.clone().or(kept.map(|kept| kept.command));
    let manner = Manner {
        command: command.unwrap_or_else(|| "not known".into()),
        load: load.unwrap_or(Load::None),
        asked,
    };
    show(&render.rest, (raw, figures), samples, manner)
}

/// Shows a measurement, and tells the exit status that follows from its limits.
fn show(
    common: &Common,
    (raw, figures): (serde_json::Value, Figures),
    samples: &Path,
    manner: Manner,
) -> Result<u8, JitterError> {
    let measurement = Measurement::new(figures, manner, common.limits());
    let text = terminal::text(&measurement);
    // An error is ignored: without a reader, the status and the files still tell.
    let _ = io::stdout().write_all(text.as_bytes());
    if let Some(folder) = &common.out {
        output::write(folder, &measurement, raw, samples)?;
        let _ = writeln!(io::stdout(), "\n{}", folder.join(output::PAGE).display());
    }
    Ok(if measurement.breaches.is_empty() { 0 } else { status::GATE_CLOSED })
}
