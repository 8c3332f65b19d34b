//! The trace: what is drawn of windows, partitions and schedules.

use std::cell::Cell;
use std::collections::BTreeMap;

use super::events::micros;
use super::*;
use serde_json::Value;
use takt_record::Scan;
use takt_scheduler::time::TscFrequency;

const PLC: PartitionId = PartitionId(0);

/// One tick is half a nanosecond.
fn base() -> Timebase {
    Timebase { epoch: Tsc(10_000_000), frequency: TscFrequency::from_khz(2_000_000).unwrap() }
}

/// The instant so many nanoseconds after the epoch, or before it.
fn at(ns: i64) -> Tsc {
    Tsc(10_000_000u64.checked_add_signed(2 * ns).unwrap())
}

fn window(sequence: u64) -> WindowRecord {
    let release = 1_000_000 * sequence as i64;
    WindowRecord {
        sequence,
        schedule: ScheduleId(0),
        skipped: 0,
        release: at(release),
        end: at(release + 300_000),
        due: at(release - 20_000),
        woken: at(release - 12_345),
        entered: at(release - 11_000),
        left: at(release + 100_001),
        kicked: None,
        claim: Some(Scan { start: at(release + 4), done: at(release + 99_000) }),
        last_stamp: at(release + 99_000),
        exits: 2,
        kernel_exits: 3,
        overrun: false,
        unfinished: false,
        has_tasks: false,
        ended: false,
    }
}

fn detour(left: Tsc, entered: Tsc) -> Detour {
    Detour { exit: Exit::Port(0x7a0c), left, entered }
}

fn begin(out: &mut Vec<u8>) -> Trace<&mut Vec<u8>> {
    Trace::new(out, base(), &[("plc", Cpu(0)), ("li\"nux", Cpu(1))], &["normal", "safe"])
}

fn trace(write: impl FnOnce(&mut Trace<&mut Vec<u8>>)) -> Vec<Value> {
    let mut out = Vec::new();
    let mut trace = begin(&mut out);
    write(&mut trace);
    trace.finish().unwrap();
    let events: Vec<Value> = serde_json::from_slice(&out).unwrap();
    check(&events);
    events
}

fn ns(value: &Value) -> u64 {
    (value.as_f64().unwrap() * 1e3).round() as u64
}

/// What a viewer relies on: every event has its place, and no slices of a thread overlap.
fn check(events: &[Value]) {
    let mut ends = BTreeMap::new();
    for event in events {
        let thread = event["tid"].as_u64().unwrap();
        assert!(event["pid"].is_u64() && event["name"].is_string(), "{event}");
        assert!(event["ts"].as_f64().unwrap() >= 0.0, "{event}");
        if event["ph"] == "X" {
            let end = ends.entry(thread).or_insert(0);
            assert!(*end <= ns(&event["ts"]), "{event}");
            assert!(ns(&event["dur"]) > 0, "{event}");
            *end = ns(&event["ts"]) + ns(&event["dur"]);
        }
    }
    let count = |phase: &str| events.iter().filter(|e| e["ph"] == phase).count();
    assert_eq!(count("B"), count("E"));
}

fn named<'a>(events: &'a [Value], name: &str) -> Vec<&'a Value> {
    events.iter().filter(|e| e["name"] == name).collect()
}

/// Slices of a name: from and to, in nanoseconds after the epoch.
fn slices(events: &[Value], name: &str) -> Vec<(i64, i64)> {
    let span = |e: &&Value| {
        let from = ns(&e["ts"]) as i64 - 1_000_000;
        (from, from + ns(&e["dur"]) as i64)
    };
    named(events, name).iter().map(span).collect()
}

