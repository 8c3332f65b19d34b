//! Channels between partitions and with the host, how Linux finds its own, and what a hostile peer
//! can do with them.

use std::fs;

use takt_tests::{BUSY, File, Outcome, Run, SOON, long, plc_image, root, target};

/// Two PLCs with a sampling and a queuing channel each way, and a busy Linux.
fn two(left: &str, right: &str) -> File {
    File::new("1ms")
        .plc("left", Some(plc_image(left)), "")
        .plc("right", Some(plc_image(right)), "")
        .linux(BUSY)
        .channels("left", "right")
        .channels("right", "left")
        .schedule("normal")
        .window("left", 0, 200)
        .window("right", 400, 200)
}

/// A count in the last line that `peer` has printed in a partition.
fn count(outcome: &Outcome, partition: &str, before: &str) -> u64 {
    let line = outcome.output.lines().rfind(|line| line.contains(&format!("[{partition}] cycle ")));
    let line = line.unwrap_or_else(|| panic!("{partition} says nothing\n{}", outcome.output));
    let words: Vec<&str> = line.split([' ', ',']).filter(|word| !word.is_empty()).collect();
    let at = words.iter().position(|word| *word == before);
    let value = at.and_then(|at| words.get(at + 1)).and_then(|word| word.trim().parse().ok());
    value.unwrap_or_else(|| panic!("no {before} in {line}"))
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn two_plcs_exchange_a_record_each_way_in_every_cycle() {
    let (duration, cycles) = if long() { ("60s", 59_000) } else { ("3s", 1_900) };
    let outcome = two("peer", "peer").run("peers").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    for name in ["left", "right"] {
        outcome.assert_kept_its_time(name, cycles);
        for (what, allowed) in [("wrong", 0), ("hostile", 0), ("refused", 0)] {
            assert_eq!(count(&outcome, name, what), allowed, "{name} {what}\n{}", outcome.output);
        }
        // None is lost, but for the first ones, when only one of the two had started.
        let release = count(&outcome, name, "cycle");
        assert!(release >= cycles, "{release}");
        for what in ["samples", "messages"] {
            let came = count(&outcome, name, what);
            assert!(release - came <= 5, "{came} {what} in {release}\n{}", outcome.output);
        }
        outcome.assert_shows(&format!("[{name}] peer, records of 512 bytes each way"));
    }
    // Right runs 400 us after left in each cycle, and left 600 us after right, if no interrupt of
    // the host falls onto one of them.
    let ages = [("right", 400_000), ("left", 600_000)];
    for (name, age) in ages {
        let oldest = count(&outcome, name, "oldest");
        assert!(oldest.abs_diff(age) < 20_000, "{name} {oldest}\n{}", outcome.output);
    }
}

#[test]
fn a_port_costs_little_more_than_moving_the_bytes() {
    let outcome = two("cost", "cost").run("cost").lasting("300ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let line = outcome.output.lines().find(|line| line.contains("[left] ticks for 512 bytes: "));
    let line = line.unwrap_or_else(|| panic!("no figures\n{}", outcome.output));
    println!("{line}");
    let of = |what: &str| {
        let after = line.split([' ', ',']).skip_while(|word| *word != what).nth(1);
        after.and_then(|word| word.trim().parse::<u64>().ok())
    };
    // 64 words are loaded and stored one by one.
    let moving = 2 * 64;
    for what in ["write", "read", "send", "receive"] {
        assert!(of(what).is_some_and(|ticks| ticks <= moving + 210), "{what}: {line}");
    }
    // A window of four such operations is left once, when the guest is done.
    assert_eq!(outcome.number("left", "vm_exits.min"), 1, "{}", outcome.output);
    assert_eq!(outcome.number("left", "vm_exits.p50"), 1, "{}", outcome.output);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn the_shipped_example_tells_the_others_level() {
    let outcome = Run::of("configs/channel.toml").lasting("3s").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("[upper] the other level is 0.63");
    outcome.assert_shows("[lower] the other level is 0.63");
}

/// A record of a file at the end of a channel: a header of 24 bytes, and a level.
const RECORD: usize = 32;

#[test]
fn the_host_hears_the_level_and_tells_one_by_files() {
    let [heard, told] = ["heard", "told"].map(|name| target(&format!("tests/{name}.records")));
    fs::create_dir_all(target("tests")).unwrap();
    let _ = fs::remove_file(&heard);
    let mut record = [0; RECORD];
    record[20] = 8;
    record[24..].copy_from_slice(&1234.5f64.to_le_bytes());
    fs::write(&told, record.repeat(100)).unwrap();
    let channel = |name: &str, source: &str, destination: &str| {
        format!(
            "[[channel]]\nname = {name:?}\nkind = \"sampling\"\nmessage_bytes = 8\n\
             source = {source:?}\ndestinations = [{destination:?}]\nrefresh_period = \"1s\"\n\
             host_file = \"{name}.records\"\n"
        )
    };
    let text = format!(
        "version = 1\n[system]\nname = \"host-ends\"\nmajor_frame = \"1ms\"\n\
         [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"4MiB\"\n{}{}\
         [[schedule]]\nname = \"normal\"\n[[schedule.window]]\npartition = \"plc\"\n\
         offset = \"0us\"\nduration = \"300us\"\n",
        channel("heard", "plc:level", "host:level"),
        channel("told", "host:level-of-another", "plc:other-level"),
    );
    let outcome = Run::of_text("host-ends", &text).lasting("2600ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("plc", 2_500);
    outcome.assert_shows("[plc] the other level is 1234.500 m");

    let bytes = fs::read(&heard).unwrap();
    let (records, rest) = bytes.as_chunks::<RECORD>();
    assert!(rest.is_empty(), "{} bytes", bytes.len());
    // One each 20 ms, first of all from a tank that fills.
    assert!((120..135).contains(&records.len()), "{}", records.len());
    let word =
        |record: &[u8; RECORD], at| u64::from_le_bytes(record[at..at + 8].try_into().unwrap());
    for (i, pair) in records.windows(2).enumerate() {
        let [earlier, later] = pair else { continue };
        assert!(word(earlier, 0) + 15_000_000 < word(later, 0));
        assert!(i > 50 || f64::from_bits(word(earlier, 24)) < f64::from_bits(word(later, 24)));
        // Written in this frame or the one before, but for the last, which is taken when all guests
        // have been let go; valid, and 8 bytes long.
        let is_last = i + 2 == records.len();
        assert!(is_last || word(later, 8) < 2_000_000, "{}", word(later, 8));
        assert_eq!(word(later, 16), 1 | 8 << 32);
    }
    let ports = outcome.report["host_ports"].as_array().unwrap();
    let messages: Vec<_> = ports.iter().map(|port| port["messages"].as_u64().unwrap()).collect();
    assert_eq!(messages, [records.len() as u64, 100]);
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_hostile_peer_cannot_cost_the_other_a_cycle() {
    let (duration, cycles) = if long() { ("60s", 59_900) } else { ("2500ms", 2_400) };
    let outcome = two("hostile-peer", "peer").run("hostile-peer").lasting(duration).run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_kept_its_time("right", cycles);
    assert_eq!(outcome.number("right", "illegal_accesses"), 0);
    // It is noticed.
    assert!(count(&outcome, "right", "hostile") > 100, "{}", outcome.output);
}

#[test]
fn a_linux_finds_its_ports_and_is_woken_by_a_doorbell() {
    // The shipped example, and a Linux that does by itself what somebody would type.
    let exec = "cd /sys/bus/pci/devices/0000:00:01.0; \
                echo function $(cat vendor device class revision); head -3 resource; \
                table=$(sed -n 2p resource | cut -d' ' -f1); \
                echo table $(for at in 0 4 8; do devmem $((table + at)) 32; done); \
                devmem $table 32 0; echo magic $(devmem $table 32) after a write; \
                dd if=/dev/uio0 of=/tmp/count bs=4 count=1; \
                echo rung, a count of $(stat -c %s /tmp/count) bytes; \
                while :; do cat /proc/kallsyms > /dev/null; done";
    let shipped = fs::read_to_string(root().join("configs/channel-linux.toml"));
    let kernel = format!("cmdline = \"{SOON} takt.exec=\\\"{exec}\\\"\"\nkernel = ");
    let text = shipped
        .expect("the example can be read")
        .replace("kernel = ", &kernel)
        .replace("../target", &target("").to_string_lossy());
    let outcome = Run::of_text("channel-linux", &text).lasting("60s");
    let outcome = outcome.until("rung, a count of 4 bytes").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("function 0x1af4 0x10f0 0x058000 0x01");
    // None; the table, the level and the log; an acknowledgement and the setpoint. The third figure
    // says memory, and prefetchable.
    for bar in [
        "0x0000000000000000 0x0000000000000000 0x0000000000000000",
        "0x00000000d0000000 0x00000000d0003fff 0x0000000000042208",
        "0x00000000d0004000 0x00000000d0005fff 0x0000000000042208",
    ] {
        outcome.assert_shows(bar);
    }
    // "TAKT", the version, and three ports.
    outcome.assert_shows("table 0x544B4154 0x00000008 0x00000003");
    outcome.assert_shows("magic 0x544B4154 after a write");
    // With each of its lines on the console, the first of which comes after 2.5 s.
    outcome.assert_shows("rung, a count of 4 bytes");
    outcome.assert_kept_its_time("plc", outcome.cycles(1_000) - 10);
    assert_eq!(outcome.number("plc", "illegal_accesses"), 0);
}
