//! The tables of expected values, which the blocks in Rust and those in C both have to give.

use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

/// One file of `tests/tables`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    pub block: String,
    pub inputs: Vec<String>,
    pub outputs: Vec<String>,
    #[serde(rename = "case")]
    pub cases: Vec<Case>,
}

/// A block from its cold start, call by call.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    pub name: String,
    /// Where the expected values come from, for the reader of the table.
    #[serde(default, rename = "formula")]
    _formula: Option<String>,
    /// How far a number may be from the expected one: 0 is not at all.
    #[serde(default)]
    pub tolerance: f64,
    /// What the block is set to before the first call.
    #[serde(default)]
    pub set: BTreeMap<String, Value>,
    rows: Vec<Vec<Value>>,
}

/// A cell.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(untagged)]
pub enum Value {
    Bool(bool),
    Integer(i64),
    Real(f64),
}

/// A call of a block.
pub struct Row<'a> {
    pub elapsed: Duration,
    pub inputs: &'a [Value],
    pub outputs: &'a [Value],
}

impl Value {
    pub fn bool(self) -> bool {
        let Self::Bool(value) = self else { panic!("{self:?} is not BOOL") };
        value
    }

    pub fn integer(self) -> i64 {
        let Self::Integer(value) = self else { panic!("{self:?} is no integer") };
        value
    }

    pub fn real(self) -> f64 {
        let Self::Real(value) = self else { panic!("{self:?} is not REAL") };
        value
    }

    /// A cell in milliseconds.
    pub fn time(self) -> Duration {
        Duration::from_millis(u64::try_from(self.integer()).expect("time is not negative"))
    }

    pub fn near(self, other: Self, tolerance: f64) -> bool {
        match (self, other) {
            (Self::Real(a), Self::Real(b)) => {
                a == b || (a.is_nan() && b.is_nan()) || (a - b).abs() <= tolerance
            }
            _ => self == other,
        }
    }
}

impl From<bool> for Value {
    fn from(value: bool) -> Self {
        Self::Bool(value)
    }
}

impl From<f64> for Value {
    fn from(value: f64) -> Self {
        Self::Real(value)
    }
}

impl From<i16> for Value {
    fn from(value: i16) -> Self {
        Self::Integer(value.into())
    }
}

impl From<Duration> for Value {
    fn from(value: Duration) -> Self {
        Self::Integer(i64::try_from(value.as_millis()).expect("fits"))
    }
}

impl Case {
    pub fn rows<'a>(&'a self, table: &'a Table) -> impl Iterator<Item = Row<'a>> {
        self.rows.iter().map(|row| {
            let (elapsed, cells) = row.split_first().expect("a row has a time");
            // A transform has as many columns of each kind as values.
            let values = if table.block == "Fft" { cells.len() / 4 } else { 1 };
            let (inputs, outputs) = cells.split_at(values * table.inputs.len());
            assert_eq!(outputs.len(), values * table.outputs.len(), "{}", self.name);
            Row { elapsed: elapsed.time(), inputs, outputs }
        })
    }

    pub fn real(&self, name: &str) -> f64 {
        self.set[name].real()
    }
}

/// All tables, in the order of their names.
pub fn tables() -> Vec<(String, Table)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/tables");
    let mut tables: Vec<_> = std::fs::read_dir(folder)
        .expect("the folder of tables")
        .map(|entry| {
            let path = entry.expect("an entry").path();
            let text = std::fs::read_to_string(&path).expect("a table");
            let table = toml::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
            (path.file_stem().expect("a name").to_string_lossy().into_owned(), table)
        })
        .collect();
    tables.sort_by(|a, b| a.0.cmp(&b.0));
    tables
}
