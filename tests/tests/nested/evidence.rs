//! What shows that a figure was taken under the load that it is said to be of, beside a Linux that lived,
//! and that the emulated machine below did not take part in it.

use std::fs;
use std::path::{Path, PathBuf};

use crate::quiet::beside_three_plcs;
use takt_tests::{
    File, Host, Outcome, Value, deaf_kernel, initrd_with, long, parse, silent_kernel, target,
};

/// A PLC of the built-in kind at 1 kHz, and a Linux with stress-ng.
fn beside_stress(name: &str, guard: &str, duration: &'static str, at_the_end: u64) -> Outcome {
    one_beside_stress(name, guard, at_the_end).run(name).lasting(duration).run()
}

fn one_beside_stress(name: &str, guard: &str, at_the_end: u64) -> File {
    let guard = format!("release_guard = {guard:?}");
    let file = File::new("1ms").plc("plc", None, &guard);
    let file = file.stressed_linux(name, &stress_until(at_the_end));
    file.schedule("normal").window("plc", 0, 300)
}

/// What a Linux with stress-ng executes. From its second second to that end cyclictest measures how late its timers are.
/// Then it says what the timers, the page faults and each of stress-ng's processes have come to.
pub fn stress_until(end: u64) -> String {
    let measured = end - 1;
    format!(
        "takt-load stress & sleep 1; chroot /load/stress /usr/bin/cyclictest --quiet --mlockall --priority=80 \
         --interval=1037 --duration={measured}; \
         grep -h -e LOC: -e pgfault -e stress-ng- /proc/interrupts /proc/vmstat /proc/[0-9]*/stat"
    )
}

/// The largest number that follows `before` on a line of the console.
fn largest(outcome: &Outcome, before: &str) -> u64 {
    let number = |line: &str| -> Option<u64> {
        let (_, rest) = line.split_once(before)?;
        rest.split_whitespace().next()?.parse().ok()
    };
    outcome.output.lines().filter_map(number).max().unwrap_or(0)
}

/// QEMU delivers no interrupt twice: a Linux whose timers go off 20,000 times a second, which forks and
/// faults, died of that within three seconds.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_full_of_timers_lives_and_the_plc_keeps_its_time() {
    let (duration, end, releases) = if long() { ("60s", 57, 59_990) } else { ("4500ms", 2, 4_490) };
    let outcome = beside_stress("stress", "20us", duration, end);
    outcome.assert_shows("emulated by QEMU ");
    outcome.assert_shows(": each interrupt is delivered once");
    assert_stressed(&outcome, end);
    outcome.assert_kept_its_time("plc", releases);
    outcome.assert_exact("plc");
}

/// What quiet windows are for, and what they cost a Linux: the same runs with its timers where it sets them.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn without_quiet_windows_releases_are_moved_by_interrupts_of_linuxs_timers() {
    for lane in ["lab", "vmx"] {
        let duration = if lane == "lab" { "7s" } else { "5s" };
        for name in ["one", "three"] {
            for hook in [None, Some("loud-windows")] {
                let file = match name {
                    "one" => one_beside_stress("quiet-or-not", "20us", 3),
                    _ => beside_three_plcs(|file| {
                        file.stressed_linux("quiet-or-not", &stress_until(3))
                    }),
                };
                let test = format!("{lane}-{name}-{}", hook.unwrap_or("quiet-windows"));
                let run = file.run(&test).in_lane(lane).lasting(duration);
                let outcome = hook.into_iter().fold(run, takt_tests::Run::hooked).run();
                println!("{test}: Linux's share {}", outcome.share("linux"));
                assert_stressed(&outcome, 3);
                let plcs = if name == "one" { &["plc"][..] } else { &["axis", "cell", "climate"] };
                let mut latest = 0;
                for plc in plcs {
                    let of = |key: &str| outcome.number(plc, &format!("release_latency_ns.{key}"));
                    println!("{test}: {plc}: p99 {} ns, max {} ns", of("p99"), of("max"));
                    latest = latest.max(of("max"));
                }
                // One interrupt takes more than 500 ns.
                let is_as_meant = if hook.is_some() { latest > 500 } else { latest <= 10 };
                assert!(is_as_meant, "{test}: {latest} ns\n{}", outcome.output);
            }
        }
    }
}

/// The guard is as narrow as the wake-ups of a host whose timers and processes are busy allow, and none is too late for it.
#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_guard_that_follows_its_host_is_wide_enough_beside_a_linux_full_of_timers() {
    // It has to narrow first, in steps of seconds.
    let outcome = beside_stress("stress-guard", "auto", "60s", 57);
    assert_stressed(&outcome, 57);
    outcome.assert_kept_its_time("plc", 59_990);
    outcome.assert_exact("plc");
    let [narrow, wide] =
        ["min", "max"].map(|key| outcome.number("plc", &format!("release_guard_ns.{key}")));
    assert_eq!(wide, 40_000, "it begins with its bound\n{}", outcome.output);
    assert!(narrow < 20_000, "{narrow} ns\n{}", outcome.output);
    println!("a guard of {narrow} ns at its narrowest");
}

