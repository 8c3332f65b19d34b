//! A host whose clock is not the time-stamp counter: releases lie on the counter, and the kernel sleeps by
//! a clock that NTP steers, by 10 % if it is told to (`ADJ_TICK` of adjtimex(2)).

use std::path::PathBuf;

use takt_tests::{BUSY, File, Host, Outcome, long, plc_image, target};

/// Frames in us: windows and sleeps that are shorter and longer than each of the pieces of a sleep.
const FRAMES: [u64; 4] = [1_000, 10_000, 100_000, 1_000_000];

/// Lengths of the kernel's tick: 500 ppm and 10 % faster and slower than nominal, and changes of the rate
/// during the run.
const STEERINGS: [&[u32]; 6] = [
    &[10_005],
    &[9_995],
    &[11_000],
    &[9_000],
    &[10_000, 10_005, 9_995, 10_005],
    &[9_000, 11_000, 9_000, 10_833, 10_000],
];

/// How late a kick may be: what it takes in the lab without steering, 16 us, and the last piece of a
/// sleep under a clock that is slower by 10 %.
const KICK_NS: u64 = 40_000;

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
        for key in ["lost", "late_releases", "overruns", "unrecorded"] {
            assert_eq!(of("good", key), 0, "{key} of {context}");
        }
        assert!(of("good", "releases") + 3 >= frames, "{context}");
        assert!(of("good", "release_latency_ns.p50") <= 10, "{context}");
        assert!(of("runaway", "overruns") + 3 >= frames, "{context}");
        for key in ["overrun_ns.max", "kick_ns.max"] {
            assert!(of("runaway", key) <= KICK_NS, "{key} of {context}");
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
    let short = [(1_000, 1), (1_000, 3), (10_000, 5), (100_000, 0), (100_000, 2)];
    let short = short.map(|(frame, place)| Steered { frame, ticks: STEERINGS[place] });
    let runs: Vec<Steered> = if long() { all().collect() } else { short.into() };
    let files: Vec<PathBuf> = runs.iter().map(Steered::file).collect();
    let lines = runs.iter().zip(&files).map(|(run, file)| {
        let ticks: Vec<String> = run.ticks.iter().map(u32::to_string).collect();
        format!("{} {}s {}", file.display(), run.seconds(), ticks.join(" "))
    });
    let lines: Vec<String> = lines.collect();
    let host = ["guest/vmlinuz", "guest/initrd.img"]
        .iter()
        .fold(Host::new().with("--memory", "768"), |host, file| host.with_file(&target(file)))
        .with_file(&plc_image("never-done"));
    for (run, outcome) in runs.iter().zip(host.run_lines("clocks", &lines, &files)) {
        run.assert_kept_time(&outcome);
    }
}
