//! A host whose clock is not the time-stamp counter: releases lie on the counter, and the kernel sleeps by
//! a clock that NTP steers, by 10 % if it is told to (`ADJ_TICK` of adjtimex(2)).

use std::fs;
use std::path::PathBuf;

use takt_tests::{BUSY, File, Host, Outcome, Value, long, plc_image, target};

/// Frames in us: windows and sleeps that are shorter and longer than each of the pieces of a sleep.
const FRAMES: [u64; 6] = [1_000, 3_000, 4_000, 10_000, 100_000, 1_000_000];

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

/// What the host's tick may cost a release: what `takt check` allows for an interrupt.
const ONE_INTERRUPT_NS: u64 = 6_000;

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
    /// windows is not divided. A partition's thread that finds it before its own wake-up says so. What changes after that,
    /// with a window and its guard, is felt once, by a ninth.
    fn has_a_first_step(&self) -> bool {
        let by_a_tenth = |tick: &u32| tick.abs_diff(10_000) > 100;
        // The longest is from the good one's end to the runaway's.
        self.frame * 6 / 10 <= 2_000 && self.ticks[0] == 10_000 && self.ticks.iter().any(by_a_tenth)
    }

    /// In seconds: long enough for a Linux, and for some frames.
    fn seconds(&self) -> u64 {
        if self.frame < 1_000_000 { 3 } else { 6 }
    }

    fn assert_kept_time(&self, outcome: &Outcome) {
        let context = format!("{} us, ticks {:?}\n{}", self.frame, self.ticks, outcome.output);
        assert_eq!(outcome.status, 0, "{context}");
        let frames = self.seconds() * 1_000_000 / self.frame;
        let least = frames - 3.min(frames / 4);
        // A scan that began before its release would be a release that is lost.
        let of = |partition: &str, key: &str| outcome.number(partition, key);
        let kick = match self.has_a_first_step() {
            false => KICK_NS,
            true => KICK_NS + (self.frame * 1_000 / 5 + 20_000 + 112_000) / 9,
        };
        for key in ["lost", "late_releases", "overruns", "unrecorded"] {
            assert_eq!(of("good", key), 0, "{key} of {context}");
        }
        assert_eq!(of("runaway", "late_releases"), 0, "the runaway one: {context}");
        if self.ticks.iter().any(|tick| tick.abs_diff(10_000) > 100) {
            let counted = &outcome.partition("good")["wake_ups"]["steered"];
            assert!(counted.as_u64().is_some_and(|steered| steered > 0), "{context}");
        }
        assert!(of("good", "releases") >= least, "{context}");
        assert!(of("good", "release_latency_ns.p50") <= 10, "{context}");
        assert!(of("runaway", "overruns") >= least, "{context}");
        for key in ["overrun_ns.max", "kick_ns.max"] {
            assert!(of("runaway", key) <= kick, "{key} of {context}");
        }
        let booted = outcome.partition("linux")["boot_to_init_ns"].is_u64();
        assert!(booted && outcome.received("linux") >= 0.9, "Linux did not run: {context}");
    }
}

/// Runs all of these one after the other, in one machine.
fn assert_all_keep_time(list: &str, runs: &[Steered]) {
    let files: Vec<PathBuf> = runs.iter().map(Steered::file).collect();
    let lines = runs.iter().zip(&files).map(|(run, file)| {
        let ticks: Vec<String> = run.ticks.iter().map(u32::to_string).collect();
        format!("{} {}s {}", file.display(), run.seconds(), ticks.join(" "))
    });
    let lines: Vec<String> = lines.collect();
    let host = machine().with_file(&plc_image("never-done"));
    for (run, outcome) in runs.iter().zip(host.run_list(list, "clocks", &lines, &files)) {
        let max = |partition, key| outcome.number(partition, &format!("{key}.max"));
        println!(
            "{} us, ticks {:?}: runaway {} ns past its end, kick {} ns; good one {} ns after its release; {}",
            run.frame,
            run.ticks,
            max("runaway", "overrun_ns"),
            max("runaway", "kick_ns"),
            max("good", "release_latency_ns"),
            outcome.report["window_enforcers"][0]["wake_ups"]
        );
        run.assert_kept_time(&outcome);
    }
}

