//! Function blocks: the tables of `takt-blocks`, one release of the task for each row.

use crate::oracle::Job;
use crate::program::{CONFIGURATION, Twice, compile, tables};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use toml::Value;

#[derive(Deserialize)]
struct Table {
    block: String,
    #[serde(rename = "case")]
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    name: String,
    #[serde(default)]
    tolerance: f64,
    #[serde(default)]
    set: BTreeMap<String, Value>,
    rows: Vec<Vec<Value>>,
}

/// How a block is written in ST.
struct InSt {
    /// The function block, or none for a function.
    block: Option<&'static str>,
    /// The call, with `{0}` and so on for the inputs, `{b}` for the instance and `{set}` for the parameters.
    call: &'static str,
    /// The outputs; `out` is the variable that a function's result is assigned to.
    outputs: &'static [&'static str],
    /// The parameters that are named otherwise than in upper case.
    renamed: &'static [(&'static str, &'static str)],
}

const fn block(name: &'static str, call: &'static str, outputs: &'static [&'static str]) -> InSt {
    InSt { block: Some(name), call, outputs, renamed: &[] }
}

fn in_st(name: &str) -> Option<InSt> {
    const TIMER: &str = "{b}(IN := {0}, PT := {1});";
    const FILTER: &str = "{b}(IN := {0}{set});";
    Some(match name {
        "Ton" => block("TON", TIMER, &["{b}.Q", "{b}.ET"]),
        "Tof" => block("TOF", TIMER, &["{b}.Q", "{b}.ET"]),
        "Tp" => block("TP", TIMER, &["{b}.Q", "{b}.ET"]),
        "Ctu" => block("CTU", "{b}(CU := {0}, R := {1}, PV := {2});", &["{b}.Q", "{b}.CV"]),
        "Ctd" => block("CTD", "{b}(CD := {0}, LD := {1}, PV := {2});", &["{b}.Q", "{b}.CV"]),
        "Ctud" => block(
            "CTUD",
            "{b}(CU := {0}, CD := {1}, R := {2}, LD := {3}, PV := {4});",
            &["{b}.QU", "{b}.QD", "{b}.CV"],
        ),
        "Sr" => block("SR", "{b}(S1 := {0}, R := {1});", &["{b}.Q1"]),
        "Rs" => block("RS", "{b}(S := {0}, R1 := {1});", &["{b}.Q1"]),
        "RTrig" => block("R_TRIG", "{b}(CLK := {0});", &["{b}.Q"]),
        "FTrig" => block("F_TRIG", "{b}(CLK := {0});", &["{b}.Q"]),
        "Limiter" => block("LIMITER", FILTER, &["{b}.OUTPUT", "{b}.AT_LOW", "{b}.AT_HIGH"]),
        "DeadBand" => InSt {
            block: None,
            call: "out := DEAD_BAND(IN := {0}{set});",
            outputs: &["out"],
            renamed: &[],
        },
        "Hysteresis" => block("HYSTERESIS", FILTER, &["{b}.Q"]),
        "Scale" => InSt {
            block: None,
            call: "out := SCALE(IN := {0}{set});",
            outputs: &["out"],
            renamed: &[],
        },
        "Lag" => block("LAG", FILTER, &["{b}.OUTPUT"]),
        "SecondOrder" => block("SECOND_ORDER", FILTER, &["{b}.OUTPUT", "{b}.RATE"]),
        "Ramp" => block("RAMP", FILTER, &["{b}.OUTPUT"]),
        "Biquad" => block("BIQUAD", FILTER, &["{b}.OUTPUT"]),
        "Fir" => block(
            "FIR",
            "coefficients[0] := {c0}; coefficients[1] := {c1}; coefficients[2] := {c2};\n\
             coefficients[3] := {c3}; {b}(IN := {0}, COEFFICIENTS := coefficients);",
            &["{b}.OUTPUT"],
        ),
        // Its room is that of the block in ST.
        "Delay" => block("DELAY", "{b}(IN := {0}, CALLS := MIN({calls}, 4));", &["{b}.OUTPUT"]),
        "Statistics" => block(
            "STATISTICS",
            "{b}(IN := {0}, SIZE := 4);",
            &["{b}.MEAN", "{b}.STANDARD_DEVIATION", "{b}.LEAST", "{b}.GREATEST"],
        ),
        "Pid" => block(
            "PID",
            "{b}(SETPOINT := {0}, MEASURED := {1}, AUTOMATIC := {2}, MANUAL := {3}{set});",
            &["{b}.OUTPUT"],
        ),
        "Alarm" => InSt {
            block: Some("ALARM"),
            call: "{b}(IN := {0}, ACKNOWLEDGE := {1}{set});",
            outputs: &["{b}.STATE"],
            renamed: &[("limit", "THRESHOLD")],
        },
        _ => return None,
    })
}

