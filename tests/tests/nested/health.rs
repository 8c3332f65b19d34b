//! What the health monitor makes of errors.

use takt_tests::{File, initrd_of, long, plc_image, restarting_kernel, silent_kernel, target};

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_plc_starts_again_as_its_table_says_until_it_does_so_too_often() {
    // The short form of `health_table` has one start of each kind before it is too often.
    // Each of the failing guests lives for 100 cycles: those in each quarter of the frame a fifth of
    // a second, and the one that ends the run four times as long.
    let failing = || Some(plc_image("failing-starts"));
    let limit = "restarts = { at_most = 2, within = \"60s\" }";
    let mut file = File::new("8ms")
        .plc("good", None, "")
        .plc("warm", failing(), limit)
        .plc("cold", failing(), limit)
        .plc("last", failing(), "")
        .health("warm", "numeric-error", "warm-start")
        .health("cold", "numeric-error", "cold-start")
        .health("cold", "application-error", "ignore")
        .health("last", "numeric-error", "shut-down")
        .schedule("normal")
        .window("last", 1_500, 200);
    for quarter in [0, 2_000, 4_000, 6_000] {
        file = file.window("good", quarter, 200).window("warm", quarter + 500, 200).window(
            "cold",
            quarter + 1_000,
            200,
        );
    }
    let outcome = file.run("health").lasting("5s").run();
    assert_eq!(outcome.status, 4, "{}", outcome.output);

    // The neighbour notices nothing of four starts.
    outcome.assert_kept_its_time("good", 390);
    let shown = |text: &str| outcome.output.matches(text).count();
    for (name, action) in [("warm", "warm-start"), ("cold", "cold-start")] {
        let fault =
            format!("[takt] {name}: numeric-error: divide error (vector 0, error code 0x0)");
        assert_eq!(shown(&fault), 3, "{}", outcome.output);
        assert_eq!(outcome.number(name, "restarts"), 2, "{}", outcome.output);
        outcome.assert_kept_its_time(name, 300);
        let events = &outcome.partition(name)["events"];
        let list = events["list"].as_array().map_or(&[][..], Vec::as_slice);
        let actions: Vec<_> = list
            .iter()
            .filter(|event| event["error"] == "numeric-error")
            .map(|event| event["action"].as_str().unwrap_or(""))
            .collect();
        assert_eq!(actions, [action, action, "idle"], "{}", outcome.output);
        assert!(list.is_sorted_by_key(|event| event["at_ns"].as_u64()), "{events}");
        assert_eq!(outcome.number(name, "events.totals.application-error"), 3);
    }
    assert_eq!(shown("-> idle: started again 2 times within 60s"), 2, "{}", outcome.output);

    // A warm start keeps the count, a cold one does not, and both are told of.
    for start in [
        "[warm] cold start, condition 0, retained 0",
        "[warm] warm start, condition 3, retained 1",
        "[warm] warm start, condition 3, retained 2",
        "[cold] cold start, condition 0, retained 0",
        "[cold] cold start, condition 3, retained 0",
    ] {
        outcome.assert_shows(start);
    }

    // The application's own errors are told where they are not ignored.
    let said = "application-error: code 7: valve 3 does not follow -> log";
    assert_eq!(shown(&format!("[takt] warm: {said}")), 3, "{}", outcome.output);
    assert_eq!(shown(&format!("[takt] cold: {said}")), 0, "{}", outcome.output);

    // The last one has ended the run long before its time.
    let lines = outcome.output.lines().filter(|line| line.contains("[takt] last: numeric-error: "));
    let ends = lines.filter(|line| line.contains("-> shut-down")).count();
    assert_eq!(ends, 1, "{}", outcome.output);
    let duration = outcome.report["duration_ns"].as_u64().unwrap_or(0);
    assert!((800_000_000..2_000_000_000).contains(&duration), "{duration} ns");
}

