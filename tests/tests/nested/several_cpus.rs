//! Partitions on CPUs of their own. The lane has several CPUs and no times that mean anything.

use takt_tests::{File, Host, Run, plc_image, target};

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_plc_with_a_cpu_to_itself_runs_beside_linux_and_the_cpu_goes_back() {
    let run = Run::of("configs/separate-cpus.toml").in_lane("emulated").lasting("180s");
    let outcome = run.typing(&[("linux# ", "\x1dq")]).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // Its own words are cut where Takt tells of a release that was missed, which it does here.
    assert!(outcome.number("linux", "boot_to_init_ns") > 0, "{}", outcome.output);
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

/// With its processor goes a mapping of Takt's process, and one with the processor that no thread runs. The kernel tells each CPU on which a thread of that runs, which this PLC's
/// does for most of the time.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_that_starts_anew_interrupts_a_plc_on_another_cpu_twice() {
    let image = plc_image("never-done");
    let file = File::new("1ms")
        .plc_on(1, "plc", &format!("image = {image:?}"))
        .linux("echo guest ready")
        .words("quiet")
        .schedule("normal")
        .window("plc", 0, 650)
        .save("new-starts");
    let host = Host::new()
        .with("--lane", "emulated")
        .with("--cpus", "2")
        .with("--memory", "512")
        .with("--program", env!("CARGO_BIN_EXE_talk"));
    let files = [file.clone(), image, target("guest/vmlinuz"), target("guest/initrd.img")];
    let host = files.iter().fold(host, |host, path| host.with_file(path));
    let outcome = host.run("new-starts", &[&file.to_string_lossy(), "4"]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert_eq!(outcome.number("linux", "restarts"), 4, "{}", outcome.output);
    assert!(outcome.number("plc", "overruns") > 0, "{}", outcome.output);
    let told = outcome.output.split_once("[host] CPU 1 has emptied its TLB ");
    let count = told.and_then(|(_, rest)| rest.split(' ').next()?.parse::<u32>().ok());
    // None where that CPU is idle just then.
    assert!(count.is_some_and(|count| (1..=8).contains(&count)), "{count:?}\n{}", outcome.output);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn the_next_takt_removes_what_a_killed_one_has_left_and_the_cpu_goes_back() {
    let file = File::new("1ms")
        .plc_on(1, "plc", "")
        .schedule("normal")
        .window("plc", 0, 300)
        .save("killed-apart");
    let outcome = Host::new()
        .with("--lane", "emulated")
        .with("--cpus", "2")
        .with_file(&file)
        .run("kill-cpuset", &[&file.to_string_lossy()]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("wrong: "), "{}", outcome.output);
    outcome.assert_shows("the next takt has found and removed what was left");
    // It has had the CPU itself, and told so.
    outcome.assert_shows("[takt] CPU 1 has a scheduling domain of its own");
    outcome.assert_shows("[takt] CPU 1 is back in the host's scheduling domain");
}
