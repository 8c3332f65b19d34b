//! The blocks of `blocks.h` give the values of the same tables, and have the same sizes.
//!
//! One C program is written that makes the calls of all tables and compares; it is compiled as programs
//! of a PLC are, freestanding, and with all warnings as errors.

use crate::table::{Case, Row, Table, Value, tables};
use std::fmt::Write;
use std::mem::size_of;
use std::path::Path;
use std::process::Command;
use takt_blocks::*;

/// How a block is written in C: structure, call with `{0}` and so on for the inputs, outputs.
fn in_c(block: &str) -> (&'static str, &'static str, &'static [&'static str]) {
    match block {
        "Ton" => ("takt_ton", "takt_ton_update(&b, {0}, {1}, {e})", &["b.q", "b.et"]),
        "Tof" => ("takt_tof", "takt_tof_update(&b, {0}, {1}, {e})", &["b.q", "b.et"]),
        "Tp" => ("takt_tp", "takt_tp_update(&b, {0}, {1}, {e})", &["b.q", "b.et"]),
        "Ctu" => ("takt_ctu", "takt_ctu_update(&b, {0}, {1}, {2})", &["b.q", "b.cv"]),
        "Ctd" => ("takt_ctd", "takt_ctd_update(&b, {0}, {1}, {2})", &["b.q", "b.cv"]),
        "Ctud" => (
            "takt_ctud",
            "takt_ctud_update(&b, {0}, {1}, {2}, {3}, {4})",
            &["b.qu", "b.qd", "b.cv"],
        ),
        "Sr" => ("takt_sr", "takt_sr_update(&b, {0}, {1})", &["b.q1"]),
        "Rs" => ("takt_rs", "takt_rs_update(&b, {0}, {1})", &["b.q1"]),
        "RTrig" => ("takt_r_trig", "takt_r_trig_update(&b, {0})", &["b.q"]),
        "FTrig" => ("takt_f_trig", "takt_f_trig_update(&b, {0})", &["b.q"]),
        "Limiter" => (
            "takt_limiter",
            "out = takt_limiter_update(&b, {0})",
            &["out", "b.at_low", "b.at_high"],
        ),
        "DeadBand" => ("takt_dead_band", "out = takt_dead_band_update(&b, {0})", &["out"]),
        "Hysteresis" => ("takt_hysteresis", "takt_hysteresis_update(&b, {0})", &["b.output"]),
        "Scale" => ("takt_scale", "out = takt_scale_update(&b, {0})", &["out"]),
        "Lag" => ("takt_lag", "takt_lag_update(&b, {0}, {e})", &["b.output"]),
        "SecondOrder" => {
            ("takt_second_order", "takt_second_order_update(&b, {0}, {e})", &["b.output", "b.rate"])
        }
        "Ramp" => ("takt_ramp", "takt_ramp_update(&b, {0}, {e})", &["b.output"]),
        "Biquad" => ("takt_biquad", "takt_biquad_update(&b, {0})", &["b.output"]),
        "Fir" => ("fir_4", "fir_4_update(&b, {0})", &["b.output"]),
        "Delay" => ("delay_4", "out = delay_4_update(&b, {0})", &["out"]),
        "Statistics" => (
            "statistics_4",
            "statistics_4_update(&b, {0})",
            &[
                "statistics_4_mean(&b)",
                "statistics_4_standard_deviation(&b)",
                "statistics_4_least(&b)",
                "statistics_4_greatest(&b)",
            ],
        ),
        "Pid" => (
            "takt_pid",
            "{2} ? takt_pid_update(&b, {0}, {1}, {e}) : takt_pid_track(&b, {3}, {0}, {1}, {e})",
            &["b.output"],
        ),
        "Alarm" => ("takt_alarm", "takt_alarm_update(&b, {0}, {1}, {e})", &["b.state"]),
        "Multiplexer" => (
            "takt_multiplexer",
            "out = takt_multiplexer_update(&b, {0}, (double[]){{1}, {2}, {3}}, 3)",
            &["out", "b.out_of_range"],
        ),
        other => panic!("no block {other} in C"),
    }
}

