//! The control socket of a Takt whose vCPUs are real.

use std::fs;
use std::process::Command;

use takt_tests::{Value, plc_image, root, target, timeout_s};

/// Two PLCs that send each other a record in each cycle, in a state and in a queue.
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
image = "IMAGE"

[[partition]]
name = "other"
kind = "plc"
cpu = 0
memory = "4MiB"
image = "IMAGE"

[[channel]]
name = "state-of-plc"
kind = "sampling"
message_bytes = 512
source = "plc:out"
destinations = ["other:in"]
refresh_period = "2ms"

[[channel]]
name = "orders-of-plc"
kind = "queuing"
message_bytes = 512
source = "plc:send"
destinations = ["other:receive"]
depth = 4

[[channel]]
name = "state-of-other"
kind = "sampling"
message_bytes = 512
source = "other:out"
destinations = ["plc:in"]
refresh_period = "2ms"

[[channel]]
name = "orders-of-other"
kind = "queuing"
message_bytes = 512
source = "other:send"
destinations = ["plc:receive"]
depth = 4

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
    let image = fs::canonicalize(plc_image("peer")).unwrap();
    fs::write(&file, FILE.replace("IMAGE", image.to_str().unwrap())).unwrap();
    let output = Command::new(root().join("scripts/host"))
        .args(["--program", env!("CARGO_BIN_EXE_talk")])
        .arg("--file")
        .arg(&file)
        .arg("--file")
        .arg(&image)
        .arg("--out")
        .arg(&out)
        .arg(root().join("tests/host/control"))
        // The path that the file has there, too.
        .arg(fs::canonicalize(&file).unwrap())
        .env("TAKT_TIMEOUT", timeout_s(0))
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

fn contents(status: &Value, channel: usize) -> &Value {
    &status["status"]["channels"][channel]["contents"]
}

#[test]
fn a_run_is_looked_at_traced_and_told_what_to_do_and_keeps_its_time() {
    let (answers, report) = run();
    let named = |name| self::named(&answers, name);
    assert_eq!(named("error").count(), 0, "{answers:#?}");

    let [before, after] = &named("status").collect::<Vec<_>>()[..] else { panic!() };
    assert_eq!((state(before, 0), state(before, 1)), ("running", "running"));
    // The state of a PLC is never older than its cycle, and there is one for each.
    let state_of_plc = contents(before, 0);
    assert_eq!(state_of_plc["valid"], true, "{before:#}");
    let written = state_of_plc["written"].as_u64().unwrap();
    let releases = before["status"]["partitions"][0]["releases"]["happened"].as_u64().unwrap();
    assert!(written.abs_diff(releases) < 40, "{written} of {releases}: {before:#}");
    // The other one takes its orders in each cycle, until it is stopped: then they pile up, and its
    // state grows old.
    assert!(contents(before, 1)["waiting"].as_u64().unwrap() < 4, "{before:#}");
    assert_eq!(contents(after, 1)["waiting"], 4, "{after:#}");
    assert_eq!(contents(before, 2)["valid"], true, "{before:#}");
    assert_eq!(contents(after, 2)["valid"], false, "{after:#}");

    let windows: Vec<&Value> = named("window").map(|answer| &answer["window"]).collect();
    let end = named("traced").next().unwrap();
    assert_eq!((&end["windows"], &end["dropped"]), (&windows.len().into(), &0.into()));
    let khz = named("trace").next().unwrap()["trace"]["tsc_khz"].as_u64().unwrap();
    for partition in ["plc", "other"] {
        let of: Vec<&&Value> = windows.iter().filter(|w| w["partition"] == partition).collect();
        // 200 ms, and up to a tick of the supervisor thread.
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
