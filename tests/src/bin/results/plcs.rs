//! The same control program in each way of running it, beside the same compiling Linux.

use takt_tests::Value;

use crate::ranges::{self, Row};
use crate::{Measured, partition, us};

/// One way of running it.
struct Form {
    label: String,
    /// With the keys that a PLC has in Takt's report.
    result: Value,
    /// What Linux has compiled meanwhile, and in how many seconds.
    objects: Option<(u64, f64)>,
}

/// Those that have been measured; `None` if none has.
fn forms(measured: &Measured) -> Option<Vec<Form>> {
    let mut forms = Vec::new();
    for (flavour, kernel) in [("cloud", "not real-time"), ("rt", "PREEMPT_RT")] {
        for (policy, name) in [("fifo", "SCHED_FIFO"), ("deadline", "SCHED_DEADLINE")] {
            for (guard, how) in [(0, ""), (20, ", 20 us early")] {
                let file = format!("{flavour}-{policy}-{guard}.json");
                let Some(result) = measured.json(&file) else { continue };
                let label = format!("{kernel}, {name}{how}");
                forms.push(Form { label, result, objects: None });
            }
        }
    }
    for (name, label) in [
        ("guard-0", "Takt without guard"),
        ("guard-20", "Takt, guard 20 us"),
        ("strict", "Takt, Linux in windows"),
    ] {
        let Some(report) = measured.json(&format!("{name}.json")) else { continue };
        let result = partition(&report, "plc")?.clone();
        let told = |line: &str| {
            line.trim().strip_prefix("takt-load: compile ")?.split(' ').next()?.parse().ok()
        };
        let objects = measured.text(&format!("{name}.log"))?.lines().filter_map(told).max();
        let seconds = report["duration_ns"].as_u64()? as f64 / 1e9;
        forms.push(Form {
            label: label.to_owned(),
            result,
            objects: Some((objects.unwrap_or(0), seconds)),
        });
    }
    (!forms.is_empty()).then_some(forms)
}

/// The table.
pub fn table(measured: &Measured) -> Option<String> {
    let mut text =
        "| | releases | lost | later than 20 us | min | p50 | p99 | p99.9 | max | Linux |\n\
                    | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n"
            .to_owned();
    for Form { label, result, objects } in forms(measured)? {
        let latency = &result["release_latency_ns"];
        let [min, p50, p99, p999, max] =
            ["min", "p50", "p99", "p999", "max"].map(|key| us(&latency[key]));
        let late = match latency["max"].as_u64()? {
            0..=20_000 => 0,
            _ => result["late_releases"].as_u64()?,
        };
        text += &format!(
            "| {label} | {} | {} | {late} | {} | {} | {} | {} | {} | {} |\n",
            result["releases"],
            result["lost"],
            min?,
            p50?,
            p99?,
            p999?,
            max?,
            objects.map_or(String::new(), |(n, seconds)| format!("{n} objects in {seconds:.1} s")),
        );
    }
    Some(text)
}

/// The plot.
pub fn plot(measured: &Measured) -> Option<String> {
    let rows: Option<Vec<Row>> = forms(measured)?
        .into_iter()
        .map(|form| Row::new(form.label, &form.result["release_latency_ns"]))
        .collect();
    Some(ranges::draw(
        "From the release to the start of the scan, beside a compiling Linux (lab)",
        &rows?,
    ))
}
