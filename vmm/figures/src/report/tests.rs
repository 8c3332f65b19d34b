//! The report: as JSON, read back, and as a table.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;
use takt_scheduler::time::Nanos;

use super::*;
use crate::cause::{Cause, Explanation};
use crate::worst::{LateStart, LongScan};

#[test]
fn a_start_is_told_with_and_without_its_whole_time() {
    let starting = report().process.starting;
    let told = "guest memory cleared in 16.1 ms, first release 33.3 ms after the command";
    let placed = format!("{told}, 0.4 ms of them for its place to the host's tick");
    assert_eq!(starting.to_string(), placed);
    assert_eq!(Starting { aligning_ns: 0, ..starting }.to_string(), told);
    let partly = Starting { first_release_ns: None, ..starting };
    assert_eq!(partly.to_string(), "guest memory cleared in 16.1 ms");
}

fn report() -> Report {
    let summary = Summary { min: 0, p50: 2, p99: 4, p999: 4, max: 1_500 };
    Report {
        schema_version: SCHEMA_VERSION,
        lane: "lab".into(),
        emulator: Some("QEMU 7.2.22".into()),
        host: Host {
            kernel: "6.1.0-rt".into(),
            preempt_rt: true,
            cpu: "QEMU".into(),
            tsc_khz: 1_000_000,
        },
        system: "demo".into(),
        epoch_tsc: 1,
        duration_ns: 10_000_000_000,
        kick: true,
        tick: Tick {
            period_ns: 4_000_000,
            clear: Some(Clear::Windows),
            margin_ns: 337_500,
            crept_ns: 3,
        },
        schedule: Schedule {
            current: "normal".into(),
            next: "normal".into(),
            last_switch_ns: None,
        },
        partitions: vec![
            Partition {
                memory_page_bytes: 4096,
                name: "plc".into(),
                kind: "plc".into(),
                end: "stopped by takt".into(),
                failed: false,
                restarts: 0,
                cpu_share: 0.031,
                events: Events {
                    totals: [("numeric-error".into(), 2)].into(),
                    ..Events::default()
                },
                illegal_accesses: 0,
                console_dropped: 0,
                releases: Some(Releases {
                    releases: 10_000,
                    start_up_windows: 1,
                    lost: 0,
                    late_releases: 0,
                    overruns: 0,
                    unfinished_windows: 0,
                    unrecorded: 0,
                    release_latency_ns: Some(summary),
                    execution_ns: None,
                    wake_up_latency_ns: Some(summary),
                    release_guard_ns: None,
                    entry_ns: None,
                    exit_ns: None,
                    overrun_ns: None,
                    kick_ns: None,
                    vm_exits: None,
                    late_starts: Vec::new(),
                    longest_scans: Vec::new(),
                }),
                wake_ups: Some(WakeUps { early: 7, divided: 2, steered: 3 }),
                donation: None,
                deadlines: None,
                power_off: None,
                operator: Some(Operator {
                    written: 3,
                    forced: 2,
                    at_the_end: vec![Forced {
                        name: "tank.level".to_owned(),
                        text: "1.5".to_owned(),
                        since_ns: 1_000_000,
                    }],
                }),
                nets: Vec::new(),
                vsock: None,
                held_up: false,
                boot_to_init_ns: None,
                stuck: None,
            },
            Partition {
                memory_page_bytes: 4096,
                name: "linux".into(),
                kind: "linux".into(),
                end: "stopped by takt".into(),
                failed: false,
                restarts: 0,
                cpu_share: 0.9,
                events: Events::default(),
                illegal_accesses: 3,
                console_dropped: 0,
                releases: None,
                wake_ups: None,
                donation: Some(Donation {
                    offered_ns: 9_000_000_000,
                    received_ns: 8_910_000_000,
                    minimum_share: 0.65,
                }),
                deadlines: Some(Deadlines { programmed: 900, moved: 30, put_back: 20 }),
                operator: None,
                power_off: Some(PowerOff { asked_ns: 9_000_000_000, took_ns: Some(412_345_678) }),
                nets: vec![Net {
                    tap: "takt0".into(),
                    to_guest: Some(Traffic { packets: 5, bytes: 600, dropped: 1 }),
                    from_guest: Some(Traffic { packets: 7, bytes: 800, dropped: 0 }),
                    refused_queues: 2,
                }],
                vsock: Some(Vsock { cid: 3, refused_queues: 1 }),
                held_up: true,
                boot_to_init_ns: Some(None),
                stuck: Some(Some(Stuck { how: How::Spinning, since_ns: 5_120_000_000 })),
            },
        ],
        window_enforcers: vec![WindowEnforcer { cpu: 0, wake_ups: WakeUps::default() }],
        host_ports: vec![HostPort {
            channel: "state".into(),
            port: "levels".into(),
            messages: 12,
            dropped: 3,
            ..HostPort::default()
        }],
        process: Process {
            start: None,
            end: None,
            starting: Starting {
                first_release_ns: Some(33_300_000),
                clearing_ns: 16_080_000,
                aligning_ns: 400_000,
            },
        },
        output: Output::default(),
    }
}

