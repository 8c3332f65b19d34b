//! From one PLC to sixteen beside a Linux, on one CPU.

use takt_tests::Value;

use crate::ranges::{self, Row};
use crate::{Measured, us};

const COUNTS: [u64; 5] = [1, 2, 4, 8, 16];

/// The PLCs of the run with `count` of them, and all its background.
fn run(measured: &Measured, count: u64) -> Option<(Vec<Value>, Value)> {
    let report = measured.json(&format!("plcs-{count}.json"))?;
    let (plcs, others): (Vec<Value>, Vec<Value>) =
        report["partitions"].as_array()?.iter().cloned().partition(|p| p["kind"] == "plc");
    Some((plcs, others.into_iter().next()?))
}

fn sum(plcs: &[Value], key: &str) -> Option<u64> {
    plcs.iter().map(|plc| plc[key].as_u64()).sum()
}

/// The extreme of a latency over all PLCs of a run.
fn worst(plcs: &[Value], key: &str) -> Option<u64> {
    let values: Option<Vec<u64>> =
        plcs.iter().map(|plc| plc["release_latency_ns"][key].as_u64()).collect();
    if key == "min" { values?.into_iter().min() } else { values?.into_iter().max() }
}

/// The table.
pub fn table(measured: &Measured) -> Option<String> {
    let mut text = "| PLCs | releases | lost or late | latency p50 | p99.9 | max | donated time used | a switch to a PLC and back costs |\n\
                    | --- | --- | --- | --- | --- | --- | --- | --- |\n"
        .to_owned();
    for count in COUNTS {
        let (plcs, linux) = run(measured, count)?;
        let releases = sum(&plcs, "releases")?;
        let bad = sum(&plcs, "lost")? + sum(&plcs, "late_releases")?;
        let [p50, p999, max] =
            ["p50", "p999", "max"].map(|key| worst(&plcs, key).and_then(|ns| us(&ns.into())));
        let of = |key: &str| linux["donation"][key].as_u64();
        let (offered, received) = (of("offered_ns")?, of("received_ns")?);
        text += &format!(
            "| {count} | {releases} | {bad} | {} us | {} us | {} us | {:.1} % | {:.1} us |\n",
            p50?,
            p999?,
            max?,
            received as f64 / offered.max(1) as f64 * 100.0,
            offered.saturating_sub(received) as f64 / releases.max(1) as f64 / 1000.0,
        );
    }
    Some(text)
}

/// The plot.
pub fn plot(measured: &Measured) -> Option<String> {
    let row = |count: u64| {
        let (plcs, _) = run(measured, count)?;
        let of = |key| worst(&plcs, key);
        Some(Row {
            label: format!("{count} PLC{}", if count == 1 { "" } else { "s" }),
            min: of("min")?,
            p50: of("p50")?,
            p99: of("p99")?,
            p999: of("p999")?,
            max: of("max")?,
        })
    };
    let rows: Option<Vec<Row>> = COUNTS.into_iter().map(row).collect();
    Some(ranges::draw("Release latency, the worst of all PLCs on one CPU (lab)", &rows?))
}
