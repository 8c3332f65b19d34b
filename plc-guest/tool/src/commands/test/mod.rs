//! `takt plc test`: the tests of a project in Structured Text, or an image against a table.

mod junit;
mod report;
mod shown;
mod table;
mod units;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::structured_text::{Good, Messages, Origin, is_text};
use super::{image, read, spare, write};
use crate::run::{Failed, HostError, Logged};
use crate::{Failure, status};
use report::{Case, Outcome, Report};

/// Arguments of `test`.
#[derive(clap::Args)]
pub struct Test {
    /// A project in Structured Text, or its files and folders, whose TEST blocks run, and of a project its tables
    /// too; without any, the project in the current folder. Or an image, and a table (CSV): one column for each
    /// point, one row for each cycle. Columns of inputs set them, all others are expected.
    inputs: Vec<PathBuf>,
    #[command(flatten)]
    options: Options,
    /// Run only the tests whose names have this text in them.
    #[arg(long, value_name = "TEXT")]
    filter: Option<String>,
    /// Write a report in JUnit's XML too.
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    #[command(flatten)]
    messages: Messages,
}

/// How programs are run.
#[derive(clap::Args)]
struct Options {
    /// Of an image without a table: how many cycles to run.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    cycles: u64,
    /// Simulated time of a row in microseconds, if not the shortest period of the cyclic tasks.
    #[arg(long, value_name = "MICROSECONDS", value_parser = clap::value_parser!(u64).range(1..=3_600_000_000))]
    step: Option<u64>,
    /// The longest that a job may run on this machine, in milliseconds.
    #[arg(long, value_name = "MILLISECONDS", default_value_t = 1000)]
    time_limit: u64,
    /// Print no log lines of the program.
    #[arg(long)]
    quiet: bool,
}

impl Options {
    fn limit(&self) -> Duration {
        Duration::from_millis(self.time_limit)
    }

    fn say(&self, logged: &[Logged]) {
        if !self.quiet {
            for Logged { task, now, line } in logged {
                println!("[{} {task}] {line}", takt_program::Nanoseconds(*now));
            }
        }
    }
}

impl Test {
    pub fn run(self) -> Result<(), Failure> {
        match &self.inputs[..] {
            [file, rest @ ..] if !is_text(file) => {
                if rest.len() > 1 || self.filter.is_some() {
                    return Err(Failure::input(
                        "an image is tested with one table and no --filter",
                    ));
                }
                self.image(file, rest.first())
            }
            inputs => self.project(&Origin::of(inputs, &self.messages)?),
        }
    }

    /// An image, with a table or without.
    fn image(&self, file: &PathBuf, table: Option<&PathBuf>) -> Result<(), Failure> {
        let inputs = table.into_iter().chain([file]);
        self.spare(inputs.map(PathBuf::as_path))?;
        let bytes = read(file)?;
        let image = image(file, &bytes)?;
        let begin = Instant::now();
        let result = table::run(image, table, &self.options);
        let outcome = match &result {
            Ok(_) => Outcome::Passed,
            Err(failure) if failure.status == status::NOT_AS_EXPECTED => {
                Outcome::Failed(failure.message.clone())
            }
            Err(failure) => Outcome::Broken(failure.message.clone()),
        };
        let name = table.unwrap_or(file).display().to_string();
        let case = Case { name, place: None, outcome, took: begin.elapsed() };
        let mut report = Report::new(image.name());
        report.cases.push(case);
        self.write_junit(&report)?;
        println!("{}", result?);
        Ok(())
    }

    /// All tests of a project.
    fn project(&self, origin: &Origin) -> Result<(), Failure> {
        let good = self.messages.tests("test", origin)?;
        let tables = match origin.project() {
            Some(project) => project.tables().map_err(Failure::input)?,
            None => Vec::new(),
        };
        let previous = origin.project().and_then(|project| project.previous.as_ref());
        let mut kept = good.files(origin);
        kept.extend(tables.iter().chain(previous).cloned());
        self.spare(kept.iter().map(PathBuf::as_path))?;
        let wanted =
            |name: &str| self.filter.as_ref().is_none_or(|filter| name.contains(filter.as_str()));
        let mut report = Report::new(&good.program.name);
        units::run(&good, &self.messages, &self.options, &wanted, &mut report)?;
        let tables: Vec<PathBuf> =
            tables.into_iter().filter(|table| wanted(&table.display().to_string())).collect();
        if !tables.is_empty() {
            // Without the tests: what is tested with tables is what will be loaded.
            let good = self.messages.program("test", origin)?;
            let bytes = self.messages.build(&good)?.image;
            let image = image(&PathBuf::from(&good.program.name), &bytes)?;
            for table in tables {
                let begin = Instant::now();
                let outcome = match table::run(image, Some(&table), &self.options) {
                    Ok(_) => Outcome::Passed,
                    Err(failure) if failure.status == status::NOT_AS_EXPECTED => {
                        Outcome::Failed(failure.message)
                    }
                    Err(failure) if failure.status == status::HOST_CANNOT => return Err(failure),
                    Err(failure) => Outcome::Broken(failure.message),
                };
                let name = table.display().to_string();
                report.add(Case { name, place: None, outcome, took: begin.elapsed() });
            }
        }
        self.write_junit(&report)?;
        report.end(self.filter.as_deref())
    }

    /// Refuses a report that would replace what is tested.
    fn spare<'p>(&self, inputs: impl Iterator<Item = &'p Path>) -> Result<(), Failure> {
        self.junit.as_ref().map_or(Ok(()), |report| spare(report, inputs))
    }

    fn write_junit(&self, report: &Report) -> Result<(), Failure> {
        match &self.junit {
            Some(path) => write(path, junit::xml(report).as_bytes()),
            None => Ok(()),
        }
    }
}

pub fn host(error: HostError) -> Failure {
    let message = format!("cannot run a program on this machine: {error}");
    Failure { status: status::HOST_CANNOT, message }
}

pub fn failed(failed: Failed) -> Failure {
    match failed {
        Failed::Host(error) => host(error),
        Failed::Program(fault) => {
            Failure { status: status::PROGRAM_FAILED, message: fault.to_string() }
        }
    }
}
