//! The plots, as SVG.
//!
//! No text in them comes from a file, only numbers do. Whatever the numbers are, each axis gets a
//! range that is finite and not empty, since the drawing library panics at any other.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{DefaultFormatting, KeyPointHint, Ranged};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use takt_figures::samples::{Point, Range};

use crate::axis::{Axis, digits};
use crate::distribution::{Bin, Distribution};
use crate::error::JitterError;

const SIZE: (u32, u32) = (900, 300);
const BAR: RGBColor = RGBColor(0x2b, 0x6c, 0xb0);
const LINE: RGBColor = RGBColor(0x1a, 0x3f, 0x66);
const AXIS_FONT: (&str, u32) = ("sans-serif", 13);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Draws into a new SVG.
fn svg(draw: impl FnOnce(&Area<'_>) -> Result<(), String>) -> Result<String, JitterError> {
    let mut text = String::new();
    {
        let area = SVGBackend::with_string(&mut text, SIZE).into_drawing_area();
        draw(&area).and_then(|()| area.present().map_err(words)).map_err(JitterError::Plot)?;
    }
    Ok(text)
}

fn words(error: impl std::fmt::Display) -> String {
    error.to_string()
}

/// How many releases were how late.
pub fn histogram(distribution: &Distribution) -> Result<String, JitterError> {
    let axis = Axis::of(distribution);
    let bins: Vec<Bin> = axis.bins(distribution).into_iter().filter(|bin| bin.count > 0).collect();
    let most = bins.iter().map(|bin| bin.count).max().unwrap_or(1) as f64;
    // Half a release is the ground: one must be seen.
    let (ground, top) = (0.5f64.log10(), (most * 1.5).max(15.0).log10());
    let counts = decades(top);
    svg(|area| {
        let mut chart = chart(area)
            .build_cartesian_2d(
                Labelled::new(axis.from..axis.to, axis.ticks.clone()),
                Labelled::new(ground..top, counts),
            )
            .map_err(words)?;
        let mut mesh = chart.configure_mesh();
        style(&mut mesh);
        mesh.x_desc("start after the release")
            .y_desc("releases")
            .x_label_formatter(&|place: &f64| axis.label(*place))
            .y_label_formatter(&|height: &f64| format!("{:.0}", 10f64.powf(*height)))
            .draw()
            .map_err(words)?;
        let bars = bins.iter().map(|bin| {
            let corner = (axis.edge(bin.to), (bin.count as f64).log10());
            Rectangle::new([(axis.edge(bin.from), ground), corner], BAR.filled())
        });
        chart.draw_series(bars).map_err(words)?;
        Ok(())
    })
}

/// What part of the releases was at most how late. Each step up is ten times fewer that are later.
pub fn cumulative(distribution: &Distribution) -> Result<String, JitterError> {
    let axis = Axis::of(distribution);
    let total = distribution.total() as f64;
    // No release lies beyond the last: it is drawn as half a release short of all.
    let nines = |below: u64| -((total - below as f64).max(0.5) / total).log10();
    let top = nines(distribution.total()).max(1.0) * 1.05;
    let mut line = vec![(axis.from, 0.0)];
    let mut height = 0.0;
    for (value, below) in distribution.cumulative() {
        let at = axis.place(value);
        line.push((at, height));
        height = nines(below);
        line.push((at, height));
    }
    line.push((axis.to, height));
    svg(|area| {
        let mut chart = chart(area)
            .build_cartesian_2d(
                Labelled::new(axis.from..axis.to, axis.ticks.clone()),
                Labelled::new(0.0..top, decades(top)),
            )
            .map_err(words)?;
        let mut mesh = chart.configure_mesh();
        style(&mut mesh);
        mesh.x_desc("start after the release")
            .y_desc("part of the releases")
            .x_label_formatter(&|place: &f64| axis.label(*place))
            .y_label_formatter(&|height: &f64| share(*height))
            .draw()
            .map_err(words)?;
        chart.draw_series([PathElement::new(line, LINE.stroke_width(2))]).map_err(words)?;
        Ok(())
    })
}

/// The course of a quantity: a band from the least to the greatest value of each point; `None` if
/// there is nothing to draw.
pub fn course(
    points: &[Point],
    what: &str,
    pick: impl Fn(&Point) -> Option<Range>,
) -> Result<Option<String>, JitterError> {
    let values: Vec<(f64, Range)> =
        points.iter().filter_map(|p| Some((p.at_ns as f64 / 1e9, pick(p)?))).collect();
    let (Some((start, _)), Some((end, _))) = (values.first(), values.last()) else {
        return Ok(None);
    };
    let us = |ns: u64| ns as f64 / 1e3;
    let least = values.iter().map(|(_, range)| us(range.0)).fold(f64::INFINITY, f64::min);
    let greatest = values.iter().map(|(_, range)| us(range.1)).fold(0.0, f64::max);
    // At least 20 ns: the clock's resolution is no drama.
    let span = (greatest - least).max(0.02);
    let (bottom, top) = ((least - 0.08 * span).max(0.0), greatest + 0.08 * span);
    let (start, end) = (start.min(*end), end.max(start + 1e-6));
    let digits = digits(top - bottom);
    let upper = values.iter().map(|(at, range)| (*at, us(range.1)));
    let lower = values.iter().map(|(at, range)| (*at, us(range.0)));
    svg(|area| {
        let mut chart = chart(area).build_cartesian_2d(start..end, bottom..top).map_err(words)?;
        let mut mesh = chart.configure_mesh();
        style(&mut mesh);
        mesh.x_desc("time, in s")
            .y_desc(format!("{what}, in us"))
            .y_label_formatter(&|us: &f64| format!("{us:.digits$}"))
            .draw()
            .map_err(words)?;
        let outline: Vec<_> = upper.clone().chain(lower.clone().rev()).collect();
        chart.draw_series([Polygon::new(outline, BAR.mix(0.35).filled())]).map_err(words)?;
        for edge in [upper.collect::<Vec<_>>(), lower.collect()] {
            chart.draw_series([PathElement::new(edge, LINE.stroke_width(1))]).map_err(words)?;
        }
        Ok(())
    })
    .map(Some)
}

/// The progress of a load: what had been done when, over the whole run.
pub fn progress(points: &[(u64, u64)], duration_ns: u64) -> Result<String, JitterError> {
    let seconds = |ns: u64| ns as f64 / 1e9;
    let last = points.iter().map(|(at, _)| seconds(*at)).fold(0.0, f64::max);
    let end = seconds(duration_ns).max(last).max(1e-6);
    let top = points.iter().map(|(_, count)| *count as f64).fold(1.0, f64::max) * 1.08;
    let done = points.last().map_or(0.0, |(_, count)| *count as f64);
    // What was told last holds until something else is told.
    let line = points.iter().map(|(at, count)| (seconds(*at), *count as f64));
    let line: Vec<_> = line.chain([(end, done)]).collect();
    svg(|area| {
        let mut chart = chart(area).build_cartesian_2d(0.0..end, 0.0..top).map_err(words)?;
        let mut mesh = chart.configure_mesh();
        style(&mut mesh);
        mesh.x_desc("time, in s")
            .y_desc("done")
            .y_label_formatter(&|count: &f64| format!("{count:.0}"))
            .draw()
            .map_err(words)?;
        chart.draw_series([PathElement::new(line.clone(), LINE.stroke_width(2))]).map_err(words)?;
        let dots = line.iter().take(points.len()).map(|at| Circle::new(*at, 2, BAR.filled()));
        chart.draw_series(dots).map_err(words)?;
        Ok(())
    })
}

/// A range with labels at given places.
struct Labelled {
    range: RangedCoordf64,
    labels: Vec<f64>,
}

impl Labelled {
    fn new(range: std::ops::Range<f64>, labels: Vec<f64>) -> Self {
        Self { range: range.into(), labels }
    }
}

impl Ranged for Labelled {
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

fn chart<'a, 'b>(area: &'a Area<'b>) -> ChartBuilder<'a, 'b, SVGBackend<'b>> {
    let mut builder = ChartBuilder::on(area);
    builder.margin(8).x_label_area_size(42).y_label_area_size(84);
    builder
}

fn style<X, Y>(mesh: &mut plotters::chart::MeshStyle<'_, '_, X, Y, SVGBackend<'_>>)
where
    X: Ranged,
    Y: Ranged,
{
    mesh.label_style(AXIS_FONT).axis_desc_style(AXIS_FONT).light_line_style(TRANSPARENT);
    mesh.bold_line_style(BLACK.mix(0.12)).axis_style(BLACK.mix(0.5));
}

/// Whole numbers from 0 up to `top`: the decades of a logarithmic axis.
fn decades(top: f64) -> Vec<f64> {
    (0..=40u32).map(f64::from).take_while(|n| *n <= top).collect()
}

/// The label at a height that stands for so many nines.
fn share(height: f64) -> String {
    match height.round() as i64 {
        0 => "0 %".into(),
        1 => "90 %".into(),
        2 => "99 %".into(),
        n => format!("99.{} %", "9".repeat(usize::try_from(n - 2).unwrap_or(0).min(12))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(counts: &[(u64, u64)]) -> Distribution {
        Distribution::new(counts).unwrap()
    }

    fn point(at_ns: u64, least: u64, greatest: u64) -> Point {
        let range = Range(least, greatest);
        Point {
            release: 0,
            at_ns,
            releases: 1,
            latency_ns: range,
            execution_ns: Some(range),
            interval_ns: None,
            donated_ns: range,
        }
    }

    #[test]
    fn any_distribution_can_be_drawn() {
        for counts in [
            &[(0, 1)][..],
            &[(0, u64::MAX)],
            &[(1, 1)],
            &[(u64::MAX, 1)],
            &[(0, 1), (u64::MAX, u64::MAX)],
            &[(5_200, 3), (6_100, 4)],
        ] {
            for svg in [histogram(&of(counts)).unwrap(), cumulative(&of(counts)).unwrap()] {
                assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
                assert!(!svg.contains("NaN") && !svg.contains("inf"), "{counts:?}: {svg}");
            }
        }
    }

    #[test]
    fn a_bin_with_releases_is_a_bar() {
        let bars =
            |counts: &[(u64, u64)]| histogram(&of(counts)).unwrap().matches("#2B6CB0").count();
        assert_eq!((bars(&[(0, 9)]), bars(&[(0, 9), (2, 1), (700, 1)])), (1, 3));
    }

    #[test]
    fn any_course_can_be_drawn_and_none_is_not() {
        let pick = |p: &Point| Some(p.latency_ns);
        assert!(course(&[], "x", pick).unwrap().is_none());
        assert!(course(&[point(0, 1, 2)], "x", |p| p.interval_ns).unwrap().is_none());
        for points in [
            &[point(0, 0, 0)][..],
            &[point(5, 1_000_000, 1_000_004), point(6, 999_998, 1_000_000)],
            &[point(u64::MAX, u64::MAX, 0), point(0, 0, u64::MAX)],
        ] {
            let svg = course(points, "x", pick).unwrap().unwrap();
            assert!(svg.contains("polygon") && !svg.contains("NaN"), "{points:?}: {svg}");
        }
    }

    #[test]
    fn any_progress_can_be_drawn() {
        for (points, duration) in [
            (&[][..], 0),
            (&[(0, 0)], 0),
            (&[(1, 0), (2, u64::MAX)], u64::MAX),
            (&[(u64::MAX, 7), (0, 3)], 5),
        ] {
            let svg = progress(points, duration).unwrap();
            assert_eq!(svg.matches("<circle").count(), points.len(), "{svg}");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{points:?}: {svg}");
        }
    }

    #[test]
    fn labels_say_what_they_stand_for() {
        assert_eq!([0.0, 1.0, 2.0, 4.0].map(share), ["0 %", "90 %", "99 %", "99.99 %"]);
    }
}
