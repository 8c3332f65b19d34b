//! A recording as a picture: a curve for each value over the time from the trigger.
//!
//! The picture is as wide as it is, however many cycles there are: each column of it keeps the first, the least, the
//! greatest and the last value of its cycles, so no peak is lost and the memory is bounded. A value holds until the next
//! cycle. Cycles that are missing leave the curve open.

use std::fmt::Display;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use takt_scheduler::time::Nanos;

use super::recording::Extent;

/// Most curves of a picture.
pub const CURVES_MAX: usize = 32;
const WIDTH: u32 = 1000;
/// Height of one curve.
const HEIGHT: u32 = 120;
/// Height of what stands above all.
const HEAD: u32 = 34;
/// Columns that are told apart; about the pixels between the axes.
const COLUMNS: f64 = 880.0;
const CURVE: RGBColor = RGBColor(0x1a, 0x3f, 0x66);
const TRIGGER: RGBColor = RGBColor(0xc2, 0x3b, 0x22);
const FONT: (&str, u32) = ("sans-serif", 13);

/// Values beyond are drawn here: the length of the axis is finite so.
const VALUE_MAX: f64 = 1e300;

/// All curves.
pub struct Plot {
    curves: Vec<Curve>,
    /// Seconds from the trigger to the first and to the last column.
    from: f64,
    to: f64,
}

impl Plot {
    /// With so many curves, from this time before the trigger to this time after it.
    pub fn new(curves: usize, before: Nanos, after: Nanos) -> Self {
        let curves = (0..curves).map(|_| Curve::default()).collect();
        let (from, to) = (-(before.0 as f64) / 1e9, after.0 as f64 / 1e9);
        // The drawing library panics at an empty range.
        Self { curves, from, to: to.max(from + 1e-9) }
    }

    /// The values of a cycle, in the order of the curves; not finite ones, and none, are left out.
    pub fn row(
        &mut self,
        release_ns: u64,
        triggered_ns: u64,
        gap: bool,
        values: impl Iterator<Item = Option<f64>>,
    ) {
        let time = (i128::from(release_ns) - i128::from(triggered_ns)) as f64 / 1e9;
        // A cycle at the edge may be rounded over it, and the drawing library panics far beyond.
        let time = time.clamp(self.from, self.to);
        let column = ((time - self.from) / (self.to - self.from) * COLUMNS) as u64;
        for (curve, value) in self.curves.iter_mut().zip(values) {
            match value.filter(|value| value.is_finite()) {
                Some(value) => {
                    curve.add(column, time, value.clamp(-VALUE_MAX, VALUE_MAX), gap);
                }
                None => curve.open(),
            }
        }
    }

    /// The picture as SVG.
    ///
    /// # Errors
    /// What the drawing library says.
    pub fn draw(&mut self, names: &[&str], extent: &Extent) -> Result<String, String> {
        let size = (WIDTH, HEAD + HEIGHT * self.curves.len() as u32 + 20);
        let mut text = String::new();
        {
            let area = SVGBackend::with_string(&mut text, size).into_drawing_area();
            let (head, body) = area.split_vertically(HEAD);
            let title = if extent.rows == 0 {
                "no cycles: the trigger has not come".to_owned()
            } else {
                format!(
                    "{} cycles, {} missing; the trigger, at 0, was at {:.6} s",
                    extent.rows,
                    extent.gaps,
                    extent.triggered_ns as f64 / 1e9
                )
            };
            let style = FONT.into_font().color(&BLACK.mix(0.8));
            head.draw_text(&title, &style, (10, 10)).map_err(words)?;
            let panels = body.split_evenly((self.curves.len().max(1), 1));
            let range = (self.from, self.to);
            for ((curve, name), panel) in self.curves.iter_mut().zip(names).zip(&panels) {
                curve.open();
                curve.draw(name, range, panel)?;
            }
            area.present().map_err(words)?;
        }
        Ok(text)
    }
}

fn words(error: impl Display) -> String {
    error.to_string()
}

/// The cycles of a column.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Column {
    number: u64,
    /// Of its first cycle.
    time: f64,
    first: f64,
    least: f64,
    greatest: f64,
    last: f64,
}

/// One value.
#[derive(Default)]
struct Curve {
    /// Lines, between which cycles are missing.
    lines: Vec<Vec<(f64, f64)>>,
    /// The line goes on with this.
    column: Option<Column>,
}

