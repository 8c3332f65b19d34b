//! Shared hardware: memory in huge pages, what it wins, that restarts find it cleared; and what is refused
//! since the host has it not.

use std::fs;

use takt_tests::{File, Host, Outcome, plc_image, root, target};

use crate::doctor::doctor;

/// A PLC that lives for a fifth of a second and starts warm, a good one, and a Linux.
fn run(pages: &str) -> Outcome {
    let pages_line = format!("huge_pages = {pages:?}");
    File::new("2ms")
        .plc("good", None, &pages_line)
        .plc("warm", Some(plc_image("failing-starts")), &pages_line)
        .linux("poweroff -f")
        .lines(&pages_line)
        .health("warm", "numeric-error", "warm-start")
        .schedule("normal")
        .window("good", 0, 200)
        .window("warm", 500, 200)
        .run(&format!("huge-pages-{pages}"))
        .lasting("3s")
        .run()
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn memory_in_huge_pages_is_ready_sooner_and_is_cleared_at_each_start() {
    let [small, huge] = ["none", "2MiB"].map(run);
    for (outcome, page) in [(&small, 4 << 10), (&huge, 2 << 20)] {
        outcome.assert_kept_its_time("good", 1_400);
        outcome.assert_punctual("good");
        for name in ["good", "warm", "linux"] {
            assert_eq!(outcome.number(name, "memory_page_bytes"), page, "{}", outcome.output);
        }
        // Three starts are allowed, and each finds only what is retained.
        assert_eq!(outcome.number("warm", "restarts"), 3, "{}", outcome.output);
        for retained in 0..=3 {
            outcome.assert_shows(&format!(", retained {retained}"));
        }
        assert_eq!(outcome.partition("linux")["end"], "powered off", "{}", outcome.output);
    }
    huge.assert_shows("[takt] linux: 128MiB in 64 huge pages of 2MiB");
    let of = |outcome: &Outcome| {
        let clearing = outcome.report["process"]["starting"]["clearing_ns"].as_u64();
        (clearing.expect("a report"), outcome.number("linux", "boot_to_init_ns"))
    };
    let (small, huge) = (of(&small), of(&huge));
    println!("clearing and boot to init: small {small:?}, huge {huge:?} ns");
    assert!(huge.0 < small.0 && huge.1 < small.1, "{huge:?}, {small:?}");
}

/// A machine of less than 2 GiB has no two pages of 1 GiB, if its processor has them at all.
#[test]
fn huge_pages_that_the_host_does_not_have_are_refused_with_what_to_do() {
    let outcome = File::new("1ms")
        .plc_with("plc", "memory = \"1GiB\"\nhuge_pages = \"1GiB\"")
        .schedule("normal")
        .window("plc", 0, 200)
        .run("huge-pages-refused")
        .lasting("1s")
        .run();
    assert_eq!(outcome.status, 3, "{}", outcome.output);
    outcome.assert_shows("huge pages of 1GiB");
    outcome.assert_shows("huge_pages = \"none\"");
}

/// The lab's processors do not tell of bus locks.
#[test]
fn a_limit_on_bus_locks_that_the_host_cannot_keep_is_refused() {
    let outcome = File::new("1ms")
        .plc("plc", None, "bus_locks = { at_most = 1, within = \"1s\" }")
        .schedule("normal")
        .window("plc", 0, 200)
        .run("bus-locks-refused")
        .lasting("1s")
        .run();
    assert_eq!(outcome.status, 3, "{}", outcome.output);
    outcome.assert_shows("partition plc: this host's KVM does not tell of bus locks");
}

/// The lab's processors divide nothing.
#[test]
fn a_share_of_the_cache_that_the_host_cannot_divide_is_refused() {
    let outcome = File::new("1ms")
        .plc("plc", None, "cache = 2")
        .schedule("normal")
        .window("plc", 0, 200)
        .run("cache-refused")
        .lasting("1s")
        .run();
    assert_eq!(outcome.status, 3, "{}", outcome.output);
    outcome.assert_shows("this host cannot divide its cache");
    outcome.assert_shows("leave `cache` and `memory_bandwidth` out of the partition file");
}

/// Bochs's processor says that it can divide its cache and the way to memory, and so the kernel's resctrl is there: its
/// files, what it refuses, and the classes that it gives to threads. That nothing is divided there no kernel can see.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn the_kernels_own_resctrl_has_the_shares_during_a_run_and_nothing_after_it() {
    let file = |plc, linux| {
        File::new("1ms")
            .plc("plc", None, plc)
            .linux("poweroff -f")
            .lines(linux)
            .schedule("normal")
            .window("plc", 0, 300)
    };
    let divided = file("cache = 4", "memory_bandwidth = 30").save("divided");
    let plain = file("", "").save("undivided");
    let files = [&divided, &plain, &target("guest/vmlinuz"), &target("guest/initrd.img")];
    let machine = Host::new().with("--lane", "vmx").allocating();
    let outcome = files
        .into_iter()
        .fold(machine, |machine, file| machine.with_file(file))
        .with("--program", &doctor().to_string_lossy())
        .run("divide-cache", &[&divided.to_string_lossy(), &plain.to_string_lossy()]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("wrong: "), "{}", outcome.output);
    outcome.assert_shows("plc: L3:0=f; linux: L3:0=fff0, MB:0=30");
    outcome.assert_shows("== all is as it was");
    // The tracer takes time in the windows, so the releases need not be exact.
    outcome.assert_kept_its_time("plc", 2_980);
    assert_eq!(outcome.partition("linux")["end"], "powered off", "{}", outcome.output);
    let left = |name| {
        let path = target("tests/divide-cache.out").join(name);
        fs::read_to_string(path).expect("the script leaves it")
    };
    // The tests of units go by this record; a newer kernel has more files.
    let file = root().join("vmm/host/tests/hosts/resctrl-emulated.host");
    let known = fs::read_to_string(file).expect("the record is there");
    let record = left("record");
    for part in known.split("== ").filter(|part| part.starts_with("sys/")) {
        assert!(record.contains(&format!("== {part}")), "{part}\n{record}");
    }
    let groups = left("groups");
    let of_takt = groups.lines().filter(|line| !line.ends_with(KVMS_THREAD));
    assert_eq!(of_takt.collect::<Vec<_>>(), SHARES.lines().collect::<Vec<_>>());
    let classes = left("classes");
    for thread in classes.lines() {
        let mut words = thread.split_whitespace();
        let count: u32 = words.next().and_then(|count| count.parse().ok()).expect("a count");
        let (allowed, least): (&[&str], u32) = match words.next() {
            Some("plc") => (&["100000000"], 1_901),
            Some("linux") => (&["200000000"], 1_901),
            Some("loader") => (&["0", "200000000"], 1),
            Some(KVMS_THREAD) if groups.contains(KVMS_THREAD) => (&["100000000", "200000000"], 1),
            _ => (&["0"], 1),
        };
        assert!(words.next_back().is_some_and(|class| allowed.contains(&class)), "{classes}");
        assert!(count >= least, "{classes}");
    }
    assert!(classes.contains(" plc ") && classes.contains(" linux "), "{classes}");
}

/// The thread by which a newer kernel gives a guest's large pages back. It is in the group of the vCPU's thread that starts it.
const KVMS_THREAD: &str = "kvm-nx-lpage-re";

/// What the groups have, and the threads in those of Takt's. The same is in `vmm/src/resctrl/setup_tests.rs`.
const SHARES: &str = "\
== sys/fs/resctrl/schemata
    MB:0= 100
    L3:0=fff0
== sys/fs/resctrl/takt-linux/schemata
    MB:0=  30
    L3:0=fff0
== sys/fs/resctrl/takt-plc/schemata
    MB:0= 100
    L3:0=000f
takt-plc: plc
takt-linux: loader
takt-linux: linux
";