/// Linux has lived, with many processes and timers up to `end` seconds.
pub fn assert_stressed(outcome: &Outcome, end: u64) {
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let forks = largest(outcome, "takt-load: stress ");
    // Processes that fork have what the timers leave: 28 a second on Linux 6.12.
    assert!(forks > 10 * (end + 1), "{forks} forks\n{}", outcome.output);
    outcome.assert_loaded_until_the_end("stress");
    assert!(!outcome.output.contains("stress-ng has ended"), "{}", outcome.output);
    // Of 20,000 a second, some fall together while Linux starts processes.
    let timers = largest(outcome, "LOC: ");
    assert!(timers > (end - 1) * 10_000, "{timers} interrupts of timers\n{}", outcome.output);
    let faults = largest(outcome, "pgfault ");
    assert!(faults > (end - 1) * 1_000, "{faults} page faults\n{}", outcome.output);
    for worker in ["timer", "fault", "fork", "get"] {
        let ticks = ticks_of(outcome, worker);
        assert!(ticks > 0, "stress-ng's {worker} has done nothing\n{}", outcome.output);
        println!("stress-ng's {worker}: {ticks} ticks");
    }
    println!("{timers} timers, {faults} page faults, {forks} forks in {end} s");
    // cyclictest sleeps 964 times a second, but for those that it is too late for.
    let sleeps = largest(outcome, " C: ");
    assert!(sleeps > (end - 1) * 700, "{sleeps} sleeps of cyclictest\n{}", outcome.output);
    let line = outcome.output.lines().find(|line| line.contains(" I:1037 C:"));
    println!("Linux's own timers, in us: {}", line.unwrap_or_default());
}

/// The time that stress-ng's processes of a kind have had, in ticks of the kernel (`utime` and `stime`, proc_pid_stat(5)).
fn ticks_of(outcome: &Outcome, worker: &str) -> u64 {
    let name = format!("(stress-ng-{worker}");
    let of = |line: &str| -> Option<u64> {
        let (_, fields) = line.split_once(&name)?.1.rsplit_once(") ")?;
        let times = fields.split_whitespace().skip(11).take(2);
        times.map(|ticks| ticks.parse::<u64>().ok()).sum()
    };
    outcome.output.lines().filter_map(of).sum()
}

/// A doorbell's handler takes a lock, and a second delivery waits for it for ever.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_is_woken_a_thousand_times_a_second_by_doorbells() {
    let (duration, seconds, releases) = if long() { ("60s", 57, 59_990) } else { ("4s", 2, 3_990) };
    let exec = "takt-port watch receive --hex > /dev/null & \
                while :; do sleep 1; echo rung $(grep uio_pci /proc/interrupts); done";
    let outcome = File::new("1ms")
        .plc("plc", Some(peer()), "")
        .linux(exec)
        .channels("plc", "linux")
        .lines("doorbell = true")
        .channels("linux", "plc")
        .schedule("normal")
        .window("plc", 0, 300)
        .run("doorbells")
        .lasting(duration)
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let line = outcome.output.lines().rfind(|line| line.starts_with("rung "));
    let rings = line.and_then(|line| line.split_whitespace().nth(2)?.parse::<u64>().ok());
    assert!(rings > Some(seconds * 900), "{line:?}\n{}", outcome.output);
    outcome.assert_kept_its_time("plc", releases);
    outcome.assert_punctual("plc");
}

fn peer() -> PathBuf {
    takt_tests::plc_image("peer")
}

/// A PLC, and a Linux that executes this beside its load.
fn system(initrd: &str, exec: &str) -> File {
    File::new("1ms")
        .plc("plc", None, "release_guard = \"10us\"")
        .linux_with(initrd, exec)
        .schedule("normal")
        .window("plc", 0, 300)
}

/// Measures it under the load `fork` with a limit that it keeps.
fn measure(name: &str, file: &File, duration: &str) -> (Outcome, Value) {
    let folder = target("tests").join(name);
    let _ = fs::remove_dir_all(&folder);
    let run = file.run(name).for_jitter().lasting(duration).with("--load").with("fork");
    let run = run.with("--max-lost").with("0").with("--out").with(folder.to_str().unwrap());
    let outcome = run.run();
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap_or_default();
    let report = parse(&read("report.json"));
    let page = read("report.html");
    if let Some(reason) = report["jitter"]["proof"]["reason"].as_str() {
        assert!(page.contains(reason), "not on the page: {reason}");
        outcome.assert_shows(&format!("NOT PROVED linux: {reason}"));
        assert!(
            !outcome.output.contains("all limits are kept") && !page.contains("limits are kept")
        );
    }
    (outcome, report)
}

