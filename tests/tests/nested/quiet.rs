//! Quiet windows: what nothing of Linux's and nothing of Takt's may do to a PLC.

use std::path::Path;

use takt_tests::{File, Outcome, initrd_with, long};

/// Linux full of timers, and beside them one that measures how late its own sleeps end.
fn storm(name: &str, seconds: u32) -> (String, String) {
    let initrd = initrd_with(name, &[Path::new(env!("CARGO_BIN_EXE_timers"))]);
    (initrd, format!("timers {seconds} measure & timers {seconds} storm; wait; echo calm again"))
}

/// Releases that nothing has moved: within 10 ns, each of them.
fn assert_quiet(outcome: &Outcome, plc: &str, at_least: u64) {
    outcome.assert_kept_its_time(plc, at_least);
    let latest = outcome.number(plc, "release_latency_ns.max");
    assert!(latest <= 10, "{plc}: {latest} ns\n{}", outcome.output);
}

#[test]
fn a_storm_of_timers_moves_no_release_of_a_plc() {
    let (seconds, duration, releases) = if long() { (57, "60s", 59_900) } else { (3, "6s", 5_900) };
    let (initrd, exec) = storm("quiet-storm", seconds);
    let file = File::new("1ms").plc("plc", None, "").linux_with(&initrd, &exec);
    let outcome =
        file.schedule("normal").window("plc", 0, 300).run("quiet-storm").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("calm again");
    assert_quiet(&outcome, "plc", releases);
}
