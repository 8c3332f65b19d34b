//! A plot of distributions: a line from the smallest to the largest value, with marks at the median
//! and the percentiles, on a logarithmic scale.
//!
//! The reports keep exact extremes and percentiles, not all values, so this is what can be drawn
//! without inventing anything.

use std::fmt::Write;

use takt_tests::Value;

const LABELS: f64 = 300.0;
const WIDTH: f64 = 900.0;
const ROW: f64 = 26.0;
const TOP: f64 = 44.0;
const RIGHT: f64 = 20.0;

/// One distribution, in ns.
pub struct Row {
    pub label: String,
    pub min: u64,
    pub p50: u64,
    pub p99: u64,
    pub p999: u64,
    pub max: u64,
}

impl Row {
    /// From a summary of a report.
    pub fn new(label: String, summary: &Value) -> Option<Row> {
        let of = |key: &str| summary[key].as_u64();
        let (min, p50, p99) = (of("min")?, of("p50")?, of("p99")?);
        Some(Row { label, min, p50, p99, p999: of("p999")?, max: of("max")? })
    }
}

/// Draws the rows below each other as an SVG document.
pub fn draw(title: &str, rows: &[Row]) -> String {
    let largest = rows.iter().map(|row| row.max).max().unwrap_or(1).max(10);
    let decades = f64::from(largest.ilog10() + 1);
    // Nothing is below 1 ns, where the scale begins.
    let x = |ns: u64| LABELS + (ns.max(1) as f64).log10() / decades * (WIDTH - LABELS - RIGHT);
    let bottom = TOP + ROW * rows.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"10\" y=\"20\" font-size=\"14\">{}</text>\n",
        bottom + 44.0,
        escaped(title),
    );
    // Writing to a String cannot fail, here and below.
    for decade in 0..=largest.ilog10() + 1 {
        let at = x(10u64.pow(decade));
        let _ = writeln!(
            svg,
            "<line x1=\"{at:.1}\" y1=\"{TOP}\" x2=\"{at:.1}\" y2=\"{bottom}\" stroke=\"#ddd\"/>\
             <text x=\"{at:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#555\">{}</text>",
            bottom + 16.0,
            unit(decade),
        );
    }
    for (n, row) in rows.iter().enumerate() {
        let y = TOP + ROW * (n as f64 + 0.5);
        let (from, to) = (x(row.min), x(row.max));
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>\
             <line x1=\"{from:.1}\" y1=\"{y}\" x2=\"{to:.1}\" y2=\"{y}\" stroke=\"#888\" stroke-width=\"2\"/>",
            LABELS - 12.0,
            y + 4.0,
            escaped(&row.label),
        );
        for (value, radius, colour) in [
            (row.p50, 5, "#1f5fa8"),
            (row.p99, 4, "#c98a00"),
            (row.p999, 3, "#c23b22"),
            (row.max, 2, "#000"),
        ] {
            let _ = writeln!(
                svg,
                "<circle cx=\"{:.1}\" cy=\"{y}\" r=\"{radius}\" fill=\"{colour}\"/>",
                x(value)
            );
        }
    }
    let _ = writeln!(
        svg,
        "<text x=\"10\" y=\"{}\" fill=\"#555\">line: smallest to largest; \
         <tspan fill=\"#1f5fa8\">median</tspan>, <tspan fill=\"#c98a00\">99 %</tspan>, \
         <tspan fill=\"#c23b22\">99.9 %</tspan>, <tspan fill=\"#000\">largest</tspan></text>\n</svg>",
        bottom + 36.0
    );
    svg
}

fn unit(decade: u32) -> String {
    let name = ["ns", "us", "ms", "s"].get(decade as usize / 3).copied().unwrap_or("?");
    format!("{} {name}", 10u64.pow(decade % 3))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_is_drawn_where_the_scale_begins_and_a_decade_is_as_long_as_another() {
        let row = |min, max| Row { label: "a<b".into(), min, p50: min, p99: max, p999: max, max };
        let svg = draw("t", &[row(0, 1000), row(10, 100)]);
        assert!(svg.contains("a&lt;b") && !svg.contains("a<b"));
        // Four decades to 10 us: 145 units each.
        assert!(svg.contains("<line x1=\"300.0\" y1=\"57\" x2=\"735.0\""), "{svg}");
        assert!(svg.contains("<line x1=\"445.0\" y1=\"83\" x2=\"590.0\""), "{svg}");
        assert!(svg.contains(">10 us<"));
    }
}
