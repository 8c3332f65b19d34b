//! Files that are drawn again: what is wrong in them, what an earlier measurement has left in them, and what a run had beside its
//! releases.

mod support;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use serde_json::{Value, json};

use support::{recorded, render, scratch, text};

/// A limit that the recorded run keeps.
const KEPT: [&str; 2] = ["--max-latency", "1s"];

/// A folder with the recorded files, after a change.
fn changed(name: &str, change: impl FnOnce(&mut Value, &mut Value)) -> PathBuf {
    let folder = scratch(name);
    let (mut report, mut samples) =
        (support::json(&recorded("report.json")), support::json(&recorded("samples.json")));
    change(&mut report, &mut samples);
    fs::write(folder.join("report.json"), report.to_string()).unwrap();
    fs::write(folder.join("samples.json"), samples.to_string()).unwrap();
    folder
}

/// Draws what is in a folder into `out` below it.
fn draw(folder: &Path, options: &[&str]) -> Output {
    let (report, samples) = (folder.join("report.json"), folder.join("samples.json"));
    render(&report, &samples, &folder.join("out"), options)
}

/// What it shows, if it ends with this status.
fn shown(folder: &Path, options: &[&str], status: i32) -> String {
    let output = draw(folder, options);
    assert_eq!(output.status.code(), Some(status), "{options:?}: {output:?}");
    text(&output.stdout)
}

fn add_partition(report: &mut Value, of: usize, name: &str) {
    let mut partition = report["partitions"][of].clone();
    partition["name"] = name.into();
    report["partitions"].as_array_mut().unwrap().push(partition);
}

/// The recorded files with a second PLC, after a change of its part of the report.
fn with_second_plc(name: &str, change: fn(&mut Value)) -> PathBuf {
    changed(name, |report, samples| {
        add_partition(report, 0, "second");
        change(report["partitions"].as_array_mut().unwrap().last_mut().unwrap());
        let mut course = samples["partitions"][0].clone();
        course["name"] = "second".into();
        samples["partitions"].as_array_mut().unwrap().push(course);
    })
}

#[test]
fn a_plc_whose_figures_are_wrong_does_not_vanish_from_the_limits() {
    let negative = |plc: &mut Value| plc["lost"] = (-1).into();
    let cause = |plc: &mut Value| plc["late_starts"][0]["parts"][0]["cause"] = "moon".into();
    let missing = |plc: &mut Value| {
        plc.as_object_mut().unwrap().remove("releases").unwrap();
    };
    shown(&with_second_plc("two", |_| ()), &KEPT, 0);
    for (change, expected) in [
        (negative as fn(&mut Value), "invalid value: integer `-1`"),
        (cause, "moon"),
        (missing, "missing field `releases`"),
    ] {
        let output = draw(&with_second_plc("wrong", change), &KEPT);
        assert_eq!(output.status.code(), Some(3), "{output:?}");
        let said = text(&output.stderr);
        assert!(said.contains("is no report: second: ") && said.contains(expected), "{said}");
        assert!(output.stdout.is_empty(), "{output:?}");
    }
}

#[test]
fn samples_of_another_run_are_refused() {
    let counts = |samples: &mut Value| samples["partitions"][0]["latency_ns"].take();
    for (name, expected) in [
        ("count", "plc has 1992 releases in the report and 1993 in the samples"),
        ("latest", "the latest start of plc is 106292 ns late in the report and 106293 ns late in"),
        ("partition", "the samples have no partition plc"),
    ] {
        let folder = changed(&format!("other-{name}"), |_, samples| {
            let mut all = counts(samples);
            match name {
                "count" => all[0][1] = (all[0][1].as_u64().unwrap() + 1).into(),
                "latest" => all.as_array_mut().unwrap().last_mut().unwrap()[0] = 106_293.into(),
                _ => samples["partitions"][0]["name"] = "mixer".into(),
            }
            samples["partitions"][0]["latency_ns"] = all;
        });
        let output = draw(&folder, &KEPT);
        assert_eq!(output.status.code(), Some(3), "{output:?}");
        let said = text(&output.stderr);
        assert!(said.contains("are not of one run: ") && said.contains(expected), "{said}");
    }
}

#[test]
fn a_load_may_end_when_its_linux_is_asked_to_switch_itself_off() {
    let progressed = |from: u64, to: u64| json!({ "from_ns": from, "to_ns": to, "lines": 0 });
    let run = |name: &str, asked: Option<u64>, before: (u64, u64)| {
        changed(name, |report, samples| {
            report["duration_ns"] = 8_000_000_000_u64.into();
            if let Some(asked_ns) = asked {
                report["partitions"][1]["power_off"] =
                    json!({ "asked_ns": asked_ns, "took_ns": 5_000_000_000_u64 });
            }
            let load = &mut samples["loads"][0];
            load["standstill"] = progressed(1_840_000_000, 8_000_000_000);
            load["ended_standstill"] = progressed(before.0, before.1);
        })
    };
    let asked = Some(3_000_000_000);
    let options = [&KEPT[..], &["--load", "compile"]].concat();
    let (short, long) = ((0, 1), (900_000_000, 2_900_000_000));
    shown(&run("off", asked, short), &options, 0);
    let told = |folder: PathBuf, expected: &str| {
        let shown = shown(&folder, &options, 5);
        assert!(shown.contains(expected), "{shown}");
    };
    told(run("on", None, short), "the load compile stood still for 6.160 s");
    told(run("off-late", Some(3_840_000_000), short), "the load compile stood still for 2.000 s");
    told(run("off-before", asked, long), "the load compile stood still for 2.000 s, from 0.900 s");
}