#[test]
fn restarts_cost_a_neighbour_nothing_and_takt_does_not_grow() {
    // Two PLCs that live for a fifth of a second each, one of them started cold and warm in turns,
    // and a kernel that is silent for 100 ms and asks for a restart after some milliseconds in turns.
    let (starts, duration) = if long() { (100, "40s") } else { (5, "1800ms") };
    let limit = format!("restarts = {{ at_most = {starts}, within = \"86400s\" }}");
    let mut file = File::new("8ms")
        .plc("good", None, "")
        .plc("warm", Some(plc_image("failing-starts")), &limit)
        .plc("turns", Some(plc_image("alternating-starts")), &limit)
        .lines(&format!(
            "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
             memory = \"64MiB\"\nkernel = {:?}\nwatchdog = \"1s\"\n{limit}",
            restarting_kernel()
        ))
        .health("warm", "numeric-error", "warm-start")
        .health("turns", "numeric-error", "warm-start")
        .health("turns", "illegal-request", "cold-start")
        .schedule("normal");
    for quarter in [0, 2_000, 4_000, 6_000] {
        file = file.window("good", quarter, 200).window("warm", quarter + 500, 200).window(
            "turns",
            quarter + 1_000,
            200,
        );
    }
    let outcome = file.run("restarts").lasting(duration).run();
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    for name in ["warm", "turns", "linux"] {
        assert_eq!(outcome.number(name, "restarts"), starts, "{}", outcome.output);
    }
    for name in ["warm", "turns"] {
        outcome.assert_kept_its_time(name, 100 * starts);
    }
    let failures = |error: &str| outcome.number("turns", &format!("events.totals.{error}"));
    assert!(failures("numeric-error").abs_diff(failures("illegal-request")) <= 1);
    assert_eq!(failures("numeric-error") + failures("illegal-request"), starts + 1);
    let ends = |error: &str| outcome.number("linux", &format!("events.totals.{error}"));
    assert!(ends("partition-silent").abs_diff(ends("partition-reset")) <= 1);
    assert_eq!(ends("partition-silent") + ends("partition-reset"), starts + 1);
    outcome.assert_shows("linux: partition-silent: no heartbeat for 100ms -> cold-start");
    outcome.assert_kept_its_time("good", 100 * starts);
    outcome.assert_punctual("good");
    outcome.assert_not_grown(1 << 20);
}

