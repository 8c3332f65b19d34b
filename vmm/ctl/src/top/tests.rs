//! The screen of `takt top`, drawn into a buffer.

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use takt_figures::report::Summary;
use takt_protocol::{
    ChannelStatus, Contents, Event, EventKind, ForcedStatus, ImageVersion, Mode, PartitionStatus,
    ProgramState, ProgramStatus, ReleaseStatus, ScheduleStatus, State, Status, TaskState,
    TaskStatus, VersionStatus, WindowStatus,
};

use super::draw;
use super::view::View;

pub fn partition(name: &str, releases: Option<ReleaseStatus>) -> PartitionStatus {
    PartitionStatus {
        name: name.into(),
        kind: "plc".into(),
        cpu: 0,
        background: releases.is_none(),
        state: State::Running,
        start_mode: Mode::Cold,
        end: None,
        restarts: 0,
        cpu_time_ns: 23_000_000,
        cpu_share: 0.023,
        illegal_accesses: 0,
        console_dropped: 0,
        releases,
        programs: vec![],
        forced: vec![],
    }
}

/// After this many half seconds with 500 releases, each as late as `latency` says.
pub fn status(uptime_ns: u64, happened: u64, latency_sum_ns: u64) -> Status {
    let window =
        |offset_ns, duration_ns| WindowStatus { partition: "plc".into(), offset_ns, duration_ns };
    let releases = ReleaseStatus {
        happened,
        start_up_windows: 1,
        lost: 0,
        unrecorded: 0,
        late: 2,
        overruns: 0,
        unfinished_windows: 0,
        latency_sum_ns,
        release_latency_ns: Some(Summary { min: 0, p50: 2, p99: 4, p999: 5, max: 9 }),
        execution_ns: None,
        wake_up_latency_ns: None,
    };
    Status {
        takt: "0.1.0".into(),
        pid: 1,
        system: "demo".into(),
        file: "/demo.toml".into(),
        uptime_ns,
        major_frame_ns: 1_000_000,
        schedule: ScheduleStatus {
            names: vec!["day".into(), "night".into()],
            current: "day".into(),
            next: "night".into(),
            last_switch_ns: None,
            windows: vec![window(0, 250_000), window(500_000, 1_000)],
            windows_left_out: 3,
        },
        partitions: vec![partition("plc", Some(releases)), partition("linux", None)],
        channels: Vec::new(),
    }
}

fn queue(name: &str, contents: Option<Contents>) -> ChannelStatus {
    ChannelStatus {
        name: name.into(),
        kind: "queuing".into(),
        source: "linux:out".into(),
        destinations: vec!["plc:in".into()],
        depth: Some(8),
        refresh_ns: None,
        contents,
        lost: None,
        problem: contents.is_none().then(|| "an end lies\x07".into()),
    }
}

fn sampling(name: &str, age_ns: Option<u64>, valid: bool) -> ChannelStatus {
    let contents =
        Contents { written: 12, waiting: None, overwritten: None, age_ns, valid: Some(valid) };
    ChannelStatus {
        kind: "sampling".into(),
        depth: None,
        refresh_ns: Some(1),
        lost: Some(3),
        ..queue(name, Some(contents))
    }
}

fn event(sequence: u64, text: &str) -> Event {
    let partition = Some("plc".to_owned());
    Event { sequence, at_ns: 1_500_000_000, kind: EventKind::Ended, partition, text: text.into() }
}

pub fn shown(view: &View, width: u16, height: u16) -> Vec<String> {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw::screen(frame, view)).unwrap();
    let buffer = terminal.backend().buffer();
    let line = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    (0..height).map(|y| line(y).trim_end().to_owned()).collect()
}

