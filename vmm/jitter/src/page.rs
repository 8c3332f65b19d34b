//! The page: everything in one HTML file that needs no other and runs no script.
//!
//! All text goes through [`Html`], wherever it comes from: a report can have been written by
//! anybody. The policy in the page's head would keep the browser from loading or running anything
//! even if something had got past it.

use std::fmt::{self, Write};

use takt_figures::load::Course;
use takt_figures::report::Summary;

use crate::cause;
use crate::distribution::Distribution;
use crate::error::JitterError;
use crate::measurement::Measurement;
use crate::plot;
use takt_figures::report::{Partition, Releases};

const HEAD: &str = "<!DOCTYPE html>
<html lang=\"en\">
<head>
<meta charset=\"utf-8\">
<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; style-src 'unsafe-inline'\">
";
const STYLE: &str = "<style>
body { font: 15px/1.5 sans-serif; color: #1a202c; max-width: 60em; margin: 2em auto; padding: 0 1em; }
h1, h2, h3 { line-height: 1.2; }
h2 { margin-top: 2em; border-bottom: 1px solid #cbd5e0; }
table { border-collapse: collapse; margin: 1em 0; }
th, td { text-align: left; padding: 0.2em 1em 0.2em 0; border-bottom: 1px solid #e2e8f0; vertical-align: top; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; }
code { background: #edf2f7; padding: 0.1em 0.3em; overflow-wrap: anywhere; }
svg { max-width: 100%; height: auto; }
.good { color: #276749; } .bad { color: #9b2c2c; font-weight: bold; } .note { color: #4a5568; }
</style>
";

/// Text in HTML, between tags or in a quoted attribute.
struct Html<T>(T);

impl<T: AsRef<str>> fmt::Display for Html<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for c in self.0.as_ref().chars() {
            match c {
                '&' => f.write_str("&amp;")?,
                '<' => f.write_str("&lt;")?,
                '>' => f.write_str("&gt;")?,
                '"' => f.write_str("&quot;")?,
                '\'' => f.write_str("&#39;")?,
                // No HTML can have them, escaped or not.
                c if c.is_control() => f.write_str("\u{fffd}")?,
                c => f.write_char(c)?,
            }
        }
        Ok(())
    }
}

/// The whole page.
///
/// # Errors
/// If a plot cannot be drawn.
pub fn html(measurement: &Measurement) -> Result<String, JitterError> {
    let figures = &measurement.figures;
    let mut page = String::from(HEAD);
    let title = Html(format!("{}: release jitter", figures.system));
    // Writing to a String cannot fail.
    let _ = write!(page, "<title>{title}</title>\n{STYLE}</head>\n<body>\n<h1>{title}</h1>\n");
    verdict(&mut page, measurement);
    circumstances(&mut page, measurement);
    load(&mut page, measurement)?;
    for partition in &figures.partitions {
        if let Some(releases) = &partition.releases {
            self::releases(&mut page, measurement, partition, releases)?;
        }
    }
    background(&mut page, measurement);
    page.push_str("</body>\n</html>\n");
    Ok(page)
}

fn verdict(page: &mut String, measurement: &Measurement) {
    if let Some(warning) = measurement.warning() {
        let _ = writeln!(page, "<p class=\"bad\">{}</p>", Html(warning));
    }
    if measurement.limits.none() {
        return;
    }
    if measurement.breaches.is_empty() {
        page.push_str("<p class=\"good\">All limits are kept.</p>\n");
        return;
    }
    page.push_str("<ul>\n");
    for breach in &measurement.breaches {
        let (who, text) = (Html(&breach.partition), Html(&breach.text));
        let _ = writeln!(page, "<li class=\"bad\">{who} {text}</li>");
    }
    page.push_str("</ul>\n");
}

fn circumstances(page: &mut String, measurement: &Measurement) {
    let figures = &measurement.figures;
    let host = &figures.host;
    let rt = if host.preempt_rt { ", PREEMPT_RT" } else { ", not PREEMPT_RT" };
    page.push_str("<table>\n");
    let mut row = |name: &str, text: &str| {
        let _ = writeln!(page, "<tr><th>{name}</th><td>{}</td></tr>", Html(text));
    };
    row("Kernel", &format!("{}{rt}", host.kernel));
    row("Processor", &host.cpu);
    row("Time-stamp counter", &format!("{:.3} MHz", f64::from(host.tsc_khz) / 1e3));
    row("Lane", &format!("{}: {}", figures.lane, meaning(&figures.lane)));
    if let Some(emulator) = &figures.emulator {
        row("Emulated by", emulator);
    }
    row("Duration", &format!("{:.3} s", figures.duration_ns as f64 / 1e9));
    row("Load", measurement.manner.load.name());
    if let Some(done) = measurement.meanwhile() {
        row("What Linux got done meanwhile, as it says", &done);
    }
    let command = Html(&measurement.manner.command);
    let _ = writeln!(page, "<tr><th>Command</th><td><code>{command}</code></td></tr>\n</table>");
}

/// What Linux did meanwhile.
fn load(page: &mut String, measurement: &Measurement) -> Result<(), JitterError> {
    let Some(course) = measurement.progress() else { return Ok(()) };
    let Course { partition, load, unit, points, standstill, lines, .. } = course;
    let _ = writeln!(page, "<h2>Load of {}: {}</h2>", Html(partition), Html(load));
    let _ = writeln!(page, "<h3>Progress, in {}</h3>", Html(unit));
    page.push_str(&plot::progress(points, measurement.figures.duration_ns)?);
    let _ = writeln!(
        page,
        "<p>The longest time without progress was {} s, from {} s to {} s.</p>\n\
         <p class=\"note\">By the {lines} lines that Linux has printed, at the times when Takt has taken \
         them from the console.</p>",
        seconds(standstill.duration().0),
        seconds(standstill.from_ns),
        seconds(standstill.to_ns),
    );
    Ok(())
}

/// What the times of a lane mean.
fn meaning(lane: &str) -> &'static str {
    match lane {
        "direct" => "this machine, really",
        "nested" => "inside another machine; the order of magnitude",
        "lab" | "vmx" | "svm" => {
            "an emulated machine that counts instructions, one in a nanosecond; path lengths, no \
             caches, no real VM-entry cost"
        }
        "emulated" => "an emulated machine; its times mean nothing",
        _ => "not known to this program",
    }
}

fn releases(
    page: &mut String,
    measurement: &Measurement,
    partition: &Partition,
    r: &Releases,
) -> Result<(), JitterError> {
    let _ = writeln!(page, "<h2>{}</h2>", Html(&partition.name));
    let _ = writeln!(
        page,
        "<p>{} releases, {} lost, {} late, {} overruns; {} windows to start up, {} restarts. {}.</p>",
        r.releases,
        r.lost,
        r.late_releases,
        r.overruns,
        r.start_up_windows,
        partition.restarts,
        Html(&partition.end),
    );
    if r.unrecorded > 0 {
        let _ = writeln!(page, "<p class=\"bad\">{} windows are in no figure.</p>", r.unrecorded);
    }
    summaries(page, r);
    plots(page, measurement, partition)?;
    worst(page, r);
    Ok(())
}

fn summaries(page: &mut String, r: &Releases) {
    page.push_str("<table>\n<tr><th>in us</th>");
    for name in ["min", "p50", "p99", "p99.9", "max"] {
        let _ = write!(page, "<th class=\"n\">{name}</th>");
    }
    page.push_str("</tr>\n");
    for (name, summary) in [
        ("release latency", r.release_latency_ns),
        ("execution", r.execution_ns),
        ("wake-up latency", r.wake_up_latency_ns),
        ("entry", r.entry_ns),
        ("exit", r.exit_ns),
    ] {
        let Some(Summary { min, p50, p99, p999, max }) = summary else { continue };
        let _ = write!(page, "<tr><td>{name}</td>");
        for ns in [min, p50, p99, p999, max] {
            let _ = write!(page, "<td class=\"n\">{}</td>", us(ns));
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</table>\n");
}

fn plots(
    page: &mut String,
    measurement: &Measurement,
    partition: &Partition,
) -> Result<(), JitterError> {
    let Some(course) = measurement.figures.course(partition) else { return Ok(()) };
    let mut plot = |title: &str, svg: &str| {
        let _ = writeln!(page, "<h3>{title}</h3>\n{svg}");
    };
    if let Some(latencies) = Distribution::new(&course.latency_ns) {
        plot("Start after the release", &plot::histogram(&latencies)?);
        plot("Part of the releases that started no later", &plot::cumulative(&latencies)?);
    }
    let points = &course.points;
    for (title, svg) in [
        (
            "From the start of one scan to that of the next",
            plot::course(points, "interval", |p| p.interval_ns)?,
        ),
        ("Execution time", plot::course(points, "execution", |p| p.execution_ns)?),
        ("Donated: left of the window", plot::course(points, "donated", |p| Some(p.donated_ns))?),
    ] {
        if let Some(svg) = svg {
            plot(title, &svg);
        }
    }
    let _ = writeln!(
        page,
        "<p class=\"note\">In the plots over time each point stands for up to {} releases and shows \
         the least and the greatest value among them.</p>",
        course.releases_per_point
    );
    Ok(())
}

fn worst(page: &mut String, r: &Releases) {
    page.push_str("<h3>The latest starts</h3>\n");
    if r.late_starts.is_empty() {
        page.push_str("<p>No scan started remarkably late after its release.</p>\n");
    } else {
        page.push_str(
            "<table>\n<tr><th class=\"n\">release</th><th class=\"n\">at, in s</th>\
             <th class=\"n\">late, in us</th><th>cause</th></tr>\n",
        );
        for start in &r.late_starts {
            let (at, late) = (seconds(start.at_ns), us(start.latency_ns));
            row(page, start.release, &at, &late, &cause::words(&start.parts));
        }
        page.push_str("</table>\n");
    }
    if r.longest_scans.is_empty() {
        return;
    }
    page.push_str(
        "<h3>The longest scans</h3>\n<table>\n<tr><th class=\"n\">release</th>\
         <th class=\"n\">at, in s</th><th class=\"n\">took, in us</th>\
         <th>cause of what is beyond the usual</th></tr>\n",
    );
    for scan in &r.longest_scans {
        let more = if scan.finished { "" } else { " and more" };
        let took = format!("{}{more}", us(scan.execution_ns));
        let words = format!("{} (usual: {} us)", cause::words(&scan.parts), us(scan.usual_ns));
        row(page, scan.release, &seconds(scan.at_ns), &took, &words);
    }
    page.push_str("</table>\n");
}

fn row(page: &mut String, release: u64, at: &str, value: &str, words: &str) {
    let words = Html(words);
    let _ = writeln!(
        page,
        "<tr><td class=\"n\">{release}</td><td class=\"n\">{at}</td><td class=\"n\">{value}</td>\
         <td>{words}</td></tr>"
    );
}

/// The partitions without releases, which have the rest of the time.
fn background(page: &mut String, measurement: &Measurement) {
    for partition in &measurement.figures.partitions {
        if partition.releases.is_some() {
            continue;
        }
        let _ = writeln!(page, "<h2>{}</h2>", Html(&partition.name));
        // A Linux that has a CPU for itself is given nothing.
        let given = partition.donation.as_ref().map_or(String::new(), |donation| {
            let received = donation.received_ns as f64 / donation.offered_ns.max(1) as f64 * 100.0;
            format!(
                ", {:.1} % in any case. Windows left {} s, of which {received:.1} % were used",
                donation.minimum_share * 100.0,
                seconds(donation.offered_ns),
            )
        });
        let _ = writeln!(
            page,
            "<p>{:.1} % of the CPU{given}. {}.</p>",
            partition.cpu_share * 100.0,
            Html(&partition.end),
        );
        if let Some(Some(stuck)) = partition.stuck {
            let _ = writeln!(page, "<p class=\"bad\">Its kernel {}.</p>", Html(stuck.to_string()));
        }
        if let Some(Some(ns)) = partition.boot_to_init_ns {
            let _ = writeln!(page, "<p>Its first process started after {} s.</p>", seconds(ns));
        }
    }
}

fn us(ns: u64) -> String {
    format!("{:.3}", ns as f64 / 1e3)
}

fn seconds(ns: u64) -> String {
    format!("{:.3}", ns as f64 / 1e9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_character_of_a_text_is_one_of_html() {
        let text = Html("<script>\"x\" & 'y'</script>\u{0}\u{1b}").to_string();
        assert_eq!(
            text,
            "&lt;script&gt;&quot;x&quot; &amp; &#39;y&#39;&lt;/script&gt;\u{fffd}\u{fffd}"
        );
    }
}