impl Curve {
    fn add(&mut self, number: u64, time: f64, value: f64, gap: bool) {
        if let Some(column) = self.column.as_mut().filter(|column| column.number == number) {
            // A gap within a column is not to be seen.
            column.least = column.least.min(value);
            column.greatest = column.greatest.max(value);
            column.last = value;
            return;
        }
        let before = self.column.map(|column| column.last);
        self.finish_column();
        match (before, self.lines.last_mut()) {
            (Some(before), Some(line)) if !gap => line.push((time, before)),
            _ => self.lines.push(Vec::new()),
        }
        let [first, least, greatest, last] = [value; 4];
        self.column = Some(Column { number, time, first, least, greatest, last });
    }

    /// The line ends here.
    fn open(&mut self) {
        self.finish_column();
        self.column = None;
    }

    fn finish_column(&mut self) {
        let (Some(column), Some(line)) = (self.column, self.lines.last_mut()) else { return };
        let mut values = vec![column.first, column.least, column.greatest, column.last];
        values.dedup();
        line.extend(values.into_iter().map(|value| (column.time, value)));
    }

    fn draw(
        &self,
        name: &str,
        (from, to): (f64, f64),
        panel: &DrawingArea<SVGBackend<'_>, Shift>,
    ) -> Result<(), String> {
        let (bottom, top) = self.range();
        let mut chart = ChartBuilder::on(panel)
            .margin(6)
            .caption(name, FONT)
            .x_label_area_size(22)
            .y_label_area_size(90)
            .build_cartesian_2d(Axis::new(from, to, 10), Axis::new(bottom, top, 3))
            .map_err(words)?;
        chart
            .configure_mesh()
            .label_style(FONT)
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.12))
            .axis_style(BLACK.mix(0.5))
            .x_label_formatter(&|time: &f64| label(*time, to - from) + " s")
            .y_label_formatter(&|value: &f64| label(*value, top - bottom))
            .draw()
            .map_err(words)?;
        let trigger = PathElement::new(vec![(0.0, bottom), (0.0, top)], TRIGGER.mix(0.6));
        chart.draw_series([trigger]).map_err(words)?;
        let lines = self.lines.iter().filter(|line| line.len() > 1);
        let lines = lines.map(|line| PathElement::new(line.clone(), CURVE.stroke_width(1)));
        chart.draw_series(lines).map_err(words)?;
        // A cycle alone is no line.
        let alone = self.lines.iter().filter(|line| line.len() == 1).flatten();
        let alone = alone.map(|at| Circle::new(*at, 1, CURVE.filled()));
        chart.draw_series(alone).map_err(words)?;
        Ok(())
    }

    /// From below the least value to above the greatest: finite, and not empty.
    fn range(&self) -> (f64, f64) {
        let values = || self.lines.iter().flatten().map(|(_, value)| *value);
        let least = values().fold(f64::INFINITY, f64::min);
        let greatest = values().fold(f64::NEG_INFINITY, f64::max);
        if least > greatest {
            return (0.0, 1.0);
        }
        let margin = (greatest - least) * 0.08;
        // Less than this could not be told from the value itself.
        let margin =
            if margin > least.abs() * 1e-9 { margin } else { (least.abs() * 0.1).max(0.5) };
        (least - margin, greatest + margin)
    }
}

/// A number on an axis of this length, with the digits that tell it from its neighbours.
fn label(number: f64, length: f64) -> String {
    if !(1e-6..1e9).contains(&length) {
        return format!("{number:.3e}");
    }
    format!("{number:.0$}", (2.0 - length.log10()).clamp(0.0, 9.0).round() as usize)
}

/// An axis with labels at even distances. The library's own search for round numbers has no end for some ranges.
struct Axis {
    range: RangedCoordf64,
    labels: Vec<f64>,
}

impl Axis {
    fn new(from: f64, to: f64, parts: u32) -> Self {
        let labels = (0..=parts).map(|n| from + (to - from) * f64::from(n) / f64::from(parts));
        Self { range: (from..to).into(), labels: labels.collect() }
    }
}

impl Ranged for Axis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        self.range.map(value, limit)
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.labels.clone()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.range.range()
    }
}

#[cfg(test)]
#[path = "plot_tests.rs"]
mod tests;
