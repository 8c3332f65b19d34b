//! The progress of a load, from the lines of a console.

use super::*;

const SECOND: u64 = 1_000_000_000;

/// The course of lines that come at these times.
fn course(lines: &[(u64, &str)], end: u64) -> Option<Course> {
    let mut recorder = Recorder::default();
    for (at, line) in lines {
        recorder.add(format!("takt-load: {line}\r\n").as_bytes(), Nanos(*at));
    }
    recorder.course("linux", Nanos(end))
}

#[test]
fn a_course_has_the_beginning_and_each_growth() {
    let lines = [(5, "fork 0 processes"), (10, "fork 0 processes"), (20, "fork 7 processes")];
    let course = course(&lines, 50).unwrap();
    assert_eq!((course.load.as_str(), course.unit.as_str()), ("fork", "processes"));
    assert_eq!(course.points, [(5, 0), (20, 7)]);
    assert_eq!((course.began_ns, course.last_line_ns, course.lines), (5, 20, 3));
    assert_eq!(course.standstill, Standstill { from_ns: 20, to_ns: 50, lines: 0 });
}

#[test]
fn the_longest_standstill_is_known_with_its_lines() {
    let lines = [
        (0, "cpu 0 MiB"),
        (SECOND, "cpu 1 MiB"),
        (2 * SECOND, "cpu 1 MiB"),
        (3 * SECOND, "cpu 1 MiB"),
        (4 * SECOND, "cpu 2 MiB"),
    ];
    let standstill = course(&lines, 5 * SECOND).unwrap().standstill;
    assert_eq!(standstill, Standstill { from_ns: SECOND, to_ns: 4 * SECOND, lines: 2 });
    let to_the_end = course(&lines, 9 * SECOND).unwrap();
    let lasting = Standstill { from_ns: 4 * SECOND, to_ns: 9 * SECOND, lines: 0 };
    assert_eq!(to_the_end.standstill, lasting);
}

#[test]
fn what_comes_after_the_end_of_a_load_is_none_of_it_and_hides_nothing() {
    let mut recorder = Recorder::default();
    let add = |recorder: &mut Recorder, at, count| {
        recorder.add(format!("takt-load: cpu {count} MiB\n").as_bytes(), Nanos(at));
    };
    add(&mut recorder, 0, 0);
    add(&mut recorder, 5 * SECOND, 1);
    add(&mut recorder, 8 * SECOND, 2);
    recorder.end(Nanos(9 * SECOND));
    // Longer than all before, and ended.
    add(&mut recorder, 20 * SECOND, 3);
    recorder.end(Nanos(21 * SECOND));
    let course = recorder.course("linux", Nanos(30 * SECOND)).unwrap();
    assert_eq!(course.standstill, Standstill { from_ns: 0, to_ns: 5 * SECOND, lines: 1 });
    assert_eq!((course.points.len(), course.last_line_ns, course.lines), (3, 8 * SECOND, 3));
}

#[test]
fn nothing_is_recorded_of_a_console_without_a_load() {
    let mut recorder = Recorder::default();
    recorder.add(b"linux# takt-load: \ncompile 3 objects\n", Nanos(1));
    assert_eq!(recorder.course("linux", Nanos(2)), None);
}

#[test]
fn a_load_that_begins_anew_goes_on_from_what_was_done() {
    let lines =
        [(1, "io 0 MiB"), (2, "io 16 MiB"), (3, "io 0 MiB"), (4, "io 0 MiB"), (5, "io 8 MiB")];
    assert_eq!(course(&lines, 6).unwrap().points, [(1, 0), (2, 16), (5, 24)]);
}

#[test]
fn counts_that_go_back_or_overflow_are_no_progress() {
    let lines = [(1, "cpu 9 MiB"), (2, "cpu 5 MiB"), (3, "cpu 6 MiB"), (4, "cpu 10 MiB")];
    assert_eq!(course(&lines, 5).unwrap().points, [(1, 9), (4, 10)]);
    let most = format!("cpu {} MiB", u64::MAX);
    let lines = [(1, "cpu 1 MiB"), (2, &most), (3, "cpu 0 MiB"), (4, "cpu 5 MiB"), (5, &most)];
    let course = course(&lines, 6).unwrap();
    assert_eq!(course.points, [(1, 1), (2, u64::MAX)]);
}

#[test]
fn times_that_go_back_are_survived() {
    let lines = [(9, "cpu 1 MiB"), (3, "cpu 2 MiB"), (2, "cpu 3 MiB"), (10, "cpu 4 MiB")];
    let course = course(&lines, 0).unwrap();
    assert_eq!(course.points, [(9, 3), (10, 4)]);
}

#[test]
fn lines_of_another_load_are_left_out() {
    let lines = [(1, "cpu 1 MiB"), (2, "fork 5 processes"), (3, "cpu 8 lines"), (4, "cpu 2 MiB")];
    let course = course(&lines, 5).unwrap();
    assert_eq!((course.points, course.lines), (vec![(1, 1), (4, 2)], 2));
}

#[test]
fn a_long_run_keeps_its_worst_and_an_even_course() {
    let mut recorder = Recorder::default();
    let mut at = 0;
    let total = 200_000;
    for count in 0..total {
        at += if count == 1_000 { 7 * SECOND } else { SECOND / 2 };
        recorder.add(format!("takt-load: cpu {count} MiB\n").as_bytes(), Nanos(at));
        let points = recorder.kept.as_ref().unwrap().course.points.len();
        assert!(points <= POINTS_MAX, "{points}");
    }
    let course = recorder.course("linux", Nanos(at)).unwrap();
    assert_eq!(course.standstill.duration(), Nanos(7 * SECOND));
    assert_eq!(course.points.last(), Some(&(at, total - 1)));
    assert!(course.points.len() > POINTS_MAX / 4, "{}", course.points.len());
    assert!(course.points.is_sorted_by(|a, b| a.0 < b.0 && a.1 < b.1));
    let widest = course.points.windows(2).map(|pair| pair[1].0 - pair[0].0).max();
    assert!(widest < Some(at / 100), "{widest:?} of {at}");
}

#[test]
fn a_flood_of_lines_at_one_instant_has_one_point() {
    let mut recorder = Recorder::default();
    for count in 0..100_000 {
        recorder.add(format!("takt-load: cpu {count} MiB\n").as_bytes(), Nanos(1));
    }
    let course = recorder.course("linux", Nanos(2)).unwrap();
    assert_eq!((course.points, course.lines), (vec![(1, 99_999)], 100_000));
}