/// What is prepared behind a Linux, such as another one with much memory, takes nothing of the time that its watchdog gives it.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_watchdog_counts_from_the_first_instruction_of_its_linux() {
    let linux = |name: &str, more: &str| {
        format!(
            "[[partition]]\nname = {name:?}\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
             kernel = {:?}\n{more}",
            silent_kernel()
        )
    };
    let outcome = File::new("1ms")
        .lines("control = \"watchdog-from-start.sock\"")
        .plc("plc", None, "")
        .lines(&linux("watched", "memory = \"64MiB\"\nwatchdog = \"1s\""))
        .lines(&linux("large", "memory = \"640MiB\"\nhuge_pages = \"none\"\nconsole = \"control\""))
        .schedule("normal")
        .window("plc", 0, 200)
        .run("watchdog-from-start")
        .lasting("500ms")
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let prepared = outcome.report["process"]["starting"]["first_release_ns"].as_u64().unwrap_or(0);
    assert!(prepared > 1_100_000_000, "{prepared}");
    assert!(!outcome.output.contains("partition-silent"), "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 490);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_debian_that_restarts_a_hundred_times_costs_a_neighbour_nothing_and_takt_does_not_grow() {
    // It restarts by the reset register, by a triple fault and by a panic, as it happens, and says which
    // by the kernel's console, which needs no interrupts. The PLC that starts cold and warm in turns
    // lives nearly as long as a start of the kernel takes.
    let init = "/busybox mkdir /proc /sys\n\
                /busybox mount -t proc proc /proc\n\
                /busybox mount -t sysfs sysfs /sys\n\
                /busybox mknod /dev/kmsg c 1 11\n\
                say() { echo \"<0>$* under $(/busybox uname -r)\" >/dev/kmsg; }\n\
                case $(/busybox head -c 1 /proc/sys/kernel/random/uuid) in\n\
                [0-5]) say a reset ;;\n\
                [6-9a]) say a triple fault; echo triple >/sys/kernel/reboot/type ;;\n\
                *) say a panic; echo c >/proc/sysrq-trigger ;;\n\
                esac\n\
                /busybox reboot -f";
    let starts = 100;
    let limit = format!("restarts = {{ at_most = {starts}, within = \"86400s\" }}");
    let mut file = File::new("16ms")
        .plc("good", None, "")
        .plc("turns", Some(plc_image("alternating-starts")), &limit)
        .lines(&format!(
            "[[partition]]\nname = \"linux\"\nkind = \"linux\"\ncpu = 0\nbackground = true\n\
             memory = \"96MiB\"\nkernel = {:?}\ninitrd = {:?}\n\
             cmdline = \"console=ttyS0 loglevel=1 panic=-1\"\n{limit}",
            target("guest/vmlinuz"),
            initrd_of("restarting", init),
        ))
        .health("linux", "processor-shutdown", "cold-start")
        .health("turns", "numeric-error", "warm-start")
        .health("turns", "illegal-request", "cold-start")
        .schedule("normal")
        .window("turns", 1_000, 200);
    for quarter in [0, 4_000, 8_000, 12_000] {
        file = file.window("good", quarter, 200);
    }
    let outcome = file.run("debian-restarts").lasting("200s").given_up_after(5_400).run();
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    for name in ["turns", "linux"] {
        assert_eq!(outcome.number(name, "restarts"), starts, "{}", outcome.output);
    }
    let ends = |error: &str| outcome.number("linux", &format!("events.totals.{error}"));
    let (resets, faults) = (ends("partition-reset"), ends("processor-shutdown"));
    assert_eq!(resets + faults, starts + 1, "{}", outcome.output);
    let said = |what: &str| outcome.output.matches(&format!("{what} under ")).count() as u64;
    let (reset, fault, panic) = (said("a reset"), said("a triple fault"), said("a panic"));
    assert_eq!((reset + panic, fault), (resets, faults), "{}", outcome.output);
    outcome.assert_kept_its_time("turns", 100 * starts);
    outcome.assert_kept_its_time("good", 400 * starts);
    outcome.assert_punctual("good");
    outcome.assert_not_grown(1 << 20);
    assert!([reset, fault, panic].iter().all(|count| *count > 10), "{reset}, {fault}, {panic}");
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_watchdog_does_not_run_while_the_schedule_has_no_window_for_its_linux() {
    let outcome = File::new("10ms")
        .plc("plc", None, "")
        .linux("")
        .in_windows()
        .lines("watchdog = \"4s\"")
        .schedule("normal")
        .window("plc", 0, 200)
        .window("linux", 500, 8_000)
        .schedule("alone")
        .window("plc", 0, 200)
        .run("watchdog-without-windows")
        .lasting("12s")
        .typing(&[("linux# ", "\x1ds")])
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("schedule \"alone\" holds since ");
    assert!(!outcome.output.contains("it does not leave its processor"), "{}", outcome.output);
    assert_eq!(outcome.number("linux", "restarts"), 0, "{}", outcome.output);
    // It had no window for longer than the watchdog waits.
    let report = &outcome.report;
    let [end, switched] = [&report["duration_ns"], &report["schedule"]["last_switch_ns"]]
        .map(|instant| instant.as_u64().unwrap_or_default());
    assert!(switched > 0 && end - switched > 5_000_000_000, "{switched} of {end}");
    outcome.assert_kept_its_time("plc", outcome.cycles(10_000) - 10);
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_linux_that_panics_or_whose_programs_hang_is_noticed_by_its_watchdog() {
    // It runs for longer than the watchdog waits, and then its kernel panics and stays where it is;
    // after that its feeder is stopped.
    let status = "/sys/class/watchdog/watchdog0/bootstatus";
    let exec = format!(
        "was=$(cat {status}); echo status $was; sleep 6; if [ $was = 0 ]; \
         then echo c > /proc/sysrq-trigger; else killall -STOP watchdog; sleep 60; fi"
    );
    let outcome = File::new("1ms")
        .plc("plc", None, "release_guard = \"10us\"")
        .linux(&exec)
        .lines("watchdog = \"4s\"\nrestarts = { at_most = 1, within = \"60s\" }")
        .schedule("normal")
        .window("plc", 0, 300)
        .run("watchdog")
        .lasting("34s")
        .run();
    assert_eq!(outcome.status, 4, "{}", outcome.output);
    outcome.assert_shows("status 0");
    outcome.assert_shows("Kernel panic - not syncing: sysrq triggered crash");
    outcome.assert_shows("linux: partition-silent: no heartbeat for 4s -> cold-start");
    // WDIOF_CARDRESET, in the kernel's include/uapi/linux/watchdog.h.
    outcome.assert_shows("status 32");
    outcome.assert_shows("no heartbeat for 4s -> idle: started again 1 time within 60s");
    assert_eq!(outcome.number("linux", "events.totals.partition-silent"), 2);
    outcome.assert_kept_its_time("plc", 30_000);
}
