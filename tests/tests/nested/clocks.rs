//! A host whose clock is not the time-stamp counter: releases lie on the counter, and the kernel sleeps by
//! a clock that NTP steers, by 10 % if it is told to (`ADJ_TICK` of adjtimex(2)).

use std::path::PathBuf;

use takt_tests::{BUSY, File, Host, Outcome, Value, long, plc_image, target};

/// Frames in us: windows and sleeps that are shorter and longer than each of the pieces of a sleep.
const FRAMES: [u64; 4] = [1_000, 10_000, 100_000, 1_000_000];

/// Lengths of the kernel's tick: 500 ppm and 10 % faster and slower than nominal, and changes of the rate
/// during the run.
const STEERINGS: [&[u32]; 7] = [
    &[10_005],
    &[9_995],
    &[11_000],
    &[9_000],
    &[10_000, 10_005, 9_995, 10_005],
    &[9_000, 11_000, 9_000, 10_833, 10_000],
    &[10_000, 9_000, 11_000, 9_995, 9_000],
];

/// How late a kick may be: what it takes in the lab without steering, 16 us, and the last piece of a
/// sleep under a clock that is slower by 10 %.
const KICK_NS: u64 = 40_000;

/// A machine with what a Linux needs.
fn machine() -> Host {
    let files = ["guest/vmlinuz", "guest/initrd.img"].map(target);
    let host = Host::new().with("--memory", "768").with("--clock", "steered");
    files.iter().fold(host, |host, file| host.with_file(file))
}

/// A run under a steered clock.
struct Steered {
    frame: u64,
    ticks: &'static [u32],
}

impl Steered {
    fn file(&self) -> PathBuf {
        let frame = self.frame;
        let ticks: Vec<String> = self.ticks.iter().map(u32::to_string).collect();
        let name = format!("clocks-{frame}-{}", ticks.join("-"));
        File::new(&format!("{frame}us"))
            .plc("runaway", Some(plc_image("never-done")), "")
            .plc("good", None, "")
            .linux(BUSY)
            .schedule("normal")
            .window("runaway", 0, frame / 5)
            .window("good", frame / 2, frame / 10)
            .save(&name)
    }

    /// Whether a clock that was as it should be changes its rate by a tenth where the sleep of who ends
    /// windows is not divided. A partition's thread finds that before its own wake-up and says so: what has
    /// passed since then, with a window and its guard, is felt once, by a ninth.
    fn has_a_first_step(&self) -> bool {
        let by_a_tenth = |tick: &u32| tick.abs_diff(10_000) > 100;
        self.frame <= 2_000 && self.ticks[0] == 10_000 && self.ticks.iter().any(by_a_tenth)
    }

    /// In seconds: long enough for a Linux, and for some frames.
    fn seconds(&self) -> u64 {
        if self.frame < 1_000_000 { 4 } else { 6 }
    }

    fn assert_kept_time(&self, outcome: &Outcome) {
        let context = format!("{} us, ticks {:?}\n{}", self.frame, self.ticks, outcome.output);
        assert_eq!(outcome.status, 0, "{context}");
        let frames = self.seconds() * 1_000_000 / self.frame;
        // A scan that began before its release would be a release that is lost.
        let of = |partition: &str, key: &str| outcome.number(partition, key);
        let kick = match self.has_a_first_step() {
            false => KICK_NS,
            true => KICK_NS + (self.frame * 1_000 / 5 + 20_000 + 112_000) / 9,
        };
        for key in ["lost", "late_releases", "overruns", "unrecorded"] {
            assert_eq!(of("good", key), 0, "{key} of {context}");
        }
        assert!(of("good", "releases") + 3 >= frames, "{context}");
        assert!(of("good", "release_latency_ns.p50") <= 10, "{context}");
        assert!(of("runaway", "overruns") + 3 >= frames, "{context}");
        for key in ["overrun_ns.max", "kick_ns.max"] {
            assert!(of("runaway", key) <= kick, "{key} of {context}");
        }
        let booted = outcome.partition("linux")["boot_to_init_ns"].is_u64();
        assert!(booted && outcome.received("linux") >= 0.9, "Linux did not run: {context}");
    }
}

