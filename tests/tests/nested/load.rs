//! A Linux that really works beside a PLC: it compiles, with a compiler of Debian's.

use std::fs;

use takt_tests::{File, Run, long, parse, target};

#[test]
fn linux_compiles_while_the_plc_keeps_its_time() {
    let (duration, releases) = if long() { ("60s", 59_900) } else { ("4s", 3_900) };
    let outcome = File::new("1ms")
        .plc("plc", None, "release_guard = \"10us\"")
        .compiling_linux("")
        .schedule("normal")
        .window("plc", 0, 300)
        .run("load")
        .lasting(duration)
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_compiled();
    outcome.assert_kept_its_time("plc", releases);
    outcome.assert_punctual("plc");
}

/// In real time nothing of its figures may be asserted, but that it comes to its end and has them, which
/// it did not while QEMU lost interrupts (docs/decisions/0012-qemu-takes-its-lock.md).
#[ignore = "takes long: scripts/test --all"]
#[test]
fn in_real_time_too_a_compiling_linux_ends_with_a_report() {
    let folder = target("tests/real-time");
    let _ = fs::remove_dir_all(&folder);
    let run = Run::of("configs/jitter.toml").in_lane("emulated").for_jitter();
    let run = run.with("--load").with("compile").with("--out").with(folder.to_str().unwrap());
    let outcome = run.lasting(if long() { "180s" } else { "20s" }).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("each interrupt is delivered once and none is lost");
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
