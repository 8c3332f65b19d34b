//! A program against a table.

use std::iter::repeat;
use std::path::{Path, PathBuf};

use takt_program::{Area, Image, Nanoseconds};

use super::{Options, failed, host, read};
use crate::run::{Failed, Logged, Machine, Schedule};
use crate::table::{Cell, Column, Kind, Row, Table};
use crate::{Failure, status};

/// Mismatches that are told one by one.
const TOLD: usize = 20;

/// Runs the program with a table, or for some cycles without one. Gives what to say if all is as expected.
pub fn run(image: Image<'_>, path: Option<&PathBuf>, options: &Options) -> Result<String, Failure> {
    let table = match path {
        Some(path) => read_table(&image, path)?,
        None => Table { columns: Vec::new(), rows: Vec::new() },
    };
    // Those without a table are only counted: there may be as many as one has time for.
    let empty = Row { line: 0, cells: Vec::new() };
    let cycles = if path.is_some() { table.rows.len() as u64 } else { options.cycles };
    let rows = table.rows.iter().chain(repeat(&empty)).take(cycles as usize);
    let mut schedule = Schedule::new(&image);
    let step =
        options.step.map(|us| us * 1000).or(schedule.shortest_period()).ok_or_else(|| {
            Failure::input("the program has no cyclic task: say how long a row is with --step")
        })?;
    let mut machine = Machine::new(image, options.limit()).map_err(host)?;
    // As in the guest, `init` finds the inputs as they are.
    if let Some(row) = table.rows.first() {
        set(&table, row, &machine, |column| column.place.area == Area::Input);
    }
    // Also of a job that ends in a fault: its lines may say why.
    let said = |ran: Result<(), Failed>, logged: Vec<Logged>| {
        options.say(&logged);
        ran.map_err(failed)
    };
    let mut logged = Vec::new();
    said(machine.init(&mut logged), logged)?;
    let mut wrong = Vec::new();
    for row in rows {
        set(&table, row, &machine, |_| true);
        let mut logged = Vec::new();
        said(schedule.step(&mut machine, step, &mut logged), logged)?;
        compare(&table, row, &machine, &mut wrong);
    }
    let time = Nanoseconds(schedule.now());
    // Behind the run: a table may be there to show a fault, which has ended this by now.
    if let Some(path) = path.filter(|_| !expects(&table)) {
        let message =
            format!("{} expects nothing: no column that is compared has a value", path.display());
        return Err(Failure::input(message));
    }
    if wrong.is_empty() {
        let name = image.name();
        return Ok(format!("{name}: {cycles} cycles, {time} of simulated time, all as expected"));
    }
    let count = wrong.len();
    wrong.truncate(TOLD);
    if count > TOLD {
        wrong.push(format!("and {} more", count - TOLD));
    }
    let message = format!("{count} values are not as expected:\n  {}", wrong.join("\n  "));
    Err(Failure { status: status::NOT_AS_EXPECTED, message })
}

fn read_table(image: &Image<'_>, path: &Path) -> Result<Table, Failure> {
    let text = String::from_utf8(read(path)?)
        .map_err(|_| Failure::input(format!("{} is not UTF-8", path.display())))?;
    let table = Table::parse(image, &text)
        .map_err(|error| Failure::input(format!("{}, {error}", path.display())))?;
    if table.rows.is_empty() {
        return Err(Failure::input(format!(
            "{} has no row: nothing would be tested",
            path.display()
        )));
    }
    Ok(table)
}

/// Whether any value of a table is expected. One that only sets inputs shows no more than that nothing faults.
fn expects(table: &Table) -> bool {
    let expected = |cell: &Cell| matches!(table.columns[cell.0].kind, Kind::Expect { .. });
    table.rows.iter().flat_map(|row| &row.cells).any(expected)
}

fn set(table: &Table, row: &Row, machine: &Machine<'_>, which: impl Fn(&Column) -> bool) {
    for (index, value) in &row.cells {
        let column = &table.columns[*index];
        if column.kind == Kind::Set && which(column) {
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