/// A cell as a literal. Times are milliseconds.
fn literal(value: &Value, column: &str) -> String {
    match (value, column) {
        (Value::Boolean(value), _) => value.to_string().to_uppercase(),
        (Value::Integer(value), "pt" | "et" | "on_delay" | "off_delay") => format!("T#{value}ms"),
        (Value::Integer(value), "condition") => {
            let names = ["ABOVE", "BELOW", "EQUAL", "DIFFERENT"];
            format!("ALARM_CONDITION#{}", names[*value as usize])
        }
        (Value::Integer(value), "state") => {
            let names = ["NORMAL", "UNACKNOWLEDGED", "ACKNOWLEDGED", "RETURNED_UNACKNOWLEDGED"];
            format!("ALARM_STATE#{}", names[*value as usize])
        }
        (Value::Integer(value), _) => value.to_string(),
        (Value::Float(value), _) if value.is_nan() => "not_a_number".to_owned(),
        (Value::Float(value), _) if value.is_infinite() => {
            if *value > 0.0 {
                "infinity".to_owned()
            } else {
                "-infinity".to_owned()
            }
        }
        (Value::Float(value), _) => real(*value),
        (value, _) => panic!("{value:?}"),
    }
}

/// A number with a point, which a literal needs before its exponent.
fn real(value: f64) -> String {
    let text = format!("{value:?}");
    match text.split_once('e') {
        Some((mantissa, exponent)) if mantissa.contains('.') => format!("{mantissa}E{exponent}"),
        Some((mantissa, exponent)) => format!("{mantissa}.0E{exponent}"),
        None => text,
    }
}

/// The statements of a row: the call, and the comparison of each output.
fn row(
    source: &mut String,
    table: &toml::Table,
    st: &InSt,
    case: &Case,
    number: usize,
    row: usize,
) {
    let columns = |key: &str| {
        let names = table[key].as_array().expect("names").iter();
        names.map(|name| name.as_str().expect("a name").to_owned()).collect::<Vec<_>>()
    };
    let (inputs, outputs) = (columns("inputs"), columns("outputs"));
    let cells = &case.rows[row][1..];
    let instance = format!("b{number}");
    let mut set = String::new();
    let mut call = st.call.to_owned();
    for (name, value) in &case.set {
        let renamed = st.renamed.iter().find(|(from, _)| from == name);
        let parameter = renamed.map_or_else(|| name.to_uppercase(), |(_, to)| (*to).to_owned());
        write!(set, ", {parameter} := {}", literal(value, name)).unwrap();
        call = call.replace(&format!("{{{name}}}"), &literal(value, name));
    }
    call = call.replace("{b}", &instance).replace("{set}", &set);
    for (at, (value, column)) in cells.iter().zip(&inputs).enumerate() {
        call = call.replace(&format!("{{{at}}}"), &literal(value, column));
    }
    writeln!(source, "{row}:\n{call}").unwrap();
    for ((output, expected), column) in st.outputs.iter().zip(&cells[inputs.len()..]).zip(&outputs)
    {
        let (found, wanted) = (output.replace("{b}", &instance), literal(expected, column));
        let equal = match expected {
            Value::Float(value) if value.is_nan() => format!("{found} <> {found}"),
            Value::Float(value) if value.is_finite() && case.tolerance > 0.0 => {
                format!("ABS({found} - ({wanted})) <= {}", real(case.tolerance))
            }
            _ => format!("{found} = {wanted}"),
        };
        writeln!(source, "IF NOT ({equal}) THEN wrong := wrong + 1; END_IF;").unwrap();
    }
}

