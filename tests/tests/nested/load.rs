//! A Linux that really works beside a PLC: it compiles, with a compiler of Debian's.

use std::fs;

use takt_tests::{Run, System, initrd_and, long, parse, target};

#[test]
fn linux_compiles_while_the_plc_keeps_its_time() {
    let compiler = fs::read(target("guest/load.cpio")).expect("scripts/load-image has run");
    let initrd = initrd_and("load-initrd", &compiler);
    let system = System {
        initrd: &initrd,
        memory: "448MiB",
        exec: "takt-load compile",
        ..System::default()
    };
    let (duration, releases) = if long() { ("60s", 59_900) } else { ("5s", 4_900) };
    let outcome = system.run("load", duration);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let told = |line: &str| -> Option<u64> {
        let (_, line) = line.split_once("takt-load: compile ")?;
        line.split(' ').next()?.parse().ok()
    };
    let objects = outcome.output.lines().filter_map(told).max();
    assert!(objects.is_some_and(|count| count > 0), "{objects:?}\n{}", outcome.output);
    outcome.assert_kept_its_time("plc", releases);
    outcome.assert_punctual("plc");
}

/// In real time nothing of its figures may be asserted, but that it comes to its end and has them, which
/// it did not while QEMU lost interrupts (docs/decisions/0012-qemu-takes-its-lock.md).
#[test]
fn in_real_time_too_a_compiling_linux_ends_with_a_report() {
    let folder = target("tests/real-time");
    let _ = fs::remove_dir_all(&folder);
    let run = Run::of("configs/jitter.toml").in_lane("emulated").for_jitter();
    let run = run.with("--load").with("compile").with("--out").with(folder.to_str().unwrap());
    let outcome = run.lasting(if long() { "180s" } else { "20s" }).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(outcome.number("plc", "releases") > 0, "{}", outcome.output);
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap_or_default();
    assert!(read("report.html").contains("<svg"), "{}", outcome.output);
    let progress = &parse(&read("report.json"))["jitter"]["progress"];
    // The first comes some seconds after Linux has started, which on a busy machine takes most of 20 s.
    if long() {
        let points = progress["points"].as_array().map_or(0, Vec::len);
        assert!(points > 1, "{progress}\n{}", outcome.output);
    }
}
