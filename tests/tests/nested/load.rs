//! A Linux that really works beside a PLC: it compiles, with a compiler of Debian's.

use std::fs;

use takt_tests::{System, initrd_and, long, target};

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