fn check(name: &str, text: &str, suffix: &str) {
    let table: Table = toml::from_str(text).unwrap_or_else(|error| panic!("{name}: {error}"));
    let columns: toml::Table = toml::from_str(text).expect("a table");
    let Some(st) = in_st(&table.block) else { return };
    let mut source = String::from(
        "PROGRAM Main\nVAR\nwhich AT %MD0 : DINT; position AT %MD1 : DINT; wrong AT %MD2 : DINT;\n\
         out : LREAL; zero : LREAL; infinity : LREAL; not_a_number : LREAL;\n\
         coefficients : ARRAY[0..63] OF LREAL;\nEND_VAR\nVAR RETAIN\n",
    );
    for number in 0..table.cases.len() {
        if let Some(block) = st.block {
            writeln!(source, "b{number} : {block}{suffix};").unwrap();
        }
    }
    source
        .push_str("END_VAR\ninfinity := 1.0 / zero; not_a_number := zero / zero;\nCASE which OF\n");
    for (number, case) in table.cases.iter().enumerate() {
        writeln!(source, "{number}:\nCASE position OF").unwrap();
        for at in 0..case.rows.len() {
            row(&mut source, &columns, &st, case, number, at);
        }
        source.push_str("END_CASE;\n");
    }
    source.push_str("END_CASE;\nEND_PROGRAM\n");
    source.push_str(CONFIGURATION);

    let program = compile(name, &source);
    // Retained blocks go on over a warm start before each row, whether the release time goes back or is later.
    for restarts in [false, true] {
        let mut machine = Twice::start(&program);
        for (number, case) in table.cases.iter().enumerate() {
            let mut job = Job { now_ns: 5_000_000, ..Job::default() };
            for (at, cells) in case.rows.iter().enumerate() {
                let milliseconds =
                    u64::try_from(cells[0].as_integer().expect("a time")).expect("a time");
                job.elapsed_ns = milliseconds * 1_000_000;
                job.now_ns += job.elapsed_ns;
                if restarts {
                    machine.restart();
                    job.now_ns = if at % 3 == 0 { 0 } else { job.now_ns + 3_600_000_000_000 };
                }
                machine.set_marker(0, number as i32);
                machine.set_marker(1, at as i32);
                machine.run(job);
                let wrong = machine.marker(2);
                assert_eq!(
                    wrong,
                    0,
                    "{name}, {:?}, row {}: {cells:?}, restarts: {restarts}",
                    case.name,
                    at + 1
                );
            }
        }
    }
}

#[test]
fn the_blocks_give_the_values_of_their_tables() {
    let tables = tables("../blocks/tests/tables");
    let known = tables.iter().filter(|(name, text)| {
        check(name, text, "");
        let table: Table = toml::from_str(text).expect("a table");
        in_st(&table.block).is_some()
    });
    // All but the multiplexer, which is MUX in ST, and the transform, which has a test of its own below.
    assert_eq!(known.count(), tables.len() - 2);
}

#[test]
fn timers_of_ltime_are_those_of_time() {
    let timers = ["ton", "tof", "tp"];
    let tables = tables("../blocks/tests/tables");
    let tables = tables.iter().filter(|(name, _)| timers.contains(&name.as_str()));
    assert_eq!(tables.map(|(name, text)| check(name, text, "_LTIME")).count(), 3);
}