#[test]
fn windows_and_releases_are_where_they_were_under_a_clock_that_changes_its_rate_by_a_tenth() {
    assert_all_keep_time("clock", &[Steered { frame: 10_000, ticks: STEERINGS[5] }]);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn windows_and_releases_are_where_they_were_under_any_steering_of_the_clock() {
    let all = || {
        let frames = FRAMES.into_iter();
        frames.flat_map(|frame| STEERINGS.map(move |ticks| Steered { frame, ticks }))
    };
    let short = [(1_000, 6), (100_000, 2)];
    let short = short.map(|(frame, place)| Steered { frame, ticks: STEERINGS[place] });
    let runs: Vec<Steered> = if long() { all().collect() } else { short.into() };
    assert_all_keep_time("clocks", &runs);
}

/// The first step of a clock's rate, at any place of a frame of 2 ms, beside a runaway PLC with this window at its start. Another PLC
/// has a window from `other` on, which is in time, and kicks are late by `bound` at most. Returns the latest one.
fn latest_kick_under_a_first_step(name: &str, window: u64, other: u64, bound: u64) -> u64 {
    const FRAME: u64 = 2_000;
    const GUARD_NS: u64 = 20_000;
    let places = (0..FRAME).step_by(if long() { 20 } else { 80 });
    let files: Vec<(u64, PathBuf)> = places
        .map(|place| {
            let file = File::new(&format!("{FRAME}us"))
                .plc("runaway", Some(plc_image("never-done")), "")
                .plc("good", None, "")
                .schedule("normal")
                .window("runaway", 0, window)
                .window("good", other, 200);
            (place, file.save(&format!("{name}-{place}")))
        })
        .collect();
    let line = |(place, file): &(u64, PathBuf)| format!("{} 200ms {FRAME} {place}", file.display());
    let lines: Vec<String> = files.iter().map(line).collect();
    let paths: Vec<PathBuf> = files.iter().map(|(_, path)| path.clone()).collect();
    let host = Host::new().with("--memory", "768").with("--clock", "steered");
    let host = host.with("--program", env!("CARGO_BIN_EXE_step-clock"));
    let host = host.with_file(&plc_image("never-done"));
    let (mut latest, mut latest_woken) = (0, 0);
    for ((place, _), outcome) in
        files.iter().zip(host.run_list(name, "clock-steps", &lines, &paths))
    {
        let context = format!("a step {place} us on\n{}", outcome.output);
        assert_eq!(outcome.status, 0, "{context}");
        for key in ["lost", "late_releases", "overruns"] {
            assert_eq!(outcome.number("good", key), 0, "{key} of {context}");
        }
        // A look of the window enforcer that finds the step may meet this one's wake-up.
        let woken = outcome.number("runaway", "wake_up_latency_ns.max");
        assert!(woken <= GUARD_NS + 3_000, "the runaway one woke {woken} ns late: {context}");
        latest_woken = latest_woken.max(woken);
        // The step came in the run, and was found.
        assert!(outcome.number("runaway", "wake_ups.steered") > 0, "no step: {context}");
        assert!(outcome.number("runaway", "overruns") >= 95, "the runaway one: {context}");
        assert!(outcome.number("good", "releases") >= 95, "{context}");
        let kick = outcome.number("runaway", "kick_ns.max");
        assert!(kick <= bound, "a kick came {kick} ns late: {context}");
        latest = latest.max(kick);
    }
    println!(
        "of {} runs the latest kick came {latest} ns after the end, and the latest wake-up of the runaway one {latest_woken} ns \
         after its instant",
        files.len()
    );
    latest
}

/// In the last 112 us before a partition's wake-up it makes the kick late by a ninth of that, the guard and the window: by 102 us here or
/// more, for which its reservation has room.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_first_step_of_the_clock_at_any_place_of_a_frame_keeps_no_thread_from_its_next_window() {
    // What a kick takes, and 40 us that pass until a slower clock shows.
    let bound = 20_000 + (900_000 + 20_000 + 112_000 + 40_000) / 9;
    let latest = latest_kick_under_a_first_step("clock-steps", 900, 1_200, bound);
    // One of them at least came where it is felt.
    assert!(
        latest > 100_000,
        "no step came after a partition's last look at the clock: {latest} ns"
    );
}

/// The other window begins as soon after the runaway one's as a file may have it. Its thread looks at the clock within that window, and again
/// between the two: neither its release nor the kick before it is late by more than there is room for.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_first_step_of_the_clock_makes_no_release_late_that_comes_close_after_another_window() {
    // Without looks at the clock the latest kick came more than 100 us late, and the release after it, too.
    latest_kick_under_a_first_step("clock-steps-close", 900, 950, 46_000);
}

