use super::*;

const MS: u64 = 1_000_000;

/// A picture of one value from 0 to 100 ms, of these cycles: instant in ms, gap, value.
fn plot(cycles: &[(u64, bool, f64)]) -> Plot {
    let mut plot = Plot::new(1, Nanos(0), Nanos(100 * MS));
    for (at, gap, value) in cycles {
        plot.row(5_000 * MS + at * MS, 5_000 * MS, *gap, [Some(*value)].into_iter());
    }
    plot.curves[0].open();
    plot
}

#[test]
fn a_value_holds_until_the_next_cycle_and_a_gap_opens_the_line() {
    let plot = plot(&[(0, false, 1.0), (10, false, 2.0), (50, true, 3.0)]);
    let lines = [vec![(0.0, 1.0), (0.01, 1.0), (0.01, 2.0)], vec![(0.05, 3.0)]];
    assert_eq!(plot.curves[0].lines, lines);
}

#[test]
fn a_column_keeps_its_peaks_and_the_memory_is_bounded() {
    let mut plot = Plot::new(1, Nanos(0), Nanos(1_000 * MS));
    for cycle in 0..100_000u64 {
        let value = if cycle == 77_777 { 9.0 } else { (cycle % 3) as f64 };
        plot.row(cycle * 10_000, 0, cycle % 2 == 0, [Some(value)].into_iter());
    }
    plot.curves[0].open();
    let points: usize = plot.curves[0].lines.iter().map(Vec::len).sum();
    assert!(points < 5 * 1_000, "{points}");
    assert!(plot.curves[0].lines.iter().flatten().any(|(_, value)| *value == 9.0));
}

#[test]
fn whatever_the_values_are_a_picture_comes_of_it() {
    let hostile =
        [f64::NAN, f64::INFINITY, f64::MIN, f64::MAX, 0.0, -0.0, f64::MIN_POSITIVE, 1e300];
    for first in hostile {
        for second in hostile {
            let mut plot = plot(&[(0, false, first), (50, false, second), (90, true, first)]);
            let svg = plot.draw(&["a<b>&c"], &Extent::default()).unwrap();
            assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"), "{svg}");
            assert!(!svg.contains("a<b>") && !svg.contains("NaN"), "{first} {second}: {svg}");
        }
    }
}

#[test]
fn times_that_lie_and_no_cycle_at_all_are_drawn_too() {
    let mut plot = Plot::new(2, Nanos(0), Nanos(0));
    for (release, triggered) in [(u64::MAX, 0), (0, u64::MAX), (5, 5)] {
        plot.row(release, triggered, false, [Some(1.0), None].into_iter());
    }
    assert!(plot.draw(&["a", "b"], &Extent::default()).is_ok());
    assert!(Plot::new(0, Nanos(0), Nanos(1)).draw(&[], &Extent::default()).is_ok());
    let longest =
        Plot::new(1, Nanos(60_000 * MS), Nanos(u64::MAX)).draw(&["a"], &Extent::default());
    assert!(longest.is_ok_and(|svg| svg.contains("no cycles: the trigger has not come")));
}
