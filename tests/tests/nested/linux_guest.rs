//! What docs/linux.md says of a Linux guest: its random numbers and its clock.

use takt_tests::{File, Host, Outcome, initrd_with, target};

/// TSC and time of day of a stamp on the console.
fn stamp(outcome: &Outcome, name: &str) -> (i128, i128) {
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

#[test]
fn a_linux_has_seeded_random_numbers_and_its_clock_goes_by_the_tsc() {
    let program = env!("CARGO_BIN_EXE_stamp");
    let initrd = initrd_with("linux-guest", &[program.as_ref()]);
    let exec = "stamp first; dmesg | grep 'crng init done'; sleep 2; stamp last";
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
    // The commands find a seeded generator.
    outcome.assert_shows("crng init done");
    // The TSC of the lab has 1 GHz, so a difference of stamps is one of nanoseconds.
    let [first, last] = ["first", "last"].map(|name| {
        let (guest, host) = (stamp(&outcome, name), stamp(&outcome, &format!("host-{name}")));
        (guest.1 - host.1) - (guest.0 - host.0)
    });
    println!("the guest's clock is {first} ns ahead of the host's, {last} ns at the end");
    // 169 ms have been seen.
    assert!(first.abs() < 1_000_000_000, "{first}\n{}", outcome.output);
    // From then on it goes by the same TSC.
    assert!((last - first).abs() < 1_000_000, "{first} {last}");
}
