//! Partitions on CPUs of their own. The lane has several CPUs and no times that mean anything.

use takt_tests::Run;

#[test]
fn a_plc_with_a_cpu_to_itself_runs_beside_linux_and_the_cpu_goes_back() {
    let run = Run::of("configs/separate-cpus.toml").in_lane("emulated").lasting("180s");
    let outcome = run.typing(&[("linux# ", "\x1dq")]).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("/init: Takt Linux guest, kernel ");
    outcome.assert_shows("[plc] Takt PLC guest");
    assert!(outcome.number("plc", "releases") > 0, "{}", outcome.output);
    // Without a domain of its own for CPU 1, the PLC's thread would have been refused. That the CPU
    // is back is told only after the kernel's list of the root cgroup's CPUs was read again.
    let told = |text: &str| outcome.output.find(text);
    let set_apart = told("[takt] CPU 1 has a scheduling domain of its own");
    let started = told("[takt] separate-cpus: starting ");
    let back = told("[takt] CPU 1 is back in the host's scheduling domain");
    assert!(set_apart.is_some() && set_apart < started && started < back, "{}", outcome.output);
    assert!(!outcome.output.contains("[takt] CPU 0 "), "{}", outcome.output);
}