/// What has interrupted the processor in a run: places in the frame, in ns.
#[derive(Default)]
struct Interrupts {
    all: Vec<u64>,
    /// The host's tick.
    ticks: Vec<u64>,
    /// Timers of the supervisor thread.
    own: Vec<u64>,
    /// Those whose function came long after the interrupt. PREEMPT_RT leaves it to a thread, which waits while a window
    /// is open: so this one may have been in a window.
    astray: usize,
}

impl Interrupts {
    /// What `traced-timers` has left of a run, but for its first frame, in which threads still fall asleep.
    fn of(name: &str, outcome: &Outcome, frame_ns: u64) -> Self {
        let path = target(&format!("tests/traced-timers.out/{name}.timers"));
        let text = fs::read_to_string(path).unwrap_or_default();
        let of = |value: &Value| value.as_u64().unwrap_or_else(|| panic!("{}", outcome.output));
        let epoch = of(&outcome.report["epoch_tsc"]);
        let khz = of(&outcome.report["host"]["tsc_khz"]);
        let run = frame_ns..of(&outcome.report["duration_ns"]);
        let (mut this, mut last) = (Self::default(), 0);
        for (kind, tsc) in text.lines().filter_map(|line| line.split_once(' ')) {
            let tsc = tsc.trim_end_matches(':').parse::<u64>().ok();
            let since = tsc.and_then(|tsc| tsc.checked_sub(epoch)).map_or(0, u128::from);
            let ns = (since * 1_000_000 / u128::from(khz)) as u64;
            if !run.contains(&ns) {
                continue;
            }
            match kind {
                "interrupt" => {
                    last = ns;
                    this.all.push(ns % frame_ns);
                }
                "timerfd_tmrproc" if ns - last > 20_000 => this.astray += 1,
                "timerfd_tmrproc" => this.own.push(last % frame_ns),
                kind if kind.starts_with("tick_") => this.ticks.push(last % frame_ns),
                _ => {}
            }
        }
        this
    }
}

