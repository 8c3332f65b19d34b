//! The page of watched values, drawn into a buffer.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use takt_points::{Kind, Point};
use takt_program::{Elementary, Flags};
use takt_protocol::{Area, ForcedStatus, Range, State, Values};

use super::tests::{shown, status};
use super::view::{Page, View, Watched};

fn point(name: &str, offset: u32, elementary: Elementary, bit: Option<u8>) -> Point {
    let bytes = elementary.bytes() as u16;
    Point {
        name: name.into(),
        type_name: elementary.keyword().into(),
        range: Range { program: 0, area: Area::State, offset, bytes },
        bit,
        kind: Kind::Elementary(elementary),
        flags: Flags::NONE,
    }
}

fn values(cycle: u64) -> Values {
    Values {
        partition: "plc".into(),
        cycle,
        release_ns: cycle * 1_000_000,
        time_ns: 0,
        missed: 0,
        unsettled: 0,
        bytes: String::new(),
    }
}

fn forced(offset: u32, bytes: u32, bit: u32) -> ForcedStatus {
    let (name, text) = ("tank.valve".into(), "55.5".into());
    ForcedStatus { name, text, point: [0, 1, offset, bytes, bit], value: 0, since_ns: 0 }
}

/// A page with a REAL, a BOOL of its own and two bits of one byte.
fn page() -> View {
    let mut view = View { page: Page::Values, ..View::default() };
    view.status(status(1_000_000_000, 1_000, 5_000));
    let points = vec![
        point("tank.level", 0, Elementary::Real, None),
        point("tank.valve", 4, Elementary::Bool, None),
        point("tank.low", 8, Elementary::Bool, Some(0)),
        point("tank.high", 8, Elementary::Bool, Some(1)),
    ];
    view.watched = vec![Watched { partition: "plc".into(), points, latest: None }];
    view
}

fn texts(texts: [&str; 4]) -> Vec<String> {
    texts.map(str::to_owned).to_vec()
}

#[test]
fn the_values_of_a_partition_stand_below_their_cycle_and_forced_ones_are_marked() {
    let mut view = page();
    view.watched[0].latest = Some((values(10_001), texts(["1.25", "TRUE", "FALSE", "TRUE"])));
    let partition = &mut view.status.as_mut().unwrap().partitions[0];
    partition.forced = vec![forced(4, 1, 255), forced(8, 1, 1)];
    let expected = "\
demo: up 1.0 s, schedule \"day\", next \"night\", major frame 1000 us
Tab: overview   Up, Down, PageUp, PageDown, Home, End: move   q: leave
plc: cycle 10001, 10.001 s
value       type  now
tank.level  REAL  1.25
tank.valve  BOOL  TRUE   FORCED
tank.low    BOOL  FALSE
tank.high   BOOL  TRUE   FORCED";
    assert_eq!(shown(&view, 100, 12)[..8].join("\n"), expected);
}

#[test]
fn before_the_first_line_and_after_a_gap_the_title_says_so() {
    let mut view = page();
    let drawn = shown(&view, 60, 12);
    assert_eq!(drawn[2], "plc: no line has come yet");
    assert_eq!(drawn[4], "tank.level  REAL  -");
    let line = Values { missed: 3, unsettled: 1, ..values(7) };
    view.watched[0].latest = Some((line, texts(["1", "TRUE", "TRUE", "TRUE"])));
    let title = "plc: cycle 7, 0.007 s; 3 missed before; in the middle of something";
    assert_eq!(shown(&view, 80, 12)[2], title);
    view.values_problem = Some("refused: values of tank\x1b are watched no longer".into());
    let drawn = shown(&view, 80, 12);
    assert_eq!(drawn[2], "old: refused: values of tank\\u{1b} are watched no longer");
    assert_eq!(drawn[3], title, "the last values stay");
}

#[test]
fn values_of_a_plc_that_does_not_run_are_said_to_be_old() {
    let mut view = page();
    view.watched[0].latest = Some((values(7), texts(["1", "TRUE", "TRUE", "TRUE"])));
    let mut title = |state, uptime_ns| {
        let status = view.status.as_mut().unwrap();
        (status.partitions[0].state, status.uptime_ns) = (state, uptime_ns);
        let drawn = shown(&view, 80, 12);
        let head = if drawn[2].contains("OLD") {
            "value       type  last"
        } else {
            "value       type  now"
        };
        assert_eq!(drawn[3], head);
        drawn[2].clone()
    };
    let of_now = "plc: cycle 7, 0.007 s";
    assert_eq!(title(State::Running, 1), of_now, "the line is newer than the status");
    // 2 s, and the major frame of 1 ms.
    assert_eq!(title(State::Running, 2_008_000_000), of_now);
    let left_out = "plc: OLD, no values for 2.0 s; cycle 7, 0.007 s";
    assert_eq!(title(State::Running, 2_008_000_001), left_out);
    for (state, word) in [
        (State::Stopping, "stopping"),
        (State::Restarting, "restarting"),
        (State::Stopped, "stopped"),
        (State::Ended, "ended"),
    ] {
        let expected = format!("plc: OLD, the partition is {word}; cycle 7, 0.007 s");
        assert_eq!(title(state, 8_000_000), expected);
    }
    view.watched[0].latest = None;
    assert_eq!(
        shown(&view, 80, 12)[2..4].join("|"),
        "plc: no line has come yet|value       type  now"
    );
}

#[test]
fn a_page_without_values_says_how_to_name_some() {
    let view = View { watched: Vec::new(), ..page() };
    let drawn = shown(&view, 80, 6);
    assert!(
        drawn[2].contains("no values are watched") && drawn[3].contains("--watch"),
        "{drawn:?}"
    );
}

#[test]
fn keys_turn_the_page_and_move_to_the_last_value_and_no_further() {
    let mut view = page();
    let points = (0..100).map(|i| point(&format!("tank.row[{i}]"), i, Elementary::Sint, None));
    view.watched[0].points = points.collect();
    let key = |code| KeyEvent::new(code, KeyModifiers::NONE);
    let first = |view: &View| shown(view, 40, 12)[2].clone();
    for (code, line) in [
        (KeyCode::Down, "value         type  now"),
        (KeyCode::Down, "tank.row[0]   SINT  -"),
        (KeyCode::PageDown, "tank.row[9]   SINT  -"),
        (KeyCode::Up, "tank.row[8]   SINT  -"),
        (KeyCode::End, "tank.row[91]  SINT  -"),
        (KeyCode::Down, "tank.row[91]  SINT  -"),
        (KeyCode::Home, "plc: no line has come yet"),
        (KeyCode::PageUp, "plc: no line has come yet"),
    ] {
        super::scroll(&mut view, &key(code), 12);
        assert_eq!(first(&view), line, "{code:?}");
    }
    assert!(super::turns(&key(KeyCode::Tab)) && !super::turns(&key(KeyCode::Char('v'))));
    view.turn();
    assert_eq!(shown(&view, 100, 12)[1], "Tab: values   q: leave");
    view.turn();
    assert_eq!(view.page, Page::Values);
}

#[test]
fn no_size_of_a_terminal_is_too_small_and_no_line_too_short() {
    let mut view = page();
    view.watched[0].latest = Some((values(u64::MAX / 1_000_000), Vec::new()));
    view.values_problem = Some("x".into());
    view.scrolled = usize::MAX;
    for width in [0, 1, 7, 300] {
        for height in [0, 1, 2, 3, 100] {
            shown(&view, width, height);
        }
    }
}