#[test]
fn a_window_is_drawn_in_its_stretches() {
    let events = trace(|trace| trace.add(PLC, &window(0), &[detour(at(50_000), at(60_001))]));
    assert_eq!(slices(&events, "wake-up"), [(-20_000, -12_345)]);
    assert_eq!(slices(&events, "entry"), [(-12_345, -11_000)]);
    assert_eq!(slices(&events, "guest"), [(-11_000, 50_000), (60_001, 100_001)]);
    assert_eq!(slices(&events, "port exit"), [(50_000, 60_001)]);
    assert_eq!(slices(&events, "scan"), [(4, 99_000)]);
    assert_eq!(named(&events, "port exit")[0]["args"]["at"], "0x7a0c");
    let release = named(&events, "release")[0];
    assert_eq!((&release["ph"], ns(&release["ts"])), (&"i".into(), 1_000_000));
    assert_eq!(release["args"]["release_tsc"], 10_000_000);
    assert_eq!(release["args"]["schedule"], "normal");
    assert_eq!(ns(&named(&events, "done")[0]["ts"]), 1_100_001);
    for absent in ["kick", "overrun", "late release", "lost releases", "unfinished scan"] {
        assert!(named(&events, absent).is_empty(), "{absent}");
    }
}

#[test]
fn what_went_wrong_is_marked() {
    let events = trace(|trace| {
        let record = WindowRecord {
            skipped: 7,
            entered: at(1_002_000),
            left: at(1_300_900),
            kicked: Some(at(1_300_500)),
            claim: Some(Scan { start: at(1_002_004), done: Tsc(0) }),
            kernel_exits: 0,
            overrun: true,
            ..window(1)
        };
        trace.add(PLC, &record, &[]);
    });
    assert_eq!(named(&events, "lost releases")[0]["args"]["releases"], 7);
    assert_eq!(named(&events, "late release")[0]["args"]["late_ns"], 2_000);
    assert_eq!(ns(&named(&events, "kick")[0]["ts"]), 2_300_500);
    assert_eq!(ns(&named(&events, "overrun")[0]["ts"]), 2_300_000);
    assert_eq!(slices(&events, "unfinished scan"), [(1_002_004, 1_300_900)]);
    assert!(named(&events, "release")[0]["args"]["kernel_exits"].is_null());
    assert!(named(&events, "done").is_empty() && named(&events, "scan").is_empty());
}

#[test]
fn tasks_that_go_on_are_no_overrun_in_the_picture() {
    let record = WindowRecord { unfinished: true, has_tasks: true, ..window(0) };
    let events = trace(|trace| trace.add(PLC, &record, &[]));
    assert_eq!(named(&events, "unfinished").len(), 1);
    assert!(named(&events, "overrun").is_empty());
}

#[test]
fn a_claim_that_cannot_be_true_is_not_drawn() {
    for start in [Tsc(0), at(-1), at(100_002), Tsc(u64::MAX)] {
        let claim = Some(Scan { start, done: at(50_000) });
        let events = trace(|trace| trace.add(PLC, &WindowRecord { claim, ..window(0) }, &[]));
        assert!(slices(&events, "scan").is_empty());
        assert!(slices(&events, "unfinished scan").is_empty());
    }
    for done in [Tsc(0), at(3), at(100_002), Tsc(u64::MAX)] {
        let claim = Some(Scan { start: at(4), done });
        let events = trace(|trace| trace.add(PLC, &WindowRecord { claim, ..window(0) }, &[]));
        assert_eq!(slices(&events, "unfinished scan"), [(4, 100_001)]);
    }
}

