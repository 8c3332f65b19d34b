//! Where the time of a frame of 1 ms goes, as a bar from a release to the next.
//!
//! What is drawn "before" was measured by the same script in the same lab, of the version that is named, and
//! does not change any more.

use std::fmt::Write;

use crate::paid::{Beyond, beyond_of};
use crate::{Measured, partition};

const FRAME_NS: u64 = 1_000_000;
const WIDTH: f64 = 900.0;
const LEFT: f64 = 210.0;
const ROW: f64 = 46.0;
const TOP: f64 = 44.0;

/// The version before, and what compiling took in it beside a PLC with this share, with the medians of its kicks.
const BEFORE: &str = "7b0ceff";
const BEFORE_RUNS: [(u64, u64, u64); 2] =
    [(10, 1_273_571_519, 15_767), (30, 1_677_629_452, 15_799)];
const BEFORE_GUARD_NS: u64 = 20_000;

/// Parts of a frame, in the order of time as far as they have one.
const PARTS: [(&str, &str); 6] = [
    ("the PLC's window", "#1f5fa8"),
    ("until its thread is out of the guest", "#c23b22"),
    ("to the PLC and back, the window enforcer", "#e08a3c"),
    ("what a guest takes more than the host", "#c9b458"),
    ("compiling", "#7fb069"),
    ("guard", "#8c6bb1"),
];

struct Bar {
    label: String,
    /// In ns, in the order of [`PARTS`].
    parts: [u64; 6],
}

impl Bar {
    fn new(label: String, share: u64, beyond: Beyond) -> Bar {
        let Beyond { whole: _, guard, kick, guest, rest } = beyond;
        let window = share * FRAME_NS / 100;
        let work = FRAME_NS.saturating_sub(window + guard + kick + guest + rest);
        Bar { label, parts: [window, kick, rest, guest, work, guard] }
    }
}

fn bars(measured: &Measured) -> Option<Vec<Bar>> {
    let mut bars = Vec::new();
    for (share, time, kick) in BEFORE_RUNS {
        let before = beyond_of(measured, share, time, BEFORE_GUARD_NS, kick)?;
        bars.push(Bar::new(format!("{share} %, before ({BEFORE})"), share, before));
        for (suffix, name) in [("", "guard 20us"), ("-auto", "guard \"auto\"")] {
            let run = format!("pay-{share}-1{suffix}");
            let report = measured.json(&format!("{run}.json"))?;
            let of = |key: &str| partition(&report, "plc")?[key]["p50"].as_u64();
            let time = measured.paid(&format!("{run}.log"), "time-2")?;
            let now = beyond_of(measured, share, time, of("release_guard_ns")?, of("kick_ns")?)?;
            bars.push(Bar::new(format!("{share} %, {name}"), share, now));
        }
    }
    Some(bars)
}

/// The table.
pub fn table(measured: &Measured) -> Option<String> {
    let mut text = "| of each frame of 1 ms, in us |".to_owned();
    let bars = bars(measured)?;
    for bar in &bars {
        let _ = write!(text, " {} |", bar.label);
    }
    text += "\n| --- |";
    text += &" --- |".repeat(bars.len());
    for (part, (name, _)) in PARTS.iter().enumerate() {
        let _ = write!(text, "\n| {name} |");
        for bar in &bars {
            let _ = write!(text, " {:.1} |", bar.parts[part] as f64 / 1e3);
        }
    }
    // What compiling takes with what the PLC leaves, on the host without anything.
    text += "\n| **compiling beyond the share, as a factor** |";
    for bar in &bars {
        let [window, .., work, _] = bar.parts;
        let factor = (FRAME_NS - window) as f64 / work.max(1) as f64;
        let _ = write!(text, " {factor:.3} |");
    }
    Some(text + "\n")
}

/// The plot.
pub fn plot(measured: &Measured) -> Option<String> {
    Some(draw(&bars(measured)?))
}

fn draw(bars: &[Bar]) -> String {
    let bottom = TOP + ROW * bars.len() as f64;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {}\" \
         font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"10\" y=\"20\" font-size=\"14\">A frame of 1 ms, from a release to the next: \
         a PLC that never says done, and a Linux that compiles (lab)</text>\n",
        bottom + 40.0,
    );
    let scale = (WIDTH - LEFT - 20.0) / FRAME_NS as f64;
    for (n, bar) in bars.iter().enumerate() {
        let y = TOP + ROW * n as f64;
        let _ = writeln!(
            svg,
            "<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
            LEFT - 12.0,
            y + 20.0,
            bar.label.replace('"', "&quot;"),
        );
        let mut at = 0;
        for (length, (name, colour)) in bar.parts.iter().zip(PARTS) {
            let (x, width) = (LEFT + at as f64 * scale, *length as f64 * scale);
            let _ = writeln!(
                svg,
                "<rect x=\"{x:.1}\" y=\"{y}\" width=\"{width:.1}\" height=\"30\" fill=\"{colour}\">\
                 <title>{name}: {:.1} us</title></rect>",
                *length as f64 / 1e3,
            );
            at += length;
        }
    }
    let mut x = 10.0;
    for (name, colour) in PARTS {
        let _ = writeln!(
            svg,
            "<rect x=\"{x}\" y=\"{}\" width=\"10\" height=\"10\" fill=\"{colour}\"/>\
             <text x=\"{}\" y=\"{}\" font-size=\"10\">{name}</text>",
            bottom + 8.0,
            x + 14.0,
            bottom + 17.0,
        );
        x += 24.0 + 4.9 * name.len() as f64;
    }
    svg + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_as_long_as_its_frame_and_begins_with_the_window() {
        let beyond = Beyond { whole: 60, guard: 20_000, kick: 15_000, guest: 10_000, rest: 5_000 };
        let bar = Bar::new("10 %, \"auto\"".into(), 10, beyond);
        assert_eq!(bar.parts, [100_000, 15_000, 5_000, 10_000, 850_000, 20_000]);
        let svg = draw(&[bar]);
        assert!(svg.contains("<rect x=\"210.0\" y=\"44\" width=\"67.0\""), "{svg}");
        assert!(svg.contains("&quot;auto&quot;") && svg.contains("guard: 20.0 us"), "{svg}");
    }
}
