//! A measurement on a terminal.

use std::fmt::Write;

use crate::cause;
use crate::distribution::{Distribution, coarse};
use crate::gate::Kind;
use crate::guard;
use crate::measurement::Measurement;
use takt_figures::report::{Partition, STOPPED};

/// Longest bar, in characters.
const WIDTH: f64 = 50.0;
/// What a line about a load begins with that is not proved.
const NOT_PROVED: &str = "NOT PROVED";
/// In a million, and what they are called.
const QUANTILES: [(u32, &str); 6] = [
    (500_000, "50 %"),
    (900_000, "90 %"),
    (990_000, "99 %"),
    (999_000, "99.9 %"),
    (999_900, "99.99 %"),
    (999_990, "99.999 %"),
];

/// Everything, as lines. Text that comes from a file cannot play with the terminal.
pub fn text(measurement: &Measurement) -> String {
    let mut text = String::new();
    let figures = &measurement.figures;
    // Writing to a String cannot fail.
    let _ = writeln!(
        text,
        "\n{}: {:.3} s, lane {}, load {}{}",
        figures.system,
        figures.duration_ns as f64 / 1e9,
        figures.lane,
        measurement.manner.load.name(),
        measurement.meanwhile().map_or(String::new(), |done| format!(" ({done})")),
    );
    for partition in &figures.partitions {
        describe(&mut text, measurement, partition);
    }
    for partition in &figures.partitions {
        if let Some(Some(stuck)) = partition.stuck {
            let _ = writeln!(text, "\nSTUCK {}: its kernel {stuck}", partition.name);
        }
    }
    for breach in &measurement.breaches {
        let who = if breach.partition.is_empty() { "limits" } else { &breach.partition };
        let what = match breach.kind {
            Kind::Limit => "EXCEEDED",
            Kind::Load => NOT_PROVED,
        };
        let _ = writeln!(text, "\n{what} {who}: {}", breach.text);
    }
    if let Some(warning) = measurement.warning() {
        let _ = writeln!(text, "\n{NOT_PROVED} load: {warning}");
    }
    if measurement.breaches.is_empty() && !measurement.limits.none() {
        text.push_str("\nall limits are kept\n");
    }
    plain(&text)
}

/// Without anything that a terminal takes for an order.
pub fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_control() && c != '\n' { '?' } else { c }).collect()
}

fn describe(text: &mut String, measurement: &Measurement, partition: &Partition) {
    let Some(r) = &partition.releases else { return };
    let _ = writeln!(
        text,
        "\n{}: {} releases, {} lost, {} late, {} overruns",
        partition.name, r.releases, r.lost, r.late_releases, r.overruns
    );
    // It was not there all the time.
    if partition.restarts > 0 || partition.end != STOPPED {
        let _ = writeln!(text, "  restarts {}; {}", partition.restarts, partition.end);
    }
    let latencies = measurement.figures.course(partition).map(|course| &course.latency_ns[..]);
    if let Some(latencies) = latencies.and_then(Distribution::new) {
        percentiles(text, &latencies);
        histogram(text, &latencies);
    }
    // What would read "0.0 us" is on the page.
    for start in r.late_starts.iter().filter(|start| start.latency_ns >= 100) {
        let us = start.latency_ns as f64 / 1e3;
        let words = cause::words(&start.parts);
        let _ = writeln!(text, "  release {} was {us:.1} us late: {words}", start.release);
    }
    if let Some(proposal) = guard::proposal(partition) {
        let _ = writeln!(text, "{}: {proposal}", partition.name);
    }
}

fn percentiles(text: &mut String, latencies: &Distribution) {
    text.push_str("  start after the release, in ns\n  ");
    let _ = write!(text, "{:>10}", "min");
    // A percentile that no release lies beyond says no more than the maximum.
    let known = |per_million: u32| {
        u128::from(latencies.total()) * u128::from(1_000_000 - per_million) >= 1_000_000
    };
    let quantiles = || QUANTILES.iter().filter(|(q, _)| known(*q));
    quantiles().for_each(|(_, name)| {
        let _ = write!(text, "{name:>10}");
    });
    let _ = write!(text, "{:>10}\n  {:>10}", "max", latencies.min());
    quantiles().for_each(|(q, _)| {
        let _ = write!(text, "{:>10}", latencies.quantile(*q));
    });
    let _ = writeln!(text, "{:>10}", latencies.max());
}

/// One line for each bin. The bars are logarithmic: an outlier among millions must be seen.
fn histogram(text: &mut String, latencies: &Distribution) {
    let bins = latencies.bins(coarse());
    let scale = WIDTH / bins.iter().map(|bin| length(bin.count)).fold(1.0, f64::max);
    text.push_str("  ns                    releases  (bars are logarithmic)\n");
    for bin in bins {
        let range = match bin.to - bin.from {
            1 => bin.from.to_string(),
            _ => format!("{}-{}", bin.from, bin.to - 1),
        };
        let bar = "#".repeat((length(bin.count) * scale).round() as usize);
        let _ = writeln!(text, "  {range:<15}{:>15}  {bar}", bin.count);
    }
}

/// The length of a bar; one release has one too.
fn length(count: u64) -> f64 {
    if count == 0 { 0.0 } else { 1.0 + (count as f64).log10() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outlier_is_seen_among_many() {
        let mut text = String::new();
        histogram(&mut text, &Distribution::new(&[(0, 1_000), (2, 59_000), (4_321, 1)]).unwrap());
        let lines: Vec<&str> = text.lines().skip(1).collect();
        assert_eq!(lines.len(), 13, "{text}");
        let bars = |line: &str| line.matches('#').count();
        assert!(lines[0].starts_with("  0 ") && lines[2].starts_with("  2 "), "{text}");
        assert_eq!((bars(lines[1]), bars(lines[2])), (0, 50), "{text}");
        assert!(lines[12].starts_with("  2001-5000") && bars(lines[12]) > 5, "{text}");
    }

    #[test]
    fn percentiles_are_shown_as_far_as_there_are_releases_for_them() {
        let shown = |count| {
            let mut text = String::new();
            percentiles(&mut text, &Distribution::new(&[(2, count), (9, 1)]).unwrap());
            text
        };
        assert!(shown(998).contains(" 99 %") && !shown(998).contains("99.9 %"), "{}", shown(998));
        assert!(shown(999).contains(" 99.9 %") && !shown(999).contains("99.99 %"));
        assert_eq!(shown(10).lines().last().unwrap().split_whitespace().last(), Some("9"));
    }
}
