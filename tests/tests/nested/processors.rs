//! A Linux with several processors, beside a PLC.
//!
//! The lab has one CPU, and a partition file names each CPU once. So a hook of tests gives a Linux further processors
//! on the CPU that it has: what is exact in the lab is so with them too, and each of them has to wait for the PLC's
//! windows. That they work on CPUs of their own is shown in the lane that has several, whose times mean nothing.

use takt_tests::{File, Host, Outcome, Run, System, long, target};

/// Says how many processors there are, and keeps the first two busy for a second.
const WORK: &str = "echo it has $(nproc); taskset 1 timeout 1 yes > /dev/null & \
                    taskset 2 timeout 1 yes > /dev/null; sleep 1; grep ^cpu[0-9] /proc/stat";

/// Takes processor 1 out, looks for what could take one out of the machine or put one in, and takes it back.
const OUT_AND_IN: &str = "cd /sys/devices/system/cpu; echo 0 > cpu1/online; echo without $(nproc); \
                          echo possible $(cat possible) ejects $(ls /sys/bus/acpi/devices/*/eject | wc -l); \
                          echo 1 > cpu1/online; taskset 2 echo again $(nproc)";

fn file(exec: &str, lines: &str) -> File {
    File::new("1ms")
        .plc("plc", None, "release_guard = \"10us\"")
        .other_linux(&System { exec, ..System::default() })
        .lines(lines)
        .schedule("normal")
        .window("plc", 0, 300)
}

/// User and system time of each processor, in the kernel's jiffies.
fn busy(outcome: &Outcome) -> Vec<u64> {
    let number = |word: Option<&str>| word.and_then(|word| word.parse::<u64>().ok());
    let of = |line: &str| {
        let mut words = line.split_whitespace();
        let first = words.next().filter(|word| word.starts_with("cpu"))?;
        first.strip_prefix("cpu")?.parse::<u32>().ok()?;
        let (user, _, system) = (number(words.next())?, words.next(), number(words.next())?);
        Some(user + system)
    };
    outcome.output.lines().filter_map(of).collect()
}

fn assert_unmoved(outcome: &Outcome) {
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    outcome.assert_punctual("plc");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn processors_work_go_out_and_come_back_and_a_plc_loses_no_release() {
    for more in if long() { &[1, 3][..] } else { &[1] } {
        let exec = format!("{WORK}; {OUT_AND_IN}; poweroff");
        let name = format!("processors-{}", more + 1);
        let hook = format!("more-processors={more}");
        let until = ("reboot: Power down", "\x1dq");
        let run = file(&exec, "").run(&name).hooked(&hook).lasting("60s").typing(&[until]);
        let outcome = run.run();
        assert_eq!(outcome.status, 0, "{}", outcome.output);
        assert_eq!(outcome.partition("linux")["end"], "powered off", "{}", outcome.output);
        let all = more + 1;
        outcome.assert_shows(&format!("it has {all}"));
        outcome.assert_shows(&format!("without {more}"));
        // All are there, none can be put in, and none is a device that could be taken out.
        outcome.assert_shows(&format!("possible 0-{more} ejects 0"));
        outcome.assert_shows(&format!("again {all}"));
        let busy = busy(&outcome);
        assert_eq!(busy.len(), all, "{busy:?}\n{}", outcome.output);
        // A second of both on what a PLC leaves of one CPU.
        assert!(busy[..2].iter().all(|time| *time >= 15), "{busy:?}");
        assert_unmoved(&outcome);
        // What it has had is the sum of its threads': it was 0.71 with two. The first alone had 0.55.
        assert!(outcome.share("linux") > 0.6, "{}", outcome.partition("linux"));
    }
}

/// Ends of a partition that another processor than the first comes to.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn what_any_processor_does_to_the_machine_ends_all_and_all_start_again() {
    // The first time by the register that restarts the machine, then by a triple fault, on processor 1 both times. At
    // last a panic there lets the machine stand still, and the watchdog ends it.
    let forms = [
        ("reset", "", 'b', "partition-reset"),
        ("fault", "reboot=t", 'b', "processor-shutdown"),
        ("panic", "", 'c', "partition-silent"),
    ];
    for (name, words, request, error) in &forms[..if long() { 3 } else { 2 }] {
        let exec = format!(
            "echo it has $(nproc); sleep 1; taskset 2 sh -c 'echo {request} > /proc/sysrq-trigger'"
        );
        let file = file(&exec, "watchdog = \"2s\"").words(words);
        let file = file.health("linux", error, "cold-start");
        let name = format!("processors-{name}");
        let typing = [("it has 2", ""), ("it has 2", "\x1dq")];
        let run = file.run(&name).hooked("more-processors=1").lasting("60s");
        let outcome = run.typing(&typing).run();
        assert_eq!(outcome.status, 0, "{}", outcome.output);
        outcome.assert_shows(&format!("[takt] linux: {error}: "));
        assert!(outcome.number("linux", "restarts") >= 1, "{}", outcome.partition("linux"));
        // It has all of its processors in its second life too.
        let lives = outcome.output.matches("it has 2").count();
        assert!(lives >= 2, "{name}: {lives}\n{}", outcome.output);
        assert_unmoved(&outcome);
    }
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn an_operator_and_a_signal_end_all_processors_whatever_they_do() {
    let busy = "taskset 1 yes > /dev/null & taskset 2 yes > /dev/null &";
    let file = file(&format!("{busy} echo guest ready"), "").save("processors-orders");
    let host = Host::new().hooked().with("--program", env!("CARGO_BIN_EXE_talk")).with_file(&file);
    let host = ["guest/vmlinuz", "guest/initrd.img"]
        .iter()
        .fold(host, |host, image| host.with_file(&target(image)));
    let arguments = [&*file.to_string_lossy(), "--more-processors=1"];
    let outcome = host.run_as("processors-orders", "orders", &arguments);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("[host] takt has ended with 0");
    let linux = outcome.partition("linux");
    assert_eq!(linux["end"], "stopped by takt", "{linux}");
    assert_eq!(linux["restarts"], 2, "{linux}");
    assert_unmoved(&outcome);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn each_processor_is_on_the_cpu_that_the_file_names() {
    let run = Run::of("configs/several-processors.toml").in_lane("emulated").lasting("180s");
    let dialogue = [
        ("linux# ", "echo it has $(nproc); taskset 2 sh -c 'echo on 1: $((40 + 2))'\n"),
        ("on 1: 42", "\x1dq"),
    ];
    let outcome = run.typing(&dialogue).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("it has 2");
    outcome.assert_shows("on 1: 42");
    let linux = outcome.partition("linux");
    assert_eq!(linux["end"], "stopped by takt", "{linux}");
    // The PLC's window leaves 650 us of a millisecond on CPU 0; the other CPU is Linux's own.
    let share = linux["donation"]["minimum_share"].as_f64();
    assert!(share.is_some_and(|share| (1.5..2.0).contains(&share)), "{linux}");
}
