//! A table of inputs and expected outputs: CSV with one column for each point and one row for each cycle.
//!
//! The first row has the names. A column of a point of the input image, or of a part of one, sets it; any other column is an
//! expectation. `set NAME` sets a variable that is no input, `NAME +-0.01` has a tolerance. An empty cell
//! sets nothing and expects nothing; an input keeps its value. Lines that begin with `#` are comments, and so are
//! columns whose name does. Empty lines may stand before the names and at the end.

use takt_program::{Area, Image};

use crate::value::{Place, Value};

/// Of an empty line before a row.
const EMPTY_LINE: &str = "found an empty line, which is no row; a row of empty cells is written `,` (a table of one column needs \
                          another for that, which may be called #), and a line that only divides begins with #";

/// What is wrong with a table: line, column (both from 1), and what.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}, column {column}: {what}")]
pub struct TableError {
    line: usize,
    column: usize,
    what: String,
}

/// A column.
pub struct Column {
    pub name: String,
    pub place: Place,
    pub kind: Kind,
}

/// What a column is for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    Set,
    Expect { tolerance: Option<f64> },
}

/// What the cells below a name are.
enum Below {
    /// Those of a column, by its index.
    Column(usize),
    Comments,
    /// There is no name: nothing may stand there.
    Nothing,
}

/// A cell with a value, by the index of its column.
pub type Cell = (usize, Value);

/// A row: the line in the file, and its cells.
pub struct Row {
    pub line: usize,
    pub cells: Vec<Cell>,
}

/// A table whose names and values fit a program.
pub struct Table {
    pub columns: Vec<Column>,
    pub rows: Vec<Row>,
}

impl Table {
    /// Reads a table for this program.
    pub fn parse(image: &Image<'_>, text: &str) -> Result<Self, TableError> {
        let mut lines = (1..).zip(text.trim_start_matches('\u{feff}').lines());
        let is_empty = |text: &str| text.trim().is_empty();
        let is_comment = |text: &str| text.starts_with('#');
        let is_names = |line: &(usize, &str)| !is_empty(line.1) && !is_comment(line.1);
        let (line, names) = lines.find(is_names).ok_or_else(|| TableError {
            line: 1,
            column: 1,
            what: "the table is empty; its first row has the names of points".into(),
        })?;
        let mut columns = Vec::new();
        // For each cell of a row.
        let mut of_cell = Vec::new();
        for (cell, name) in cells(names) {
            of_cell.push(match name.chars().next() {
                None => Below::Nothing,
                Some('#') => Below::Comments,
                Some(_) => {
                    let error = |what| TableError { line, column: cell, what };
                    columns.push(column(image, name).map_err(error)?);
                    Below::Column(columns.len() - 1)
                }
            });
        }
        let mut rows = Vec::new();
        // In a table of one column it may be an empty cell, so it is not passed over.
        let mut empty = None;
        for (line, text) in lines.filter(|line| !is_comment(line.1)) {
            if is_empty(text) {
                empty = empty.or(Some(line));
                continue;
            }
            if let Some(line) = empty {
                return Err(TableError { line, column: 1, what: EMPTY_LINE.into() });
            }
            let mut row = Row { line, cells: Vec::new() };
            for (at, (cell, text)) in cells(text).enumerate() {
                let error = |what| TableError { line, column: cell, what };
                if text.is_empty() {
                    continue;
                }
                match of_cell.get(at) {
                    Some(Below::Column(index)) => {
                        row.cells.push((*index, columns[*index].place.parse(text).map_err(error)?));
                    }
                    Some(Below::Comments) => {}
                    Some(Below::Nothing) => {
                        return Err(error(format!("`{text}` in a column without a name")));
                    }
                    None => {
                        let names = of_cell.len();
                        return Err(error(format!(
                            "the row has more cells than the {names} names"
                        )));
                    }
                }
            }
            rows.push(row);
        }
        Ok(Self { columns, rows })
    }
}

/// The cells of a line, each with its column in the text.
fn cells(line: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut column = 1;
    line.split(',').map(move |cell| {
        let at = column;
        column += cell.chars().count() + 1;
        (at, cell.trim())
    })
}

fn column(image: &Image<'_>, text: &str) -> Result<Column, String> {
    let (name, tolerance) = match text.split_once("+-") {
        None => (text, None),
        Some((name, number)) => {
            let parsed = number
                .trim()
                .parse()
                .ok()
                .filter(|number: &f64| *number >= 0.0 && number.is_finite());
            let wrong = || format!("found `{}` after +-, which is no tolerance", number.trim());
            (name.trim(), Some(parsed.ok_or_else(wrong)?))
        }
    };
    let (name, told) = name.strip_prefix("set ").map_or((name, false), |name| (name.trim(), true));
    let place = Place::find(image, name).map_err(|error| error.to_string())?;
    let kind = match (told || place.area == Area::Input, tolerance) {
        (true, None) => Kind::Set,
        (true, Some(_)) => return Err("a value that is set has no tolerance".into()),
        (false, tolerance) => Kind::Expect { tolerance },
    };
    Ok(Column { name: name.to_owned(), place, kind })
}
