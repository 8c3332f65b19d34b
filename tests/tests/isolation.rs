//! Neither guest can harm the other: broken and hostile guests of both kinds.

use takt_tests::System;

#[test]
fn a_plc_that_never_says_done_does_not_keep_linux_from_its_shell() {
    let outcome = System::with_plc("never-done").run("never-done", "8s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
    outcome.assert_shows("linux# ");
    // Every window ends by a kick, on time: the next one finds the thread asleep.
    let windows = outcome.number("plc", "overruns");
    assert!(windows >= 7_990, "{windows} overruns\n{}", outcome.output);
    assert_eq!(outcome.number("plc", "late_releases"), 0, "{}", outcome.output);
    let share = outcome.partition("plc")["cpu_share"].as_f64().unwrap_or(1.0);
    assert!((0.30..0.35).contains(&share), "the PLC's share is {share}\n{}", outcome.output);
}

#[test]
fn a_linux_that_spins_in_kernel_mode_does_not_cost_the_plc_a_release() {
    // First all time goes into one endless system call, then the kernel panics, which without a
    // time-out ends in a loop that never leaves kernel mode.
    let spinning = System {
        exec: "dd if=/dev/urandom of=/dev/null bs=64M count=1; echo c > /proc/sysrq-trigger",
        ..System::default()
    };
    let outcome = spinning.run("kernel-spin", "6s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("Kernel panic - not syncing");
    outcome.assert_plc_kept_its_time(5_990);
    assert!(outcome.number("plc", "release_latency_ns.max") <= 10, "{}", outcome.output);
    let share = outcome.partition("linux")["cpu_share"].as_f64().unwrap_or(0.0);
    assert!(share > 0.9, "Linux did not spin: its share is {share}\n{}", outcome.output);
}

#[test]
fn a_plc_that_faults_is_reported_and_linux_lives_on() {
    let outcome = System::with_plc("fault").run("fault", "4s");
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    outcome.assert_shows("[takt] plc: page fault (vector 14, error code 0x2) at rip 0x1");
    outcome.assert_shows("linux# ");
    assert_eq!(outcome.number("plc", "releases"), 100, "{}", outcome.output);
}

#[test]
fn a_plc_whose_stack_overflows_is_reported_and_does_not_hang() {
    let outcome = System::with_plc("stack-overflow").run("stack-overflow", "300ms");
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    outcome.assert_shows("[takt] plc: page fault (vector 14, error code 0x2)");
}

#[test]
fn a_plc_that_floods_everything_it_can_reach_is_confined_and_counted() {
    let outcome = System::with_plc("flood").run("flood", "4s");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("linux# ");
    assert!(outcome.number("plc", "illegal_accesses") >= 1000, "{}", outcome.output);
    assert!(outcome.number("plc", "console_dropped") > 0, "{}", outcome.output);
}

#[test]
fn a_plc_cannot_write_its_information_page() {
    let outcome = System::with_plc("write-information").run("write-information", "300ms");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("page unchanged");
    outcome.assert_shows("[takt] plc: ended itself with code 0");
    assert!(outcome.number("plc", "illegal_accesses") >= 1, "{}", outcome.output);
}