#[test]
fn each_partition_has_its_threads_in_the_process_of_its_cpu() {
    let events = trace(|trace| {
        trace.add(PLC, &window(0), &[]);
        trace.add(PartitionId(1), &window(0), &[]);
        trace.add(PartitionId(2), &window(0), &[]);
    });
    let place = |e: &Value| (e["pid"].as_u64().unwrap(), e["tid"].as_u64().unwrap());
    let thread = |name: &str| {
        let names = events.iter().filter(|e| e["name"] == "thread_name");
        place(names.clone().find(|e| e["args"]["name"] == name).unwrap())
    };
    let of = |name| named(&events, name).iter().map(|e| place(e)).collect::<Vec<_>>();
    assert_eq!(of("entry"), [thread("plc"), thread("li\"nux")]);
    assert_eq!(of("scan"), [thread("plc: claims"), thread("li\"nux: claims")]);
    assert_eq!(thread("plc").0, thread("plc: claims").0);
    assert_ne!(thread("plc").0, thread("li\"nux").0);
    assert_ne!(thread("schedule").0, thread("li\"nux").0);
}

#[test]
fn schedules_follow_each_other() {
    let events = trace(|trace| {
        trace.add(PLC, &window(0), &[]);
        trace.switch(at(2_000_000), ScheduleId(1));
        trace.switch(at(1_000_000), ScheduleId(0));
        trace.switch(at(4_000_000), ScheduleId(usize::MAX));
        trace.add(PLC, &WindowRecord { schedule: ScheduleId(1), ..window(5) }, &[]);
    });
    let phases = events.iter().filter(|e| e["ph"] == "B" || e["ph"] == "E");
    let edges: Vec<_> = phases.map(|e| (e["name"].as_str().unwrap(), ns(&e["ts"]))).collect();
    let expected = [
        ("normal", 0),
        ("", 3_000_000),
        ("safe", 3_000_000),
        ("", 3_000_000),
        ("normal", 3_000_000),
        ("", 5_000_000),
        ("", 5_000_000),
        ("", 6_100_001),
    ];
    assert_eq!(edges, expected);
    assert_eq!(named(&events, "release")[1]["args"]["schedule"], "safe");
}

/// Every stamp takes every bad value, while the others are good, and all at once.
#[test]
fn no_record_can_break_the_file() {
    let bad = [0, 1, at(0).0, at(500_000).0, i64::MAX as u64, u64::MAX];
    let spoil: [fn(&mut WindowRecord, u64); 9] = [
        |w, bad| w.release = Tsc(bad),
        |w, bad| w.end = Tsc(bad),
        |w, bad| w.due = Tsc(bad),
        |w, bad| w.woken = Tsc(bad),
        |w, bad| w.entered = Tsc(bad),
        |w, bad| w.left = Tsc(bad),
        |w, bad| w.kicked = Some(Tsc(bad)),
        |w, bad| w.claim = Some(Scan { start: at(4), done: Tsc(bad) }),
        |w, bad| (w.sequence, w.skipped, w.last_stamp) = (bad, bad, Tsc(bad)),
    ];
    for bad in bad {
        for spoil in spoil {
            trace(|trace| {
                let mut record = window(1);
                spoil(&mut record, bad);
                trace.add(PLC, &record, &[detour(Tsc(bad), at(0)), detour(at(0), Tsc(bad))]);
                trace.add(PLC, &window(2), &[]);
            });
        }
        trace(|trace| {
            let mut record = window(1);
            spoil.iter().for_each(|spoil| spoil(&mut record, bad));
            trace.add(PLC, &record, &[detour(Tsc(bad), Tsc(bad))]);
            trace.switch(Tsc(bad), ScheduleId(1));
        });
    }
}

#[test]
fn nanoseconds_survive_to_the_last_instant_that_a_double_can_tell() {
    for ns in [1, 999, 1_001, 123_456_789_123, LATEST_NS - 1, LATEST_NS] {
        let text = serde_json::to_string(&micros(ns)).unwrap();
        let (whole, rest) = text.split_once('.').unwrap();
        let rest: u64 = format!("{rest:0<3}").parse().unwrap();
        assert_eq!(whole.parse::<u64>().unwrap() * 1_000 + rest, ns, "{text}");
    }
}