#[test]
fn counters_count_in_their_type_and_stop_at_its_ends() {
    let mut source = String::from("PROGRAM Main\nVAR\nwrong AT %MD0 : DINT;\n");
    let types = [
        ("DINT", i128::from(i32::MIN), i128::from(i32::MAX)),
        ("LINT", i128::from(i64::MIN), i128::from(i64::MAX)),
        ("UDINT", 0, i128::from(u32::MAX)),
        ("ULINT", 0, i128::from(u64::MAX)),
    ];
    for (ty, ..) in types {
        writeln!(source, "up_{ty} : CTU_{ty}; down_{ty} : CTD_{ty}; both_{ty} : CTUD_{ty};")
            .unwrap();
    }
    source.push_str("END_VAR\n");
    let expect = |source: &mut String, condition: String| {
        writeln!(source, "IF NOT ({condition}) THEN wrong := wrong + 1; END_IF;").unwrap();
    };
    for (ty, least, greatest) in types {
        writeln!(source, "up_{ty}(CU := TRUE, PV := 1);").unwrap();
        expect(&mut source, format!("up_{ty}.Q AND up_{ty}.CV = 1"));
        let below = greatest - 1;
        writeln!(
            source,
            "both_{ty}(LD := TRUE, PV := {below}); both_{ty}(LD := FALSE, CU := TRUE);"
        )
        .unwrap();
        expect(&mut source, format!("both_{ty}.CV = {greatest}"));
        writeln!(source, "both_{ty}(CU := FALSE); both_{ty}(CU := TRUE);").unwrap();
        expect(&mut source, format!("both_{ty}.QU AND both_{ty}.CV = {greatest}"));
        let above = least + 1;
        writeln!(
            source,
            "down_{ty}(LD := TRUE, PV := {above}); down_{ty}(LD := FALSE, CD := TRUE);"
        )
        .unwrap();
        writeln!(source, "down_{ty}(CD := FALSE); down_{ty}(CD := TRUE);").unwrap();
        expect(&mut source, format!("down_{ty}.Q AND down_{ty}.CV = {least}"));
    }
    source.push_str("END_PROGRAM\n");
    source.push_str(CONFIGURATION);
    let program = compile("counters", &source);
    let mut machine = Twice::start(&program);
    machine.run(Job::default());
    assert_eq!(machine.marker(0), 0);
}

#[test]
fn the_transform_gives_the_values_of_its_table() {
    let (_, text) =
        tables("../blocks/tests/tables").into_iter().find(|(name, _)| name == "fft").unwrap();
    let table: Table = toml::from_str(&text).expect("a table");
    let mut source = String::from(
        "PROGRAM Main\nVAR\nwrong AT %MD0 : DINT; re, im : ARRAY[0..7] OF LREAL;\n\
         three : ARRAY[0..2] OF LREAL;\nEND_VAR\n",
    );
    for case in &table.cases {
        let cells = &case.rows[0][1..];
        for (at, value) in cells[..16].iter().enumerate() {
            let array = if at < 8 { "re" } else { "im" };
            writeln!(source, "{array}[{}] := {};", at % 8, literal(value, "")).unwrap();
        }
        source.push_str("IF NOT FFT(re, im) THEN wrong := wrong + 1; END_IF;\n");
        for (at, value) in cells[16..].iter().enumerate() {
            let array = if at < 8 { "re" } else { "im" };
            let near = real(case.tolerance);
            let (place, expected) = (at % 8, literal(value, ""));
            writeln!(source, "IF NOT (ABS({array}[{place}] - ({expected})) <= {near}) THEN")
                .unwrap();
            source.push_str("wrong := wrong + 1; END_IF;\n");
        }
    }
    // No power of two, and arrays that do not belong together.
    source.push_str("IF FFT(three, three) OR FFT(re, three) THEN wrong := wrong + 1; END_IF;\n");
    source.push_str("END_PROGRAM\n");
    source.push_str(CONFIGURATION);
    let program = compile("fft", &source);
    let mut machine = Twice::start(&program);
    machine.run(Job::default());
    assert_eq!(machine.marker(0), 0);
}

#[test]
fn no_time_passes_for_a_task_that_was_released_before_the_last_call() {
    let source = format!(
        "PROGRAM Main VAR timer : TON; et AT %MD0 : DINT; END_VAR timer(IN := TRUE, PT := T#1h);\n\
         et := LINT_TO_DINT(TIME_TO_LINT(timer.ET) / 1000000); END_PROGRAM\n{CONFIGURATION}"
    );
    let program = compile("tasks", &source);
    let mut machine = Twice::start(&program);
    for (now_ms, et_ms) in [(10, 0), (20, 10), (15, 10), (18, 10), (30, 20)] {
        machine.run(Job { now_ns: now_ms * 1_000_000, ..Job::default() });
        assert_eq!(machine.marker(0), et_ms, "at {now_ms} ms");
    }
}