#[test]
fn windows_and_releases_are_where_they_were_under_any_steering_of_the_clock() {
    let all = || {
        let frames = FRAMES.into_iter();
        frames.flat_map(|frame| STEERINGS.map(move |ticks| Steered { frame, ticks }))
    };
    let short = [(1_000, 6), (10_000, 5), (100_000, 2)];
    let short = short.map(|(frame, place)| Steered { frame, ticks: STEERINGS[place] });
    let runs: Vec<Steered> = if long() { all().collect() } else { short.into() };
    let files: Vec<PathBuf> = runs.iter().map(Steered::file).collect();
    let lines = runs.iter().zip(&files).map(|(run, file)| {
        let ticks: Vec<String> = run.ticks.iter().map(u32::to_string).collect();
        format!("{} {}s {}", file.display(), run.seconds(), ticks.join(" "))
    });
    let lines: Vec<String> = lines.collect();
    let host = machine().with_file(&plc_image("never-done"));
    for (run, outcome) in runs.iter().zip(host.run_lines("clocks", &lines, &files)) {
        run.assert_kept_time(&outcome);
    }
}

/// What follows from a `clock-fault` of a PLC, by its action in the file: the event's, if there is one,
/// whether the PLC runs at the end, and its starts.
const FOLLOWS: [(&str, Option<&str>, bool, u64); 5] = [
    ("ignore", None, true, 0),
    ("log", Some("log"), true, 0),
    ("idle", Some("idle"), false, 0),
    ("cold-start", Some("cold-start"), true, 1),
    ("warm-start", Some("warm-start"), true, 1),
];

/// A PLC for each action, beside a Linux of which nothing is said.
fn with_actions(name: &str, actions: &[&str]) -> PathBuf {
    let mut file = File::new("10ms");
    for action in actions {
        file = file.plc(action, None, "");
    }
    file = file.linux(BUSY);
    for action in actions {
        file = file.health(action, "clock-fault", action);
    }
    file = file.schedule("normal");
    for (place, action) in (0..).zip(actions) {
        file = file.window(action, 1_000 * place, 300);
    }
    file.save(name)
}

#[test]
fn a_clock_source_that_is_taken_away_in_mid_run_is_an_error_of_each_partition() {
    let actions: Vec<&str> = FOLLOWS.iter().map(|(action, ..)| *action).collect();
    let files = [
        with_actions("clock-fault", &actions),
        with_actions("clock-fault-ends-the-run", &["log", "shut-down"]),
    ];
    let lines: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    let outcomes = machine().run_lines("clock-source", &lines, &files);
    let [all, ended] = &outcomes[..] else { panic!("two runs") };

    // The clock source goes a second after the command, by a clock from which the loading of Takt is
    // missing in the report. It is seen within another second.
    let in_time = |outcome: &Outcome, since_epoch: &Value| {
        let first = outcome.report["process"]["starting"]["first_release_ns"].as_u64();
        let at = since_epoch.as_u64().zip(first).map_or(0, |(at, first)| at + first);
        assert!((990_000_000..2_000_000_000).contains(&at), "{at} ns\n{}", outcome.output);
    };
    let seen_in_time = |outcome: &Outcome, partition: &str| {
        in_time(outcome, &outcome.partition(partition)["events"]["list"][0]["at_ns"]);
    };
    // One partition has ended by an error.
    assert_eq!(all.status, 4, "{}", all.output);
    all.assert_shows("[takt] the host's clock has turned bad: the kernel's clock source is \"");
    for (partition, event, runs, starts) in FOLLOWS {
        let of = all.partition(partition);
        let context = || format!("{partition}: {of:#}\n{}", all.output);
        assert_eq!(of["events"]["totals"]["clock-fault"], 1, "{}", context());
        let list = of["events"]["list"].as_array().map_or(&[][..], Vec::as_slice);
        let told: Vec<_> =
            list.iter().map(|e| (e["error"].as_str(), e["action"].as_str())).collect();
        let expected: Vec<_> = event.iter().map(|e| (Some("clock-fault"), Some(*e))).collect();
        assert_eq!(told, expected, "{}", context());
        event.inspect(|_| seen_in_time(all, partition));
        assert_eq!(of["end"] == "stopped by takt", runs, "{}", context());
        assert_eq!(of["restarts"], starts, "{}", context());
        // Those that go on keep their time: this clock source is not the counter, but as good.
        if runs {
            all.assert_kept_its_time(partition, 280);
        }
    }
    assert_eq!(all.partition("linux")["events"]["totals"]["clock-fault"], 1, "{}", all.output);
    assert_eq!(all.partition("linux")["end"], "stopped by takt", "{}", all.output);

    assert_eq!(ended.status, 4, "{}", ended.output);
    in_time(ended, &ended.report["duration_ns"]);
    seen_in_time(ended, "log");
    seen_in_time(ended, "shut-down");
    ended.assert_shows("[takt] shut-down: clock-fault: the kernel's clock source is \"");
}