#[test]
fn the_json_has_the_keys_that_its_readers_rely_on() {
    let json = serde_json::to_value(report()).unwrap();
    assert_eq!(json["schema_version"], 3);
    let plc = &json["partitions"][0];
    for key in ["name", "releases", "lost", "late_releases", "overruns", "cpu_share"] {
        assert!(!plc[key].is_null(), "{key}");
    }
    for key in ["min", "p50", "p99", "p999", "max"] {
        assert!(plc["release_latency_ns"][key].is_u64(), "{key}");
    }
    assert!(plc.get("boot_to_init_ns").is_none());
    assert_eq!(plc["wake_ups"], serde_json::json!({"early": 7, "divided": 2, "steered": 3}));
    assert_eq!(json["window_enforcers"][0]["cpu"], 0);
    assert!(json["window_enforcers"][0]["wake_ups"]["early"].is_u64());
    let linux = json["partitions"][1].as_object().unwrap();
    assert!(linux["boot_to_init_ns"].is_null());
    assert_eq!(linux["stuck"]["how"], "spinning");
    assert!(!linux.contains_key("releases"));
    assert_eq!((plc.get("held_up"), &linux["held_up"]), (None, &true.into()));
}

#[test]
fn a_report_is_read_as_it_was_written() {
    let mut written = report();
    written.partitions[1].stuck = Some(None);
    let text = serde_json::to_string(&written).unwrap();
    let read: Report = serde_json::from_str(&text).unwrap();
    assert_eq!(serde_json::to_string(&read).unwrap(), text);
    // What is `null` and what is not there are not the same.
    assert_eq!(read.partitions[1].stuck, Some(None));
    assert_eq!(read.partitions[0].stuck, None);
    assert!(read.partitions[1].releases.is_none());
}

#[test]
fn the_table_shows_every_partition_and_what_went_wrong() {
    let table = report().table();
    assert!(table.contains("demo: 10.000 s, lane lab, kernel 6.1.0-rt, PREEMPT_RT"));
    assert!(table.contains("\nemulated by QEMU 7.2.22\n"));
    let operators =
        "  operators      values written 3, forced 2; at the end were forced tank.level := 1.5\n";
    assert!(table.contains(operators), "{table}");
    assert!(table.contains("  power off      asked at the end, off by itself after 0.412 s\n"));
    assert!(
        table.contains("  network        takt0: to it 5 packets, 600 bytes, 1 dropped; from it 7 ")
    );
    assert!(table.contains("; 2 times its driver's queues could not be used\n"));
    assert!(table.contains("releases       10000   lost 0   late 0   overruns 0"));
    assert!(table.contains("release latency         0.000      0.002"), "{table}");
    assert!(table.contains("donation       9.000 s left by windows, 99.0 % of it used;"));
    assert!(table.contains("boot to init   not seen"));
    assert!(table.contains("kernel         spins with interrupts off since 5.120 s"), "{table}");
    assert!(table.contains("\n  clock steered  7 early wake-ups corrected, "), "{table}");
    assert!(!table.contains("window enforcer"), "{table}");
    assert!(table.contains("host:levels (state): 12 messages, 3 clients dropped"), "{table}");
    assert!(table.contains("  devices        held up by a program of the host,"), "{table}");
    assert!(table.contains("  errors         numeric-error 2\n"), "{table}");
}

/// A report with each key that there can be.
fn full() -> Report {
    let mut report = report();
    let parts = Explanation::new(&[
        (Cause::LateWakeUp { after_due_ns: 30 }, Nanos(10)),
        (Cause::HostDelay, Nanos(20)),
        (Cause::VmExits { exits: 1 }, Nanos(30)),
        (Cause::HostInterrupt { exits: 2 }, Nanos(40)),
    ]);
    let cause = parts.main().map(|part| part.cause.name());
    let plc = &mut report.partitions[0];
    let (error, action) = ("numeric-error".into(), "cold-start".into());
    plc.events.list = vec![Event { sequence: 1, at_ns: 2, error, detail: String::new(), action }];
    let releases = plc.releases.as_mut().unwrap();
    releases.late_starts = vec![LateStart { release: 1, at_ns: 2, latency_ns: 100, cause, parts }];
    releases.longest_scans = vec![LongScan {
        release: 1,
        at_ns: 2,
        execution_ns: 300,
        finished: true,
        usual_ns: 200,
        cause,
        parts,
    }];
    report.process.start = Some(Footprint { anonymous_bytes: 1, descriptors: 2 });
    report
}

/// The keys of each object, under the name of the section of the page that is about it.
fn keys(section: &str, value: &Value, into: &mut BTreeMap<String, BTreeSet<String>>) {
    match value {
        Value::Array(items) => items.iter().for_each(|item| keys(section, item, into)),
        Value::Object(pairs) => {
            for (key, value) in pairs {
                into.entry(section.to_owned()).or_default().insert(key.clone());
                match key.as_str() {
                    // Its keys are the names of errors.
                    "totals" => {}
                    "from_guest" => keys("to_guest", value, into),
                    "end" => keys("start", value, into),
                    _ if value.get("p999").is_some() => keys("distribution", value, into),
                    _ => keys(key, value, into),
                }
            }
        }
        _ => {}
    }
}

#[test]
fn the_manual_has_each_key_of_the_report() {
    let mut written = BTreeMap::new();
    keys("report", &serde_json::to_value(full()).unwrap(), &mut written);
    let page = std::fs::read_to_string("../../docs/report.md").unwrap();
    let mut told: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for section in page.split("\n## ").skip(1) {
        let (name, text) = section.split_once('\n').unwrap();
        let cells = text.lines().filter_map(|line| line.strip_prefix("| `")?.split(" | ").next());
        let found = cells.flat_map(|cell| cell.split(", ")).map(|key| key.replace('`', ""));
        told.insert(name.to_owned(), found.collect());
    }
    assert_eq!(told, written);
    assert!(page.contains(&format!("| `schema_version` | | {SCHEMA_VERSION} |")));
    assert!(page.contains(&format!("describes version {SCHEMA_VERSION} ")));
}
