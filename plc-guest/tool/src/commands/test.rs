//! `takt plc test`: a program against a table.

use std::path::PathBuf;
use std::time::Duration;

use takt_program::{Image, Nanoseconds};

use super::{image, read};
use crate::run::{Failed, Machine, Schedule};
use crate::table::{Kind, Row, Table};
use crate::{Failure, status};

/// Arguments of `test`.
#[derive(clap::Args)]
pub struct Test {
    /// The image.
    image: PathBuf,
    /// The table (CSV): one column for each point, one row for each cycle. Columns of inputs set them, all
    /// others are expected.
    table: Option<PathBuf>,
    /// Without a table: how many cycles to run.
    #[arg(long, conflicts_with = "table", default_value_t = 1)]
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

/// Mismatches that are told one by one.
const TOLD: usize = 20;

impl Test {
    pub fn run(self) -> Result<(), Failure> {
        let bytes = read(&self.image)?;
        let image = image(&self.image, &bytes)?;
        let table = self.table(&image)?;
        let mut schedule = Schedule::new(&image);
        let step =
            self.step.map(|us| us * 1000).or(schedule.shortest_period()).ok_or_else(|| {
                Failure::input("the program has no cyclic task: say how long a row is with --step")
            })?;
        let limit = Duration::from_millis(self.time_limit);
        let mut machine = Machine::new(image, limit).map_err(host)?;
        let lines = machine.init().map_err(failed)?;
        lines.iter().for_each(|line| self.say("init", 0, line));
        let mut wrong = Vec::new();
        for row in &table.rows {
            set(&table, row, &machine);
            let logged = schedule.step(&mut machine, step).map_err(failed)?;
            logged.iter().for_each(|logged| self.say(&logged.task, logged.now, &logged.line));
            compare(&table, row, &machine, &mut wrong);
        }
        let (cycles, time) = (table.rows.len(), Nanoseconds(schedule.now()));
        if wrong.is_empty() {
            println!(
                "{}: {cycles} cycles, {time} of simulated time, all as expected",
                image.name()
            );
            return Ok(());
        }
        let count = wrong.len();
        wrong.truncate(TOLD);
        if count > TOLD {
            wrong.push(format!("and {} more", count - TOLD));
        }
        let message = format!("{count} values are not as expected:\n  {}", wrong.join("\n  "));
        Err(Failure { status: status::NOT_AS_EXPECTED, message })
    }

    /// The table, or one with empty rows.
    fn table(&self, image: &Image<'_>) -> Result<Table, Failure> {
        let Some(path) = &self.table else {
            let rows = (0..self.cycles).map(|_| Row { line: 0, cells: Vec::new() }).collect();
            return Ok(Table { columns: Vec::new(), rows });
        };
        let text = String::from_utf8(read(path)?)
            .map_err(|_| Failure::input(format!("{} is not UTF-8", path.display())))?;
        Table::parse(image, &text)
            .map_err(|error| Failure::input(format!("{}, {error}", path.display())))
    }

    fn say(&self, task: &str, now: u64, line: &str) {
        if !self.quiet {
            println!("[{} {task}] {line}", Nanoseconds(now));
        }
    }
}

fn set(table: &Table, row: &Row, machine: &Machine<'_>) {
    for (index, value) in &row.cells {
        let column = &table.columns[*index];
        if column.kind == Kind::Set {
            column.place.put(machine, *value);
        }
    }
}

fn compare(table: &Table, row: &Row, machine: &Machine<'_>, wrong: &mut Vec<String>) {
    for (index, want) in &row.cells {
        let column = &table.columns[*index];
        let Kind::Expect { tolerance } = column.kind else { continue };
        let Some(found) = column.place.get(machine) else { continue };
        if !want.accepts(found, tolerance) {
            let give = tolerance.map_or(String::new(), |tolerance| format!(" +-{tolerance}"));
            wrong.push(format!(
                "line {}: {} is {found}, expected {want}{give}",
                row.line, column.name
            ));
        }
    }
}

fn host(error: crate::run::HostError) -> Failure {
    let message = format!("cannot run a program on this machine: {error}");
    Failure { status: status::HOST_CANNOT, message }
}

fn failed(failed: Failed) -> Failure {
    match failed {
        Failed::Host(error) => host(error),
        Failed::Program(fault) => {
            Failure { status: status::PROGRAM_FAILED, message: fault.to_string() }
        }
    }
}