/// The points of a load's progress: when, in ns, and how much was done.
fn points(report: &Value) -> Vec<(u64, u64)> {
    let points = report["jitter"]["progress"]["points"].as_array();
    let numbers = |point: &Value| Some((point[0].as_u64()?, point[1].as_u64()?));
    points.into_iter().flatten().filter_map(numbers).collect()
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_load_that_goes_on_is_in_the_report_over_time() {
    let (outcome, report) = measure("load-goes-on", &system("guest/initrd.img", ""), "5s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("all limits are kept");
    let jitter = &report["jitter"];
    assert_eq!(jitter["proof"]["proved"], true, "{jitter}");
    assert_eq!(jitter["progress"]["unit"], "processes");
    let points = points(&report);
    // One for each half second after some two seconds of boot.
    assert!(points.len() >= 6, "{points:?}");
    assert!(points.is_sorted_by(|a, b| a.0 < b.0 && a.1 < b.1), "{points:?}");
    assert!(points.iter().all(|(at, _)| *at <= 5_000_000_000), "{points:?}");
    outcome.assert_kept_its_time("plc", 4_900);
    assert!(outcome.partition("linux")["stuck"].is_null());
}

#[test]
fn a_load_that_stands_still_is_not_all_limits_are_kept() {
    let stop = "sleep 2; killall -STOP takt-load; echo load stopped";
    let (outcome, report) = measure("load-stops", &system("guest/initrd.img", stop), "6s");
    outcome.assert_shows("load stopped");
    assert_eq!(outcome.status, 5, "{}", outcome.output);
    let reason = report["jitter"]["proof"]["reason"].as_str().unwrap_or_default();
    assert!(reason.starts_with("the load fork stood still for "), "{reason}");
    // Until the end, which is the first instant after 6 s that is no window's.
    assert!(reason.contains(" to 6.00") && reason.contains(" of 6.00"), "{reason}");
    assert!(reason.contains("Linux said nothing of it. "), "{reason}");
    // It is the load that has stopped, and the kernel idles.
    assert!(outcome.partition("linux")["stuck"].is_null(), "{}", outcome.output);
    assert!(points(&report).len() > 2, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 5_900);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_whose_kernel_hangs_is_not_all_limits_are_kept() {
    let initrd = initrd_with("hang-kernel", &[Path::new(env!("CARGO_BIN_EXE_hang-kernel"))]);
    // Some two seconds of boot, two until it hangs, and two and a half until that is told.
    let (outcome, report) = measure("kernel-hangs", &system(&initrd, "sleep 2; hang-kernel"), "8s");
    outcome.assert_shows("hang-kernel: now");
    assert_eq!(outcome.status, 5, "{}", outcome.output);
    outcome.assert_shows("[takt] linux: its kernel spins with interrupts off since ");
    let stuck = &outcome.partition("linux")["stuck"];
    assert_eq!(stuck["how"], "spinning", "{}", outcome.output);
    let reason = report["jitter"]["proof"]["reason"].as_str().unwrap_or_default();
    assert!(reason.starts_with("the load fork stood still for "), "{reason}");
    assert!(reason.contains("and its kernel spins with interrupts off since "), "{reason}");
    // What was seen is when it happened: Linux was there until then, and the load as well.
    let last = points(&report).last().map_or(0, |point| point.0);
    let since = stuck["since_ns"].as_u64().unwrap_or_default();
    assert!((last..last + 1_500_000_000).contains(&since), "{last} {stuck}");
    outcome.assert_kept_its_time("plc", 7_900);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_kernel_that_does_nothing_any_more_is_named_and_an_idle_one_is_not() {
    let beside_plc = |kernel: PathBuf| {
        File::new("1ms")
            .plc("plc", None, "")
            .lines(&format!(
                "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
                 memory = \"64MiB\"\nkernel = {kernel:?}"
            ))
            .schedule("normal")
            .window("plc", 0, 300)
    };
    let [halted, deaf] = [silent_kernel(), deaf_kernel()].map(beside_plc);
    let panics = system("guest/initrd.img", "echo c > /proc/sysrq-trigger");
    let idle = system("guest/initrd.img", "");
    let cases = [
        ("kernel-halted", halted, "4s", Some(("halted", "has halted with interrupts off since "))),
        ("kernel-deaf", deaf, "4s", Some(("deaf", "spins and gets no interrupt since "))),
        (
            "kernel-panics",
            panics,
            "4s",
            Some(("panicked", "has panicked, as its console says, since ")),
        ),
        ("kernel-idle", idle, if long() { "60s" } else { "10s" }, None),
    ];
    let runs = cases.each_ref().map(|(name, file, duration, _)| (file.save(name), *duration));
    for ((.., how), outcome) in cases.iter().zip(Host::run_all("kernels", &runs)) {
        // What follows from a dead kernel is for a watchdog: without one the run is as good as before.
        assert_eq!(outcome.status, 0, "{}", outcome.output);
        let stuck = &outcome.partition("linux")["stuck"];
        let told = outcome.output.matches("[takt] linux: its kernel ").count();
        let Some((how, words)) = *how else {
            assert!(stuck.is_null() && told == 0, "{}", outcome.output);
            outcome.assert_shows("linux# ");
            continue;
        };
        assert_eq!((stuck["how"].as_str(), told), (Some(how), 1), "{}", outcome.output);
        outcome.assert_shows(&format!("[takt] linux: its kernel {words}"));
        outcome.assert_shows(&format!("  kernel         {words}"));
    }
}