#[test]
fn a_file_that_is_cut_off_lacks_only_its_last_bracket() {
    let mut out = Vec::new();
    let mut trace = begin(&mut out);
    trace.add(PLC, &window(0), &[]);
    drop(trace);
    out.push(b']');
    assert!(serde_json::from_slice::<Vec<Value>>(&out).unwrap().len() > 10);
}

#[test]
fn a_window_takes_as_much_as_the_documentation_says() {
    let size = |windows: u64, detours: &[Detour]| {
        let mut out = Vec::new();
        let mut trace = begin(&mut out);
        for n in 1_000_000..1_000_000 + windows {
            trace.add(PLC, &window(n), detours);
        }
        trace.finish().unwrap();
        out.len()
    };
    let release = 1_000_000_000_000;
    let plain = (size(101, &[]) - size(1, &[])) / 100;
    let with = size(1, &[detour(at(release + 50_000), at(release + 60_000))]) - size(1, &[]);
    assert!((700..=900).contains(&plain), "{plain}");
    assert!((200..=300).contains(&with), "{with}");
}

#[test]
fn a_trace_that_begins_in_a_run_has_nothing_before_its_beginning() {
    let mut out = Vec::new();
    let (names, since) = ([("plc", Cpu(0))], at(5_000_000));
    let mut trace =
        Trace::since(&mut out, base(), &names, &["normal", "safe"], since, ScheduleId(1));
    trace.add(PLC, &window(6), &[]);
    trace.finish().unwrap();
    let events: Vec<Value> = serde_json::from_slice(&out).unwrap();
    check(&events);
    let begins: Vec<_> = events.iter().filter(|e| e["ph"] == "B").collect();
    assert_eq!(begins.len(), 1);
    assert_eq!((&begins[0]["name"], ns(&begins[0]["ts"])), (&"safe".into(), 6_000_000));
    let timed = events.iter().filter(|e| e["ph"] != "M");
    assert!(timed.map(|e| ns(&e["ts"])).all(|ts| ts >= 6_000_000));
}

/// Takes some bytes and then no more.
struct Full(usize);

impl Write for Full {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.0 == 0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        let taken = bytes.len().min(self.0);
        self.0 -= taken;
        Ok(taken)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_told_at_the_end() {
    for space in [0, 100, 700, 1_500] {
        let mut trace = Trace::new(Full(space), base(), &[("plc", Cpu(0))], &["normal"]);
        for n in 0..10 {
            trace.add(PLC, &window(n), &[]);
        }
        let error = trace.finish().unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull, "{space}");
    }
}

/// Takes whole pieces, while there is room.
struct Roomy<'a> {
    out: &'a mut Vec<u8>,
    has_room: &'a Cell<bool>,
}

impl Write for Roomy<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if !self.has_room.get() {
            return Err(io::ErrorKind::WouldBlock.into());
        }
        self.out.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn windows_for_which_there_is_no_room_leave_a_mark_and_a_whole_file() {
    let (mut out, has_room) = (Vec::new(), Cell::new(true));
    let writer = Roomy { out: &mut out, has_room: &has_room };
    let mut trace = Trace::new(writer, base(), &[("plc", Cpu(0))], &["normal"]);
    let mut dropped = 0;
    for n in 0..9 {
        has_room.set(n % 3 == 0);
        trace.add(PLC, &window(n), &[]);
        dropped += u64::from(n % 3 != 0);
    }
    let events_dropped = trace.dropped();
    has_room.set(true);
    trace.finish().unwrap();
    let events: Vec<Value> = serde_json::from_slice(&out).unwrap();
    check(&events);
    let releases = events.iter().filter(|e| e["name"] == "release").count() as u64;
    assert_eq!((releases, dropped), (3, 6));
    let each = events_dropped / dropped;
    assert_eq!(events_dropped, each * dropped);
    let told: Vec<u64> = events
        .iter()
        .filter(|e| e["name"] == "dropped")
        .map(|e| e["args"]["events"].as_u64().unwrap())
        .collect();
    assert_eq!(told, [2 * each; 3]);
}
