//! A Linux with ports: its programs, its shell, and what a hostile one can do.

use std::path::Path;

use takt_tests::{File, Outcome, initrd_with, long, plc_image};

/// A PLC `peer` and a Linux, with a sampling and a queuing channel each way. Linux has the test
/// programs, and executes `exec`; `more` are further lines of its table. It ends when the console shows `done`.
/// The PLC tells what it has seen each second.
fn peer_and_linux(name: &str, exec: &str, more: &str, done: &str) -> Outcome {
    let programs = [
        env!("CARGO_BIN_EXE_exchange"),
        env!("CARGO_BIN_EXE_hostile"),
        env!("CARGO_BIN_EXE_compare"),
        env!("CARGO_BIN_EXE_port-cost"),
    ];
    let initrd = initrd_with(name, &programs.map(Path::new));
    File::new("1ms")
        .plc("plc", Some(plc_image("peer")), "")
        .linux_with(&initrd, exec)
        .lines(more)
        .channels("plc", "linux")
        .channels("linux", "plc")
        .schedule("normal")
        .window("plc", 0, 200)
        .run(name)
        .lasting("90s")
        .until(done)
        .run()
}

/// Shows how a program of Linux's has the two regions of the function mapped.
const SHOW_TYPES: &str = "mount -t debugfs none /sys/kernel/debug; \
    types() { echo $1: $(grep $(sed -n $2p /sys/bus/pci/devices/0000:00:01.0/resource | cut -c1-18) \
    /sys/kernel/debug/x86/pat_memtype_list); }; \
    takt-port watch in --hex | { read line; types 'to read' 2; types 'to write' 3; }; ";

/// What the PLC has seen, by its last line.
fn plc_counts(outcome: &Outcome, what: &str) -> u64 {
    let line = outcome.output.lines().rfind(|line| line.contains("[plc] cycle "));
    let line = line.unwrap_or_else(|| panic!("the PLC says nothing\n{}", outcome.output));
    let (_, rest) = line.split_once(&format!("{what} ")).unwrap_or_else(|| panic!("{line}"));
    let digits = rest.split(|c: char| !c.is_ascii_digit()).next();
    digits.and_then(|digits| digits.parse().ok()).unwrap_or_else(|| panic!("{line}"))
}

#[test]
fn a_plc_and_a_linux_exchange_records_and_the_shell_goes_on_where_the_program_stopped() {
    let count = if long() { 55_000 } else { 1_000 };
    let outcome = peer_and_linux(
        "linux-exchange",
        &format!(
            "exchange {count}; takt-port list; takt-port status; {SHOW_TYPES}\
             takt-port recv receive --hex --timeout 1s | cut -c1-32; \
             takt-port recv in; status=$?; sleep 1; echo status $status"
        ),
        "",
        "\nstatus 4",
    );
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("exchange: all right");
    outcome.assert_shows("receive  queuing   destination  512    4      refuse  -        no");
    for what in ["to read", "to write"] {
        let line = outcome.output.lines().find(|line| line.starts_with(&format!("{what}: ")));
        assert!(line.is_some_and(|line| line.ends_with("write-back")), "{what}: {line:?}");
    }
    // No record lies between the program's last one and the shell's.
    let next = u64::to_le_bytes(count + 1).map(|byte| format!("{byte:02x}")).concat();
    outcome.assert_shows(&next.repeat(2));
    outcome.assert_shows("takt-port: port in is a sampling port");
    outcome.assert_shows("status 4");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    for what in ["wrong", "hostile"] {
        assert_eq!(plc_counts(&outcome, what), 0, "{what}\n{}", outcome.output);
    }
}

/// What it costs by the caches' way and by memory's. The lab has no caches: the two are as long there, and that
/// they are is all that it can show.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_message_takes_linux_as_many_instructions_cached_as_uncached() {
    let exec = format!(
        "{SHOW_TYPES}port-cost cached; mv /dev/mem /dev/hidden; {SHOW_TYPES}port-cost uncached; \
         sleep 1; echo status $?"
    );
    let outcome = peer_and_linux("linux-port-cost", &exec, "", "\nstatus ");
    for what in ["to read: ", "to write: "] {
        let types = outcome.output.lines().filter(|line| line.starts_with(what));
        let types: Vec<&str> = types.filter_map(|line| line.split(' ').next_back()).collect();
        assert_eq!(types, ["write-back", "uncached-minus"], "{what}\n{}", outcome.output);
    }
    let figures = |way: &str| -> [u64; 2] {
        let line =
            outcome.output.lines().find(|line| line.starts_with(&format!("port-cost {way}: ")));
        let line = line.unwrap_or_else(|| panic!("nothing of {way}\n{}", outcome.output));
        println!("{line}");
        let after = |what: &str| -> Option<u64> {
            line.split(' ').skip_while(|word| *word != what).nth(1)?.parse().ok()
        };
        ["write", "read"].map(|what| after(what).unwrap_or_else(|| panic!("{line}")))
    };
    let (cached, uncached) = (figures("cached"), figures("uncached"));
    for (cached, uncached) in cached.iter().zip(uncached) {
        assert!(cached.abs_diff(uncached) <= 4, "{cached} and {uncached}");
        // 64 words are loaded and stored one by one, and the protocol comes to it.
        assert!((128..=600).contains(cached), "{cached}");
    }
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_that_starts_again_finds_its_ports_in_order() {
    let limit = "restarts = { at_most = 1, within = \"60s\" }";
    let outcome = peer_and_linux("linux-restart", "exchange 200; reboot -f", limit, "within 60s");
    // A partition whose last life ended with a restart has failed.
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    let done = outcome.output.matches("exchange: all right").count();
    assert_eq!(done, 2, "{}", outcome.output);
    assert_eq!(outcome.number("linux", "restarts"), 1, "{}", outcome.output);
    outcome.assert_shows("asked for a restart -> idle: started again 1 time within 60s");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    // Its own records begin anew with each life, which the PLC counts as wrong; nothing that it
    // found was impossible.
    assert_eq!(plc_counts(&outcome, "hostile"), 0, "{}", outcome.output);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_that_writes_to_all_of_its_device_harms_no_other() {
    let (seeds, steps) = if long() { ("1 2 3 4 5 6 7 8", 100_000) } else { ("1 2", 5_000) };
    let exec =
        format!("for seed in {seeds}; do hostile $seed {steps}; done; sleep 1; echo survived");
    let outcome = peer_and_linux("linux-hostile", &exec, "", "\nsurvived");
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("survived");
    let done = outcome.output.matches("table unchanged").count();
    assert_eq!(done, seeds.split(' ').count(), "{}", outcome.output);
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    assert_eq!(outcome.number("plc", "illegal_accesses"), 0);
    // It is noticed at both ends.
    assert!(plc_counts(&outcome, "hostile") > 0, "{}", outcome.output);
    assert!(outcome.number("linux", "illegal_accesses") > 1_000, "{}", outcome.output);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn channels_are_compared_with_what_linux_has_of_its_own() {
    let exec = "ifconfig lo up; modprobe vsock_loopback; compare 2000; echo status $?";
    let outcome = peer_and_linux("linux-compare", exec, "", "\nstatus ");
    outcome.assert_shows("status 0");
    assert!(!outcome.output.contains("not measured"), "{}", outcome.output);
    // Figures to report, not to test.
    let table = outcome.output.lines().skip_while(|line| !line.starts_with("compare: "));
    table.take_while(|line| !line.starts_with("status")).for_each(|line| println!("{line}"));
}