/// A cell in C. Times of a column are milliseconds.
fn cell(value: Value, column: &str) -> String {
    let milliseconds = matches!(column, "pt" | "et" | "on_delay" | "off_delay");
    match value {
        Value::Bool(value) => value.to_string(),
        Value::Integer(value) if milliseconds => format!("{value}000000ull"),
        Value::Integer(value) => value.to_string(),
        Value::Real(value) if value.is_nan() => "(0.0 / 0.0)".into(),
        Value::Real(value) if value.is_infinite() => format!("({}1.0 / 0.0)", sign(value)),
        Value::Real(value) => format!("{value:?}"),
    }
}

fn sign(value: f64) -> &'static str {
    if value < 0.0 { "-" } else { "" }
}

/// The members that a case sets.
fn initialiser(block: &str, case: &Case) -> String {
    let members = case.set.iter().map(|(name, value)| {
        let member = match block {
            "Pid" => format!("tuning.{name}"),
            "Biquad" => format!("coefficients.{name}"),
            "Fir" => format!("coefficients[{}]", &name[1..]),
            _ => name.clone(),
        };
        format!(".{member} = {}", cell(*value, name))
    });
    let members = members.collect::<Vec<_>>().join(", ");
    if members.is_empty() { "0".into() } else { members }
}

fn call(pattern: &str, table: &Table, row: &Row<'_>) -> String {
    let mut call = pattern.replace("{e}", &format!("{}ull", row.elapsed.as_nanos()));
    for (number, (value, column)) in row.inputs.iter().zip(&table.inputs).enumerate() {
        call = call.replace(&format!("{{{number}}}"), &cell(*value, column));
    }
    call
}

fn transform(program: &mut String, row: &Row<'_>, tolerance: f64) {
    let (real, imaginary) = row.inputs.split_at(row.inputs.len() / 2);
    let list = |values: &[Value]| {
        values.iter().map(|value| cell(*value, "")).collect::<Vec<_>>().join(", ")
    };
    writeln!(program, "double re[] = {{{}}}, im[] = {{{}}};", list(real), list(imaginary)).unwrap();
    writeln!(program, "if (!takt_fft_transform(re, im, {})) return 1;", real.len()).unwrap();
    for (k, expected) in row.outputs.iter().enumerate() {
        let part = if k < real.len() { "re" } else { "im" };
        let place = k % real.len();
        let expected = cell(*expected, "");
        writeln!(program, "CHECK({part}[{place}], {expected}, {tolerance:?});").unwrap();
    }
}

/// The calls of a case. `#line` makes the row the line that a failure names.
fn case(program: &mut String, file: &str, table: &Table, case: &Case) {
    writeln!(program, "{{").unwrap();
    if table.block != "Fft" {
        let structure = in_c(&table.block).0;
        let initial = initialiser(&table.block, case);
        writeln!(program, "struct {structure} b = {{{initial}}}; double out = 0.0; (void)out;")
            .unwrap();
    }
    for (number, row) in case.rows(table).enumerate() {
        let place = format!("#line {} \"{file}.toml, {}\"", number + 1, case.name);
        if table.block == "Fft" {
            transform(program, &row, case.tolerance);
            continue;
        }
        let (_, pattern, outputs) = in_c(&table.block);
        writeln!(program, "{place}\n{};", call(pattern, table, &row)).unwrap();
        for ((output, expected), column) in outputs.iter().zip(row.outputs).zip(&table.outputs) {
            let expected = cell(*expected, column);
            writeln!(program, "{place}\nCHECK({output}, {expected}, {:?});", case.tolerance)
                .unwrap();
        }
    }
    writeln!(program, "}}").unwrap();
}