#[test]
fn the_screen_shows_partitions_windows_latencies_and_events() {
    let mut view = View::default();
    view.status(status(500_000_000, 500, 1_000));
    view.status(status(1_000_000_000, 1_000, 5_000));
    view.event(event(1, "page fault\x1b[2J"));
    let expected = "\
demo: up 1.0 s, schedule \"day\", next \"night\", major frame 1000 us
Tab: values   q: leave
partition  cpu  state    start  CPU    restarts  releases  lost  late  overruns
plc        0    running  cold   2.3 %  0         1000      0     2     0
linux      0    running  cold   2.3 %  0         -         -     -     -

windows of one frame (# window, - background; 3 windows are not shown)
plc    ###################                 #
linux                     ----------------- ------------------------------------

plc: release latency p50 2, p99 4, p99.9 5, max 9 ns; latest mean 8 ns
 #
-#
latest events
       1.500 s  plc: page fault\\u{1b}[2J";
    let shown = shown(&view, 80, 15);
    assert_eq!(shown.join("\n"), expected, "{shown:#?}");
}

#[test]
fn each_channel_has_its_fill_and_its_age() {
    let mut view = View::default();
    let contents = |waiting, overwritten| Contents {
        written: 99,
        waiting: Some(waiting),
        overwritten: Some(overwritten),
        age_ns: Some(2_500_000),
        valid: None,
    };
    let channels = vec![
        queue("orders", Some(contents(3, 0))),
        queue("log", Some(contents(8, 5))),
        queue("lies", None),
        sampling("level", Some(1_234_000_000), true),
        sampling("old", Some(700), false),
        sampling("none", None, false),
    ];
    view.status(Status { channels, ..status(1_000_000_000, 1_000, 5_000) });
    let expected = "\
channel  from       to      fill   newest  written  lost
orders   linux:out  plc:in  3/8    2.5 ms  99       -
log      linux:out  plc:in  8/8    2.5 ms  99       >=5
lies     linux:out  plc:in  ?      -       ?        -
level    linux:out  plc:in  valid  1.2 s   12       3
old      linux:out  plc:in  old    0.7 us  12       3
none     linux:out  plc:in  -      -       12       3
";
    let shown = shown(&view, 80, 24);
    assert_eq!(shown[10..17].join("\n") + "\n", expected, "{shown:#?}");
}

#[test]
fn what_is_forced_is_at_the_top_and_tasks_have_a_row_each() {
    let mut view = View::default();
    let mut status = status(1_000_000_000, 1_000, 5_000);
    let task = TaskStatus {
        name: "main".into(),
        state: TaskState::Waiting,
        jobs: 1_000,
        missed: 0,
        overruns: 2,
        skipped: 0,
        execution_min_ns: None,
        execution_max_ns: 1_500,
        execution_sum_ns: 0,
        response_max_ns: 20_000,
        start_max_ns: 0,
        slack_min_ns: None,
        switches: 0,
    };
    let program = |name: &str, tasks| ProgramStatus {
        name: name.into(),
        state: Some(ProgramState::Running),
        image: None,
        tasks,
    };
    status.partitions[0].programs = vec![program("tank", vec![task]), program("mixer", vec![])];
    status.partitions[0].forced = vec![ForcedStatus {
        name: "tank.valve\r".into(),
        text: "55.5".into(),
        point: [0, 3, 0, 4, 255],
        value: 0,
        since_ns: 7_000_000_000,
    }];
    view.status(status);
    let shown = shown(&view, 90, 24);
    assert_eq!(shown[2], "plc: FORCED tank.valve\\r = 55.5, since 7.000 s");
    let expected = "\
task           state    jobs  missed  overruns  longest  response  slack
plc:tank.main  waiting  1000  0       2         1.5 us   20.0 us   -
plc:mixer      running  -     -       -         -        -         -";
    assert_eq!(shown[11..14].join("\n"), expected, "{shown:#?}");
}

#[test]
fn each_program_has_a_row_with_its_version_and_its_change() {
    let image = |version: &str, digit: &str| ImageVersion {
        version: version.into(),
        hash: digit.repeat(64),
    };
    let version = |program: &str,
                   other: Option<ImageVersion>,
                   phase: &str,
                   reason: Option<&str>| VersionStatus {
        program: program.into(),
        running: image("1.2.0", "a"),
        other,
        phase: phase.into(),
        reason: reason.map(Into::into),
        jobs: 37,
        references_gone: 0,
        took_ns: 0,
        at_ns: 0,
        cycle: 0,
        carried_pages: 0,
        carrying_ns: 0,
    };
    let mut view = View::default();
    view.status(status(1_000_000_000, 1_000, 5_000));
    let versions = vec![
        version("tank", Some(image("1.3.0", "b")), "trial", None),
        version("mixer", None, "none", None),
        version("press", None, "refused", Some("state\x07")),
    ];
    view.versions.insert("plc".into(), versions);
    let expected = "\
program    runs              other             change
plc:tank   1.2.0 (aaaaaaaa)  1.3.0 (bbbbbbbb)  trial, 37 jobs
plc:mixer  1.2.0 (aaaaaaaa)  -                 -
plc:press  1.2.0 (aaaaaaaa)  -                 refused: state\\u{7}";
    let shown = shown(&view, 90, 24);
    assert_eq!(shown[10..14].join("\n"), expected, "{shown:#?}");
    // Those of another run are gone.
    view.status(status(1, 0, 0));
    assert!(view.versions.is_empty());
}

#[test]
fn no_size_of_a_terminal_is_too_small() {
    let mut view = View::default();
    let channels = vec![sampling("level", Some(1), true); 40];
    view.status(Status { channels, ..status(500_000_000, 500, 1_000) });
    (0..300).for_each(|n| view.event(event(n, "x")));
    for width in [0, 1, 2, 7, 79, 300] {
        for height in [0, 1, 3, 9, 12, 100] {
            shown(&view, width, height);
        }
    }
    let empty = shown(&View::default(), 20, 2);
    assert_eq!(empty, ["", ""]);
}

#[test]
fn numbers_that_cannot_be_are_drawn_all_the_same() {
    let mut view = View::default();
    let mut wild = status(u64::MAX, u64::MAX, u64::MAX);
    wild.major_frame_ns = 0;
    wild.schedule.windows[0].offset_ns = u64::MAX;
    wild.schedule.windows[0].duration_ns = u64::MAX;
    wild.partitions[0].cpu_share = f64::NAN;
    wild.partitions[0].releases.as_mut().unwrap().lost = u64::MAX;
    let contents = Contents {
        written: u64::MAX,
        waiting: Some(u64::MAX),
        overwritten: Some(u64::MAX),
        age_ns: Some(u64::MAX),
        valid: Some(true),
    };
    wild.channels = vec![ChannelStatus { lost: Some(u64::MAX), ..queue("\r\n", Some(contents)) }];
    wild.partitions[1].name = "\u{1f600}\r\n".repeat(50);
    view.status(wild.clone());
    view.status(wild);
    shown(&view, 80, 24);
}

#[test]
fn a_sample_is_the_mean_of_what_came_since_the_last() {
    let mut view = View::default();
    view.status(status(1, 500, 1_000));
    view.status(status(2, 1_000, 5_000));
    view.status(status(3, 1_000, 5_000));
    assert_eq!(view.latencies["plc"], [Some(2), Some(8), None], "no release, no mean");
    // Another run: its figures begin anew.
    view.status(status(1, 100, 300));
    assert_eq!(view.latencies["plc"], [Some(3)]);
    // Another one, which is up for longer.
    view.versions.insert("plc".into(), Vec::new());
    view.status(Status { pid: 2, ..status(4, 200, 800) });
    assert_eq!((&view.latencies["plc"], view.versions.len()), (&[Some(4)].into(), 0));
}

#[test]
fn windows_that_are_in_no_figure_are_told_with_the_figures() {
    let mut told = status(1, 1, 1);
    let line = |told: &Status| crate::text::latency(&told.partitions[0]).unwrap();
    assert!(line(&told).ends_with("max 9 ns"), "{}", line(&told));
    told.partitions[0].releases.as_mut().unwrap().unrecorded = 3;
    let missing = "; 3 windows are missing in all of these figures";
    assert!(line(&told).ends_with(missing), "{}", line(&told));
}

#[test]
fn a_plc_without_releases_has_no_latest_mean() {
    let mut view = View::default();
    view.status(status(500_000_000, 500, 1_000));
    view.status(status(1_000_000_000, 1_000, 5_000));
    view.status(status(1_500_000_000, 1_000, 5_000));
    let since_start = "plc: release latency p50 2, p99 4, p99.9 5, max 9 ns";
    let rows = |view: &View| shown(view, 80, 15)[10..13].join("\n");
    assert_eq!(rows(&view), format!("{since_start}; latest mean - ns\n #\n-#"));
    view.status(status(2_000_000_000, 1_500, 9_000));
    assert_eq!(rows(&view), format!("{since_start}; latest mean 8 ns\n # #\n-# #"));
}

#[test]
fn an_old_picture_is_said_to_be_old() {
    let mut view = View::default();
    view.status(status(1, 0, 0));
    view.lost("Takt does not answer".into());
    assert!(shown(&view, 80, 5)[0].starts_with("old: Takt does not answer"));
    view.status(status(2, 0, 0));
    assert!(shown(&view, 80, 5)[0].starts_with("demo: up"));
}