/// Takt's own timers are kept out of windows at any rate of the clock, the host's tick as long as the clock is not
/// steered. Where it is, the tick goes through the windows, and moves a release by one interrupt.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn timers_that_takt_can_place_stay_out_of_windows_under_steering_and_the_tick_without() {
    const FRAME_NS: u64 = 1_000_000;
    // Of the runaway from when all threads that are woken for it are awake until the window enforcer wakes for its end; of the good
    // one until it is done.
    const QUIET: [(u64, u64); 3] = [(995_000, FRAME_NS), (0, 150_000), (495_000, 510_000)];
    let all: [(&str, &[u32]); 4] = [
        ("timers-nominal", &[10_000]),
        ("timers-changing", &[9_995, 11_000, 9_000]),
        ("timers-slower", &[9_995]),
        ("timers-faster", &[11_000]),
    ];
    let (runs, seconds) = if long() { (&all[..], 8) } else { (&all[..2], 3) };
    let file = |name: &str| {
        File::new("1ms")
            .plc("runaway", Some(plc_image("never-done")), "")
            .plc("good", None, "")
            .linux(BUSY)
            .schedule("normal")
            .window("runaway", 0, 300)
            .window("good", 500, 100)
            .save(name)
    };
    let files: Vec<PathBuf> = runs.iter().map(|(name, _)| file(name)).collect();
    let lines = files.iter().zip(runs).map(|(file, (_, ticks))| {
        let ticks: Vec<String> = ticks.iter().map(u32::to_string).collect();
        format!("{} {seconds}s {}", file.display(), ticks.join(" "))
    });
    let lines: Vec<String> = lines.collect();
    let host = machine().with_file(&plc_image("never-done"));
    for ((name, rates), outcome) in
        runs.iter().zip(host.run_list("traced-timers", "traced-timers", &lines, &files))
    {
        assert_eq!(outcome.status, 0, "{name}: {}", outcome.output);
        let interrupts = Interrupts::of(name, &outcome, FRAME_NS);
        let in_windows = |places: &[u64]| {
            let is_in = |place: &&u64| QUIET.iter().any(|(from, to)| (*from..*to).contains(place));
            places.iter().filter(is_in).count()
        };
        let own = in_windows(&interrupts.own) + interrupts.astray;
        let ticks = in_windows(&interrupts.ticks);
        let latest = outcome.number("good", "release_latency_ns.max");
        println!(
            "{name}: {} interrupts, {} in windows; {own} of {} timers of takt's and {ticks} of {} ticks in windows; \
             the latest release {latest} ns after its instant; {}",
            interrupts.all.len(),
            in_windows(&interrupts.all),
            interrupts.own.len() + interrupts.astray,
            interrupts.ticks.len(),
            outcome.report["tick"]
        );
        // The supervisor thread has 50 a second, the kernel 250.
        assert!(interrupts.own.len() as u64 >= 40 * seconds, "{name}\n{}", outcome.output);
        assert!(interrupts.ticks.len() as u64 >= 200 * seconds, "{name}\n{}", outcome.output);
        for key in ["lost", "late_releases", "unrecorded"] {
            assert_eq!(outcome.number("good", key), 0, "{name}: {key}\n{}", outcome.output);
        }
        // What is set before the rate changes goes by the rate before.
        assert!(own <= 2 * (rates.len() - 1), "{name}: {own} timers of takt's in windows");
        if **rates == [10_000] {
            assert_eq!(ticks, 0, "{name}\n{}", outcome.output);
            let all = in_windows(&interrupts.all);
            assert_eq!(all, 0, "{name}: {all} interrupts in windows\n{}", outcome.output);
            assert_eq!(outcome.report["tick"]["clear"], "windows");
            assert!(latest <= 10, "{name}: {latest} ns");
        } else {
            // That it goes through them is what the bound is worth.
            assert!(ticks > 0 && latest <= ONE_INTERRUPT_NS, "{name}: {latest} ns, {ticks} ticks");
        }
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

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_clock_source_that_is_taken_away_in_mid_run_is_an_error_of_each_partition() {
    let actions: Vec<&str> = FOLLOWS.iter().map(|(action, ..)| *action).collect();
    let files = [
        with_actions("clock-fault", &actions),
        with_actions("clock-fault-ends-the-run", &["log", "shut-down"]),
    ];
    let lines: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    let outcomes = machine().run_list("clock-source", "clock-source", &lines, &files);
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

/// What KVM does to a guest's counter on a host whose own is bad, the guest does itself here.
#[test]
fn a_counter_of_a_plc_that_is_not_the_hosts_any_more_is_an_error_within_a_second() {
    const RESTARTS: &str = "restarts = { at_most = 20, within = \"60s\" }";
    let outcome = File::new("10ms")
        .plc("good", None, "")
        .plc("moved", Some(plc_image("move-counter")), "")
        .plc("again", Some(plc_image("move-counter")), RESTARTS)
        .health("moved", "clock-fault", "log")
        .health("moved", "deadline-missed", "ignore")
        .health("again", "clock-fault", "cold-start")
        .health("again", "deadline-missed", "ignore")
        .schedule("normal")
        .window("good", 0, 200)
        .window("moved", 5_000, 200)
        .window("again", 7_500, 200)
        .run("moved-counter")
        .lasting("1500ms")
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("[takt] moved: clock-fault: the guest's TSC is 0.");
    outcome.assert_shows(" ms ahead of the host's -> log");
    assert_eq!(outcome.number("moved", "events.totals.clock-fault"), 1, "{}", outcome.output);
    let faults = outcome.partition("moved")["events"]["list"].as_array().cloned();
    let is_clocks = |event: &Value| event["error"] == "clock-fault";
    let fault = faults.unwrap_or_default().into_iter().find(is_clocks);
    // It is moved in its 20th cycle.
    let at = fault.and_then(|fault| fault["at_ns"].as_u64()).unwrap_or_default();
    assert!((190_000_000..1_200_000_000).contains(&at), "{at} ns\n{}", outcome.output);
    // Each start of it moves its counter, and is found out: a good one lives for 200 ms, and KVM is asked each 250 ms.
    let found = outcome.number("again", "events.totals.clock-fault");
    assert!(found >= 3, "{found} faults\n{}", outcome.output);
    assert!(outcome.number("again", "restarts") >= 3, "{}", outcome.output);
    outcome.assert_kept_its_time("good", 148);
    let good = &outcome.partition("good")["events"]["totals"];
    assert!(good["clock-fault"].is_null(), "{}", outcome.output);
}
