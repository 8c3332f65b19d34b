//! Functions: a case is a call with its arguments in variables, row by row.

use crate::oracle::Job;
use crate::program::{CONFIGURATION, Twice, compile, tables};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    #[serde(rename = "case")]
    cases: Vec<Case>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
    /// An expression over the arguments.
    call: String,
    /// The types that stand for T, one after the other.
    #[serde(default = "no_types")]
    types: Vec<String>,
    /// Names and types.
    arguments: BTreeMap<String, String>,
    result: String,
    /// How far a real result may be from the expected one.
    tolerance: Option<String>,
    /// Literals: the arguments in the order of their names, then the result.
    rows: Vec<Vec<String>>,
}

fn no_types() -> Vec<String> {
    vec![String::new()]
}

/// A function that returns the number of the first row whose result is wrong, or 0.
fn function(source: &mut String, number: usize, case: &Case, stand_in: &str) {
    let ty = |name: &String| if name == "T" { stand_in.to_owned() } else { name.clone() };
    writeln!(source, "FUNCTION Case_{number} : DINT\nVAR").unwrap();
    for (name, argument) in &case.arguments {
        writeln!(source, "    {name} : {};", ty(argument)).unwrap();
    }
    let result = ty(&case.result);
    writeln!(source, "    found : {result};\n    expected : {result};\nEND_VAR").unwrap();
    for (row, values) in case.rows.iter().enumerate() {
        assert_eq!(values.len(), case.arguments.len() + 1, "{}, row {}", case.call, row + 1);
        for (name, value) in case.arguments.keys().zip(values) {
            writeln!(source, "{name} := {value};").unwrap();
        }
        let expected = &values[case.arguments.len()];
        writeln!(source, "expected := {expected};\nfound := {};", case.call).unwrap();
        let wrong = match &case.tolerance {
            Some(tolerance) => format!("NOT (ABS(found - expected) <= {tolerance})"),
            None => "found <> expected".to_owned(),
        };
        writeln!(
            source,
            "IF Case_{number} = 0 AND {wrong} THEN Case_{number} := {}; END_IF;",
            row + 1
        )
        .unwrap();
    }
    source.push_str("END_FUNCTION\n");
}

fn check(name: &str) {
    let (_, text) = tables("tests/standard")
        .into_iter()
        .find(|(table, _)| table == name)
        .unwrap_or_else(|| panic!("no table {name}"));
    let table: Table = toml::from_str(&text).unwrap_or_else(|error| panic!("{name}: {error}"));
    let cases: Vec<(&Case, &String)> =
        table.cases.iter().flat_map(|case| case.types.iter().map(move |ty| (case, ty))).collect();
    let mut source = String::new();
    for (number, (case, stand_in)) in cases.iter().enumerate() {
        function(&mut source, number, case, stand_in);
    }
    let last = cases.len() - 1;
    writeln!(source, "PROGRAM Main VAR wrong AT %MD0 : ARRAY[0..{last}] OF DINT; END_VAR").unwrap();
    for number in 0..cases.len() {
        writeln!(source, "wrong[{number}] := Case_{number}();").unwrap();
    }
    source.push_str("END_PROGRAM\n");
    source.push_str(CONFIGURATION);

    let program = compile(name, &source);
    let mut machine = Twice::start(&program);
    machine.run(Job::default());
    let mut failures = String::new();
    for (number, (case, stand_in)) in cases.iter().enumerate() {
        let row = machine.marker(number);
        if row != 0 {
            let values = &case.rows[row as usize - 1];
            writeln!(failures, "{} {stand_in}: row {row}, {values:?}", case.call).unwrap();
        }
    }
    assert!(failures.is_empty(), "{name}:\n{failures}");
}

#[test]
fn numeric() {
    check("numeric");
}

#[test]
fn bits() {
    check("bits");
}

#[test]
fn selection() {
    check("selection");
}

#[test]
fn comparison() {
    check("comparison");
}

#[test]
fn strings() {
    check("strings");
}

#[test]
fn conversion() {
    check("conversion");
}

#[test]
fn number_text() {
    check("number_text");
}

#[test]
fn calendar() {
    check("calendar");
}

#[test]
fn character() {
    check("character");
}

#[test]
fn encoding() {
    check("encoding");
}

#[test]
fn time_text() {
    check("time_text");
}
