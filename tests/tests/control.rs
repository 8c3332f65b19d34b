//! The control socket of a Takt whose vCPUs are real.

use std::fs;
use std::process::Command;

use takt_tests::{Value, root, target};

/// A PLC that publishes and one that looks at half of it.
const FILE: &str = r#"
version = 1
[system]
name = "control"
major_frame = "1ms"

[[partition]]
name = "plc"
kind = "plc"
cpu = 0
memory = "4MiB"

[[partition]]
name = "other"
kind = "plc"
cpu = 0
memory = "4MiB"

[[channel]]
name = "level"
kind = "sampling"
message_bytes = 8
source = "plc:level"
destinations = ["other:seen"]
refresh_period = "5ms"

[[channel]]
name = "log"
kind = "queuing"
message_bytes = 160
source = "plc:log"
destinations = ["other:unread"]
depth = 4
when_full = "overwrite"

[[schedule]]
name = "normal"

[[schedule.window]]
partition = "plc"
offset = "0us"
duration = "200us"

[[schedule.window]]
partition = "other"
offset = "500us"
duration = "200us"
"#;

/// What Takt said on its socket, and its report.
fn run() -> (Vec<Value>, Value) {
    let (file, out) = (target("tests/control.toml"), target("tests/control.out"));
    let _ = fs::remove_dir_all(&out);
    fs::create_dir_all(&out).unwrap();
    fs::write(&file, FILE).unwrap();
    let output = Command::new(root().join("scripts/host"))
        .args(["--program", env!("CARGO_BIN_EXE_talk")])
        .arg("--file")
        .arg(&file)
        .arg("--out")
        .arg(&out)
        .arg(root().join("tests/host/control"))
        // The path that the file has there, too.
        .arg(fs::canonicalize(&file).unwrap())
        .env("TAKT_TIMEOUT", "900")
        .output()
        .unwrap();
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_default();
    let console = String::from_utf8_lossy(&output.stdout).into_owned() + &read("takt");
    assert!(output.status.success(), "{console}{}", String::from_utf8_lossy(&output.stderr));
    let answers = read("answers");
    let answers = answers.lines().map(|line| serde_json::from_str(line).unwrap());
    (answers.collect(), serde_json::from_str(&read("report.json")).unwrap())
}

fn named<'a>(answers: &'a [Value], name: &'static str) -> impl Iterator<Item = &'a Value> {
    answers.iter().filter(move |answer| answer["answer"] == *name)
}

fn state(status: &Value, partition: usize) -> &str {
    status["status"]["partitions"][partition]["state"].as_str().unwrap()
}

#[test]
fn a_run_is_looked_at_traced_and_told_what_to_do_and_keeps_its_time() {
    let (answers, report) = run();
    let named = |name| self::named(&answers, name);
    assert_eq!(named("error").count(), 0, "{answers:#?}");

    let [before, after] = &named("status").collect::<Vec<_>>()[..] else { panic!() };
    assert_eq!((state(before, 0), state(before, 1)), ("running", "running"));
    let channels = &before["status"]["channels"];
    let level = &channels[0]["contents"];
    assert_eq!(level["valid"], true, "{channels}");
    // One each cycle.
    let written = level["written"].as_u64().unwrap();
    let releases = before["status"]["partitions"][0]["releases"]["happened"].as_u64().unwrap();
    assert!((releases..releases + 30).contains(&written), "{written} of {releases}: {channels}");
    let log = &channels[1]["contents"];
    // Nobody reads it.
    let total = log["waiting"].as_u64().unwrap() + log["overwritten"].as_u64().unwrap();
    assert_eq!(log["written"], total, "{channels}");
    assert!(total > 0, "{channels}");

    let windows: Vec<&Value> = named("window").map(|answer| &answer["window"]).collect();
    let end = named("traced").next().unwrap();
    assert_eq!((&end["windows"], &end["dropped"]), (&windows.len().into(), &0.into()));
    let khz = named("trace").next().unwrap()["trace"]["tsc_khz"].as_u64().unwrap();
    for partition in ["plc", "other"] {
        let of: Vec<&&Value> = windows.iter().filter(|w| w["partition"] == partition).collect();
        // 200 ms, and up to a tick of the event thread.
        assert!((195..=245).contains(&of.len()), "{partition}: {} windows", of.len());
        for pair in of.windows(2) {
            let difference =
                |key: &str| pair[1][key].as_u64().unwrap() - pair[0][key].as_u64().unwrap();
            assert_eq!(difference("release"), 1, "{pair:#?}");
            assert!(difference("release_tsc").abs_diff(khz) <= 1, "{pair:#?}");
        }
    }

    assert_eq!((state(after, 0), state(after, 1)), ("running", "stopped"));
    assert_eq!(after["status"]["partitions"][1]["restarts"], 1);
    let events = named("events").next().unwrap()["events"].as_array().unwrap();
    let kinds: Vec<&str> = events.iter().map(|event| event["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["restarted", "stopped"], "{events:#?}");

    // None of it cost the PLC anything.
    let plc = &report["partitions"][0];
    for key in ["lost", "late_releases", "overruns", "unrecorded"] {
        assert_eq!(plc[key], 0, "{key}: {plc:#}");
    }
    assert!(plc["releases"].as_u64().unwrap() > 2_000, "{plc:#}");
}
