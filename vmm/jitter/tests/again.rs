//! Files that are drawn again: what is wrong in them, what an earlier measurement has left in them, and what a run had beside its
//! releases.

mod support;

use std::fs::{self, OpenOptions};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::{Value, json};

use support::{PROGRAM, page, recorded, render, render_recorded, scratch, text};

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
fn a_status_is_told_though_nothing_can_be_written() {
    let full = || OpenOptions::new().write(true).open("/dev/full").unwrap();
    let status = |report: &str, name: &str| {
        let mut command = Command::new(PROGRAM);
        command.arg("render").arg("--report").arg(recorded(report)).arg("--samples");
        command.arg(recorded("samples.json")).arg("--out").arg(scratch(name));
        command.args(["--max-latency", "1ns"]).stdout(full()).stderr(full());
        command.status().unwrap().code()
    };
    assert_eq!(status("report.json", "full"), Some(5));
    assert_eq!(status("no-such-report.json", "full"), Some(3));
}

/// The load of the recorded run has stood still.
fn stood_still(samples: &mut Value) {
    samples["loads"][0]["standstill"] =
        json!({ "from_ns": 1, "to_ns": 2_000_000_001_u64, "lines": 3 });
}

#[test]
fn what_was_asked_of_a_run_is_asked_again() {
    let folder = changed("asked", |_, samples| stood_still(samples));
    let asked = ["--load", "compile", "--command", "takt jitter plant.toml", "--for", "60s"];
    shown(&folder, &asked, 0);
    let out = folder.join("out");
    let again = shown(&out, &KEPT, 5);
    assert!(again.contains("NOT PROVED linux: the load compile stood still"), "{again}");
    assert!(again.contains("EXCEEDED limits: the run ended after 1.992 s of 60s"), "{again}");
    assert!(page(&out.join("out")).contains("<code>takt jitter plant.toml</code>"));
    let kept = &support::json(&out.join("out/report.json"))["jitter"];
    assert_eq!((&kept["load"], &kept["proof"]["proved"]), (&"compile".into(), &false.into()));
    assert_eq!(kept["asked_ns"], 60_000_000_000_u64);
    // Who asks otherwise is answered otherwise.
    let other = [&KEPT[..], &["--load", "none", "--for", "1s"]].concat();
    assert!(shown(&out, &other, 0).contains("all limits are kept"));
    let mut report = support::json(&out.join("report.json"));
    report["jitter"]["load"] = "hammer".into();
    fs::write(out.join("report.json"), report.to_string()).unwrap();
    let output = draw(&out, &KEPT);
    assert_eq!(output.status.code(), Some(3), "{output:?}");
    assert!(text(&output.stderr).contains("is no report: unknown variant `hammer`"));
}

#[test]
fn a_run_that_was_cut_short_keeps_no_limit_if_its_time_is_given() {
    let out = scratch("cut-short");
    for (time, status) in [("1s", 0), ("2s", 5)] {
        let output = render_recorded(&out, &[&KEPT[..], &["--for", time]].concat());
        assert_eq!(output.status.code(), Some(status), "{output:?}");
    }
}

#[test]
fn a_run_in_which_the_schedule_has_changed_keeps_no_limit() {
    let folder = changed("switched", |report, _| {
        report["schedule"]["last_switch_ns"] = 100_000_000.into();
    });
    let told = "limits: the schedule has changed, at 0.100 s for the last time";
    assert!(shown(&folder, &KEPT, 5).contains(told));
    assert!(!shown(&folder, &[], 0).contains("the schedule has changed"));
}

#[test]
fn the_progress_that_is_shown_is_that_of_the_linux_without_proof() {
    let folder = changed("two-linuxes", |report, samples| {
        add_partition(report, 1, "second");
        let mut load = samples["loads"][0].clone();
        load["partition"] = "second".into();
        load["points"] = json!([[1, 0], [2, 5]]);
        samples["loads"].as_array_mut().unwrap().insert(0, load);
    });
    let options = ["--load", "compile"];
    assert!(shown(&folder, &options, 0).contains("load compile (linux: compile, 37 objects from"));
    assert!(page(&folder.join("out")).contains("<h2>Load of linux: compile</h2>"));
    let mut samples = support::json(&folder.join("samples.json"));
    stood_still(&mut samples);
    samples["loads"].as_array_mut().unwrap().swap(0, 1);
    fs::write(folder.join("samples.json"), samples.to_string()).unwrap();
    let said = shown(&folder, &[&KEPT[..], &options].concat(), 5);
    assert!(said.contains("NOT PROVED second: the load compile stood still"), "{said}");
    assert!(said.contains("load compile (second: compile, 5 objects from"), "{said}");
    assert!(page(&folder.join("out")).contains("<h2>Load of second: compile</h2>"));
    let kept = &support::json(&folder.join("out/report.json"))["jitter"];
    assert_eq!(kept["progress"]["partition"], "second");
}
