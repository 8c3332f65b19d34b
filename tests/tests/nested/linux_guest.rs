//! What docs/linux.md says of a Linux guest: its random numbers and its clock.

use takt_tests::{File, Host, Outcome, initrd_with, target};

/// A millisecond, and the little that a clock may lie beside where it was read.
pub const MILLISECOND: i128 = 1_000_000;

/// TSC and time of a stamp on the console.
pub fn stamp(outcome: &Outcome, name: &str) -> (i128, i128) {
    let start = format!("stamp {name} ");
    // The shell's prompt may stand before it. What is no number follows in the echo of the command line.
    let line = outcome.output.lines().find_map(|line| {
        let (_, rest) = line.split_once(&start)?;
        rest.trim().split(' ').all(|number| number.parse::<i128>().is_ok()).then(|| rest.trim())
    });
    let line = line.unwrap_or_else(|| panic!("no stamp {name}\n{}", outcome.output));
    let mut numbers = line.split(' ').map(|number| number.parse().expect("a number"));
    (numbers.next().expect("a TSC"), numbers.next().expect("a time"))
}

/// By how much the clock of one stamp is ahead of another's. The TSC of the lab has 1 GHz, so a difference of stamps
/// is one of nanoseconds.
pub fn ahead(outcome: &Outcome, of: &str, clock: &str) -> i128 {
    let (clock, of) = (stamp(outcome, clock), stamp(outcome, of));
    (clock.1 - of.1) - (clock.0 - of.0)
}

/// What the kernel's clock has lost until a message of its start, which has both what it has counted and what the TSC
/// has: "sched_clock: Marking stable (COUNTED, ...)->(TSC, ...)", in nanoseconds.
fn lost_by_the_kernel(outcome: &Outcome) -> i128 {
    let lost = outcome.output.lines().find_map(|line| {
        let (counted, tsc) = line.split_once("Marking stable (")?.1.split_once(")->(")?;
        let first = |pair: &str| pair.split(',').next()?.parse::<i128>().ok();
        Some(first(tsc)? - first(counted)?)
    });
    lost.unwrap_or_else(|| panic!("no such message\n{}", outcome.output))
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_linux_has_seeded_random_numbers_and_can_set_its_clock_by_the_hosts() {
    let program = env!("CARGO_BIN_EXE_stamp");
    let initrd = initrd_with("linux-guest", &[program.as_ref()]);
    let exec = "stamp first; dmesg | grep 'crng init done'; grep -o -m 1 rdrand /proc/cpuinfo; \
                modprobe ptp_kvm; stamp ptp /dev/ptp0; stamp set /dev/ptp0; stamp corrected; \
                sleep 2; stamp last";
    let file = File::new("1ms")
        .plc("plc", None, "")
        .linux_with(&initrd, exec)
        .schedule("normal")
        .window("plc", 0, 200)
        .save("linux-guest");
    let path = file.to_string_lossy().into_owned();
    let host = Host::new().with("--program", program).with_file(&file);
    let host = ["guest/vmlinuz", "tests/linux-guest.img"]
        .iter()
        .fold(host, |host, image| host.with_file(&target(image)));
    let outcome = host.run("stamps", &[&path]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    // The first commands find a seeded generator.
    outcome.assert_shows("crng init done");
    outcome.assert_shows("\nrdrand");

    let [first, ptp, corrected, last] =
        ["first", "ptp", "corrected", "last"].map(|name| ahead(&outcome, "host-last", name));
    println!(
        "ahead of the host's clock, in ns: the guest's {first}, its PTP clock {ptp}, the guest's once set {corrected}, \
         2 s later {last}"
    );
    // All that it is behind was lost inside of its kernel; 0.17 s have been seen.
    let lost = lost_by_the_kernel(&outcome);
    assert!((first + lost).abs() < MILLISECOND, "{first} {lost}\n{}", outcome.output);
    for clock in [ptp, corrected, last] {
        assert!(clock.abs() < MILLISECOND, "{clock}\n{}", outcome.output);
    }
}