fn sizes(program: &mut String) {
    for (structure, size) in [
        ("takt_ton", size_of::<Ton>()),
        ("takt_tof", size_of::<Tof>()),
        ("takt_tp", size_of::<Tp>()),
        ("takt_ctu", size_of::<Ctu<i16>>()),
        ("takt_ctd_lint", size_of::<Ctd<i64>>()),
        ("takt_ctud_udint", size_of::<Ctud<u32>>()),
        ("takt_sr", size_of::<Sr>()),
        ("takt_f_trig", size_of::<FTrig>()),
        ("takt_limiter", size_of::<Limiter>()),
        ("takt_hysteresis", size_of::<Hysteresis>()),
        ("takt_scale", size_of::<Scale>()),
        ("takt_dead_band", size_of::<DeadBand>()),
        ("takt_multiplexer", size_of::<Multiplexer>()),
        ("takt_lag", size_of::<Lag>()),
        ("takt_second_order", size_of::<SecondOrder>()),
        ("takt_ramp", size_of::<Ramp>()),
        ("takt_biquad", size_of::<Biquad>()),
        ("fir_4", size_of::<Fir<4>>()),
        ("delay_4", size_of::<Delay<4>>()),
        ("statistics_4", size_of::<Statistics<4>>()),
        ("takt_pid", size_of::<Pid>()),
        ("takt_alarm", size_of::<Alarm>()),
    ] {
        writeln!(program, "_Static_assert(sizeof(struct {structure}) == {size}, \"size\");")
            .unwrap();
    }
}

/// Designs of sections: those of Rust, whose gains have a test of their own.
fn designs(program: &mut String) {
    for frequency in [0.001, 0.05, 0.25, 0.4999] {
        let quality = biquad::BUTTERWORTH;
        for (pass, design) in [
            ("TAKT_LOW_PASS", Coefficients::low_pass(frequency, quality)),
            ("TAKT_HIGH_PASS", Coefficients::high_pass(frequency, quality)),
            ("TAKT_BAND_PASS", Coefficients::band_pass(frequency, quality)),
            ("TAKT_NOTCH", Coefficients::notch(frequency, quality)),
        ] {
            let call = format!("takt_design({pass}, {frequency:?}, {quality:?})");
            let Coefficients { b0, b1, b2, a1, a2 } = design;
            for (name, value) in [("b0", b0), ("b1", b1), ("b2", b2), ("a1", a1), ("a2", a2)] {
                writeln!(program, "#line 1 \"{pass} at {frequency}\"").unwrap();
                writeln!(program, "CHECK({call}.{name}, {value:?}, 1e-15);").unwrap();
            }
        }
    }
}

#[test]
fn the_blocks_in_c_give_the_values_of_the_tables() {
    let mut program = String::from(
        "#include \"blocks.h\"\n#include <stdio.h>\n\
         TAKT_FIR(fir_4, 4)\nTAKT_DELAY(delay_4, 4)\nTAKT_STATISTICS(statistics_4, 4)\n\
         static int failures;\n\
         static void check(double found, double expected, double tolerance, int row, const char *case_) {\n\
         double distance = found < expected ? expected - found : found - expected;\n\
         if (found == expected || (found != found && expected != expected) || distance <= tolerance) return;\n\
         printf(\"%s, row %d: found %.17g, expected %.17g\\n\", case_, row, found, expected); failures++; }\n\
         #define CHECK(FOUND, EXPECTED, TOLERANCE) \
         check((double)(FOUND), (double)(EXPECTED), TOLERANCE, __LINE__, __FILE__)\n",
    );
    sizes(&mut program);
    program.push_str("int main(void) {\n");
    for (file, table) in tables() {
        for each in &table.cases {
            case(&mut program, &file, &table, each);
        }
    }
    designs(&mut program);
    program.push_str("return failures != 0;\n}\n");

    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (source, binary) = (folder.join("blocks.c"), folder.join("blocks"));
    std::fs::write(&source, program).expect("the program can be written");
    let header = Path::new(env!("CARGO_MANIFEST_DIR")).join("c");
    let compiled = Command::new("cc")
        .args(["-std=c11", "-O2", "-ffreestanding", "-Wall", "-Wextra", "-Wpedantic", "-Werror"])
        .args(["-Wno-div-by-zero", "-I"])
        .args([&header, &source])
        .arg("-o")
        .arg(&binary)
        .output()
        .expect("cc runs");
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let run = Command::new(&binary).output().expect("the program runs");
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stdout));
}
