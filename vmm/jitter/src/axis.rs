//! The axis of the latencies.
//!
//! Logarithmic where the values spread over more than a decade, so that an outlier does not press all
//! the others into one bar; otherwise linear, since a logarithmic axis without two decades has hardly
//! a label and hides what there is to see.

use crate::distribution::{Bin, Distribution, medium};

/// Where 0 is on a logarithmic axis: one bin left of 1.
const ZERO: f64 = 0.5;
/// Below, each value has its own place on a linear axis.
const FEW_NS: u64 = 30;
/// Bars of a linear axis.
const BARS: u64 = 60;

/// An axis; what it calls a place is where plots have their values.
#[derive(Debug)]
pub struct Axis {
    logarithmic: bool,
    /// The left end.
    pub from: f64,
    /// The right end.
    pub to: f64,
    /// Places with a label.
    pub ticks: Vec<f64>,
}

impl Axis {
    /// An axis for these values, in nanoseconds.
    pub fn of(distribution: &Distribution) -> Self {
        let (min, max) = (distribution.min(), distribution.max());
        if max < FEW_NS || max / 10 <= min {
            // Beyond 2^53 a half is lost, and with it the room of a single value.
            let (from, to) = (min as f64 - 0.5, (max as f64 + 0.5).max(min as f64 * (1.0 + 1e-9)));
            return Self { logarithmic: false, from, to, ticks: round(from, to) };
        }
        let (from, to) = (place(min).log10(), (max as f64 + 1.0).log10());
        // Where there are few decades, some values in between have a label too.
        let factors: &[f64] = if to - from < 2.5 { &[1.0, 2.0, 5.0] } else { &[1.0] };
        let ticks = (0..20).flat_map(|n| factors.iter().map(move |f| (f * 10f64.powi(n)).log10()));
        let mut ticks: Vec<f64> = ticks.filter(|tick| (from..=to).contains(tick)).collect();
        if min == 0 {
            ticks.insert(0, ZERO.log10() / 2.0);
        }
        Self { logarithmic: true, from, to, ticks }
    }

    /// The bars of a histogram.
    pub fn bins(&self, distribution: &Distribution) -> Vec<Bin> {
        if self.logarithmic {
            return distribution.bins(medium());
        }
        let (min, max) = (distribution.min(), distribution.max());
        let width = (max - min) / BARS + 1;
        let before = (min > 0).then_some(0);
        let edges = (0..=BARS).map(|n| min.saturating_add(n.saturating_mul(width)));
        distribution.bins(before.into_iter().chain(edges))
    }

    /// Where a value is.
    pub fn place(&self, ns: u64) -> f64 {
        let place = if self.logarithmic { place(ns).log10() } else { ns as f64 };
        place.clamp(self.from, self.to)
    }

    /// Where the first value of a bar begins. On a linear axis a value is the middle of its place.
    pub fn edge(&self, ns: u64) -> f64 {
        let edge = if self.logarithmic { place(ns).log10() } else { ns as f64 - 0.5 };
        edge.clamp(self.from, self.to)
    }

    /// What is written at a place.
    pub fn label(&self, place: f64) -> String {
        if self.logarithmic {
            let ns = 10f64.powf(place);
            return if ns < 0.9 { "0".into() } else { time(ns, 0) };
        }
        let scale = unit(place).0;
        // No time is shorter than a nanosecond.
        time(place, digits((self.to - self.from) / scale).min(scale.log10() as usize))
    }
}

fn place(ns: u64) -> f64 {
    if ns == 0 { ZERO } else { ns as f64 }
}

/// Up to ten places between two, at round values.
fn round(from: f64, to: f64) -> Vec<f64> {
    let least = (to - from) / 8.0;
    let decade = 10f64.powf(least.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|f| f * decade).into_iter().find(|step| *step >= least);
    let step = step.unwrap_or(least).max(1.0);
    let first = (from / step).ceil() * step;
    (0..10u32).map(|n| first + f64::from(n) * step).take_while(|tick| *tick <= to).collect()
}

/// The unit that a time is written in, in nanoseconds.
fn unit(ns: f64) -> (f64, &'static str) {
    match ns {
        _ if ns < 1e3 => (1.0, "ns"),
        _ if ns < 1e6 => (1e3, "us"),
        _ if ns < 1e9 => (1e6, "ms"),
        _ => (1e9, "s"),
    }
}

fn time(ns: f64, digits: usize) -> String {
    // A power of ten may come out a little short.
    let ns = if digits == 0 { ns.round() } else { ns };
    let (scale, name) = unit(ns);
    format!("{:.digits$} {name}", ns / scale)
}

/// Digits behind the point that tell the labels of an axis of this length apart.
pub fn digits(span: f64) -> usize {
    let step = (span / 10.0).max(1e-6);
    (-step.log10()).ceil().clamp(0.0, 6.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(values: &[u64]) -> (Axis, Distribution) {
        let counts: Vec<_> = values.iter().map(|value| (*value, 1)).collect();
        let distribution = Distribution::new(&counts).unwrap();
        (Axis::of(&distribution), distribution)
    }

    fn labels(values: &[u64]) -> Vec<String> {
        let (axis, _) = of(values);
        axis.ticks.iter().map(|tick| axis.label(*tick)).collect()
    }

    #[test]
    fn an_axis_has_the_labels_that_its_values_need() {
        assert_eq!(labels(&[0, 4]), ["0 ns", "1 ns", "2 ns", "3 ns", "4 ns"]);
        assert_eq!(
            labels(&[5_600, 6_350]),
            [
                "5.60 us", "5.70 us", "5.80 us", "5.90 us", "6.00 us", "6.10 us", "6.20 us",
                "6.30 us"
            ]
        );
        assert_eq!(labels(&[0, 90]), ["0", "1 ns", "2 ns", "5 ns", "10 ns", "20 ns", "50 ns"]);
        let wide = ["0", "1 ns", "10 ns", "100 ns", "1 us", "10 us", "100 us", "1 ms"];
        assert_eq!(labels(&[0, 4_000_000]), wide);
    }

    #[test]
    fn any_values_have_an_axis_with_room_and_bars_for_all() {
        const MAX: u64 = u64::MAX;
        for values in
            [&[0][..], &[1], &[MAX], &[0, MAX], &[MAX - 1, MAX], &[29], &[30], &[3, 30], &[3, 31]]
        {
            let (axis, distribution) = of(values);
            assert!(axis.from < axis.to && axis.to.is_finite(), "{values:?}: {axis:?}");
            assert!(axis.ticks.iter().all(|tick| (axis.from..=axis.to).contains(tick)), "{axis:?}");
            let bins = axis.bins(&distribution);
            let count: u64 = bins.iter().map(|bin| bin.count).sum();
            assert_eq!(count, values.len() as u64, "{values:?}: {bins:?}");
            assert!(bins.iter().all(|bin| axis.edge(bin.from) <= axis.edge(bin.to)));
        }
    }

    #[test]
    fn digits_are_as_many_as_labels_need() {
        assert_eq!([digits(0.01), digits(10.0), digits(500.0)], [3, 0, 0]);
    }
}
