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

/// How many releases began later than 20 us. Takt's report has the ten latest only, and what it counts as late is
/// something else: a wake-up that was later than the guard.
fn later(result: &Value) -> Option<String> {
    let Some(latest) = result["late_starts"].as_array() else {
        // A thread of the host's counts just these.
        return Some(result["late_releases"].as_u64()?.to_string());
    };
    let later = latest.iter().filter(|start| start["latency_ns"].as_u64() > Some(20_000)).count();
    Some(if later < 10 { later.to_string() } else { "10 or more".to_owned() })
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
        let late = later(&result)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A PLC under Takt whose ten latest releases came so late, in ns, and whose wake-ups were all later than its guard.
    fn takt(latest: &[u64]) -> Value {
        let latest: Vec<String> =
            latest.iter().map(|ns| format!("{{\"latency_ns\": {ns}}}")).collect();
        let text = format!("{{\"late_releases\": 9999, \"late_starts\": [{}]}}", latest.join(","));
        serde_json::from_str(&text).unwrap()
    }

    #[test]
    fn what_is_later_than_20_us_is_counted_and_not_what_came_later_than_a_guard() {
        let of = |result: &Value| later(result).unwrap();
        assert_eq!(of(&takt(&[])), "0");
        assert_eq!(of(&takt(&[20_001, 20_000, 7_766])), "1");
        assert_eq!(of(&takt(&[30_000; 10])), "10 or more");
        assert_eq!(of(&serde_json::from_str("{\"late_releases\": 6}").unwrap()), "6");
    }
}
