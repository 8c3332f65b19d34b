//! `takt-doctor`: can this host keep the promises of a partition file?
//!
//! A partitioning hypervisor on KVM is as punctual as the host below it, and a host has some dozens
//! of settings that each cost microseconds and show nowhere until a release is late. This program
//! looks at them and measures the rest. It never changes the host, so it may be started on the host of
//! a plant at any time, though not beside a running `takt`: what it measures on the PLC's CPU takes
//! as much of that CPU as a PLC does.
//!
//! It is no part of `takt`, because nothing of it is needed to run partitions.

mod checks;
mod demand;
mod examination;
mod finding;
mod host;
mod measure;
mod progress;
#[cfg(test)]
mod recorded;
mod report;
mod steering;

use std::io::{self, ErrorKind, IsTerminal, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use takt_plan as config;

use demand::Demand;
use finding::Severity;
use host::Host;
use progress::Progress;
use report::Report;

/// Exit statuses; `--help` tells them. 0, 2 and 3 mean what they mean for `takt`.
mod status {
    pub const GOOD: u8 = 0;
    pub const WARNINGS: u8 = 1;
    pub const BAD_FILE_OR_USAGE: u8 = 2;
    pub const HOST_CANNOT: u8 = 3;
    /// What a shell tells of a process that the signal SIGPIPE ended.
    pub const READER_GONE: u8 = 128 + 13;
}

const AFTER_HELP: &str = "\
Exit status: 0 all is good; 1 warnings, or something that could not be seen; 2 bad partition file or
usage; 3 the host cannot keep a promise.
Nothing is changed. Do not measure beside a running takt: both would want the same CPU.";

/// Says whether this host can keep the promises of a partition file.
#[derive(Parser)]
#[command(name = "takt-doctor", version, after_help = AFTER_HELP)]
struct Cli {
    /// The partition file; without one: a PLC with 300 us in each ms, on the CPU that suits it best.
    file: Option<PathBuf>,
    /// Print one JSON object on one line (schema 1, see docs/doctor.md).
    #[arg(long)]
    json: bool,
    /// How long to measure, such as 3s or 500ms; otherwise 3s, and longer where periods are longer than 96ms.
    #[arg(long = "for", value_name = "DURATION", value_parser = duration)]
    duration: Option<Duration>,
}

fn duration(text: &str) -> Result<Duration, String> {
    let longest = Duration::from_secs(24 * 3600);
    match config::parse_duration(text) {
        Ok(ns) if Duration::from_nanos(ns.0) > longest => Err("at most a day".into()),
        Ok(ns) => Ok(Duration::from_nanos(ns.0)),
        Err(error) => Err(error.to_string()),
    }
}

fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(answer) => {
            let status = if answer.use_stderr() { status::BAD_FILE_OR_USAGE } else { status::GOOD };
            let _ = answer.print();
            return ExitCode::from(status);
        }
    };
    let host = Host::here();
    let demand = match &cli.file {
        None => Demand::usual(&host),
        // A CPU that is missing here is a finding, not a defect of the file.
        Some(path) => match config::load(path, None) {
            Ok(file) => Demand::of(&file),
            Err(error) => {
                let _ = writeln!(io::stderr(), "{error}");
                return ExitCode::from(status::BAD_FILE_OR_USAGE);
            }
        },
    };
    let mut findings = checks::all(&host, &demand);
    let duration = cli.duration.unwrap_or_else(|| measure::usual_duration(&demand));
    findings.extend(measure::all(&host, &demand, duration, &Progress::new()));
    let report = Report::new(&host, &demand, findings);
    let text = if cli.json { report.json() } else { report.table(columns()) };
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Ok(()) => {}
        // As in `takt doctor | head`.
        Err(error) if error.kind() == ErrorKind::BrokenPipe => {
            return ExitCode::from(status::READER_GONE);
        }
        Err(error) => {
            let _ = writeln!(io::stderr(), "takt-doctor: cannot write the report: {error}");
            return ExitCode::from(status::HOST_CANNOT);
        }
    }
    ExitCode::from(match report.verdict() {
        Severity::Good => status::GOOD,
        Severity::Unseen | Severity::Warning => status::WARNINGS,
        Severity::Cannot => status::HOST_CANNOT,
    })
}

/// Width of the terminal; `None` if standard output is none. One that does not tell, as a serial
/// line, counts as 80 columns.
fn columns() -> Option<usize> {
    if !io::stdout().is_terminal() {
        return None;
    }
    // SAFETY: an all-zero winsize is a valid one; the kernel writes within the live structure.
    let size = unsafe {
        let mut size: libc::winsize = std::mem::zeroed();
        libc::ioctl(libc::STDOUT_FILENO, libc::TIOCGWINSZ, &raw mut size);
        size
    };
    Some(if size.ws_col == 0 { 80 } else { size.ws_col.into() })
}
