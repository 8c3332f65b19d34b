//! The program as a user or a script meets it, on a run that was recorded in the lab: the guest
//! `disturbed` without a guard, 2 s, with one wake-up that is late on purpose. Of its course only the
//! first 200 points are kept.

mod support;

use std::fs;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;

use support::{PROGRAM, json, page, recorded, render, render_recorded, scratch, text};

/// Fails unless each tag is closed in its turn, nothing is loaded, and nothing runs.
fn assert_self_contained(page: &str) {
    let mut open = Vec::new();
    for tag in page.split('<').skip(1) {
        let (tag, _) = tag.split_once('>').unwrap_or_else(|| panic!("a tag without end: {tag}"));
        let name = tag.split([' ', '\n']).next().unwrap();
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
        } else if !tag.ends_with('/') && !["meta", "!DOCTYPE"].contains(&name) {
            open.push(name);
        }
        assert!(!["script", "img", "link", "iframe", "a"].contains(&name), "<{tag}>");
        assert!([" on", "href=", " src="].iter().all(|part| !tag.contains(part)), "<{tag}>");
    }
    assert_eq!(open, [""; 0]);
    let addresses = page.matches("http").count() - page.matches("http-equiv").count();
    assert_eq!(addresses, page.matches("http://www.w3.org/2000/svg").count());
    assert!(page.contains("default-src 'none'"));
}

#[test]
fn a_recorded_run_becomes_one_page_that_needs_no_other() {
    let out = scratch("page");
    let output = render_recorded(&out, &["--command", "scripts/run jitter <x> --for 200ms"]);
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
    let page = page(&out);
    assert_self_contained(&page);
    assert_eq!(page.matches("<svg").count(), 6);
    let report = json(&recorded("report.json"));
    let plc = &report["partitions"][0];
    let worst = plc["late_starts"].as_array().unwrap();
    assert_eq!(worst.len(), 10);
    let (_, table) = page.split_once("The latest starts").unwrap();
    let (table, _) = table.split_once("</table>").unwrap();
    assert_eq!(table.matches("<tr><td").count(), 10);
    assert_eq!(table.matches("late wake-up").count(), 10);
    assert!(page.contains("<code>scripts/run jitter &lt;x&gt; --for 200ms</code>"), "{page}");
    assert!(page.contains(report["host"]["kernel"].as_str().unwrap()));
    let shown = text(&output.stdout);
    assert!(
        shown.contains("bars are logarithmic") && shown.contains("plc: release_guard = "),
        "{shown}"
    );
}

#[test]
fn what_is_left_beside_the_page_can_be_rendered_again() {
    let (first, second) = (scratch("first"), scratch("second"));
    assert!(render_recorded(&first, &[]).status.success());
    let mut report = json(&first.join("report.json"));
    let (report_file, samples_file) = (first.join("report.json"), first.join("samples.json"));
    assert!(render(&report_file, &samples_file, &second, &[]).status.success());
    assert_eq!(page(&first), page(&second));
    // In place, where the samples are read from the file that is written.
    assert!(render(&report_file, &samples_file, &first, &[]).status.success());
    assert_eq!(json(&samples_file), json(&recorded("samples.json")));
    let addition = report.as_object_mut().unwrap().remove("jitter").unwrap();
    assert_eq!(report, json(&recorded("report.json")));
    assert_eq!((&addition["schema_version"], &addition["load"]), (&2.into(), &"none".into()));
}

#[test]
fn a_kernel_that_is_stuck_is_on_the_page_though_nothing_was_given_to_it() {
    let out = scratch("stuck");
    let mut report = json(&recorded("report.json"));
    let linux = report["partitions"][1].as_object_mut().unwrap();
    linux.remove("donation").unwrap();
    linux["stuck"] = serde_json::json!({"how": "spinning", "since_ns": 1_500_000_000});
    let file = out.join("given.json");
    fs::write(&file, report.to_string()).unwrap();
    let output = render(&file, &recorded("samples.json"), &out, &[]);
    assert_eq!((output.status.code(), text(&output.stderr)), (Some(0), String::new()));
    let page = page(&out);
    assert_self_contained(&page);
    assert!(page.contains("<h2>linux</h2>") && page.contains("Its kernel "), "{page}");
}

#[test]
fn no_text_of_a_report_is_taken_for_html_or_for_the_terminals_orders() {
    const HOSTILE: &str = "\"'><script>alert(1)</script><img src=x onerror=y>&\u{1b}[2J";
    fn poison(value: &mut Value) {
        match value {
            Value::String(text) => *text = HOSTILE.into(),
            Value::Array(all) => all.iter_mut().for_each(poison),
            // These are words of a list; another word is refused.
            Value::Object(all) => all
                .iter_mut()
                .filter(|(key, _)| !["cause", "clear"].contains(&key.as_str()))
                .for_each(|(_, value)| poison(value)),
            _ => {}
        }
    }
    let out = scratch("hostile");
    let (report, samples) = (out.join("in.json"), out.join("samples-in.json"));
    for (from, to) in [("report.json", &report), ("samples.json", &samples)] {
        let mut value = json(&recorded(from));
        poison(&mut value);
        fs::write(to, value.to_string()).unwrap();
    }
    let more = ["--command", HOSTILE, "--max-lost", "0", "--max-latency", "1ns"];
    let output = render(&report, &samples, &out, &more);
    assert_eq!(output.status.code(), Some(5));
    assert!(!text(&output.stdout).contains('\u{1b}'));
    let page = page(&out);
    assert_self_contained(&page);
    assert!(page.contains("&lt;script&gt;") && page.matches("<svg").count() == 6);
}

#[test]
fn numbers_that_cannot_be_are_no_reason_to_panic() {
    for number in [0u64, 1, u64::MAX] {
        fn poison(value: &mut Value, number: u64) {
            match value {
                Value::Number(n) if n.is_u64() => *value = number.into(),
                Value::Array(all) => all.iter_mut().for_each(|v| poison(v, number)),
                Value::Object(all) => all
                    .iter_mut()
                    // These have 32 bits.
                    .filter(|(key, _)| {
                        !["schema_version", "tsc_khz", "exits"].contains(&key.as_str())
                    })
                    .for_each(|(_, v)| poison(v, number)),
                _ => {}
            }
        }
        let out = scratch(&format!("numbers-{number}"));
        let (report, samples) = (out.join("in.json"), out.join("samples-in.json"));
        for (from, to) in [("report.json", &report), ("samples.json", &samples)] {
            let mut value = json(&recorded(from));
            poison(&mut value, number);
            if from == "samples.json" {
                // As many releases as the report has: otherwise they are not of one run.
                value["partitions"][0]["latency_ns"].as_array_mut().unwrap().truncate(1);
            }
            fs::write(to, value.to_string()).unwrap();
        }
        let output = render(&report, &samples, &out, &["--max-late", "0"]);
        assert!(matches!(output.status.code(), Some(0 | 5)), "{number}: {output:?}");
        assert_self_contained(&page(&out));
    }
}

#[test]
fn a_limit_that_is_exceeded_gives_status_5_and_is_told_everywhere() {
    let out = scratch("limits");
    let latest = json(&recorded("report.json"))["partitions"][0]["release_latency_ns"]["max"]
        .as_u64()
        .unwrap();
    let kept = format!("{latest}ns");
    let output = render_recorded(&out, &["--max-latency", &kept, "--max-lost", "0"]);
    assert_eq!(output.status.code(), Some(0));
    assert!(text(&output.stdout).contains("all limits are kept"));
    let exceeded = format!("{}ns", latest - 1);
    let output = render_recorded(&out, &["--max-latency", &exceeded]);
    assert_eq!(output.status.code(), Some(5));
    assert!(text(&output.stdout).contains("EXCEEDED plc: the latest release was"));
    assert!(page(&out).contains("<li class=\"bad\">plc the latest release was"));
    let addition = &json(&out.join("report.json"))["jitter"];
    assert_eq!(addition["breaches"][0]["partition"], "plc");
    assert_eq!(addition["max_latency_ns"], latest - 1);
}

/// The recorded report with a PLC to which this has happened.
fn report_with(name: &str, change: fn(&mut Value)) -> PathBuf {
    let mut report = json(&recorded("report.json"));
    change(&mut report["partitions"][0]);
    let path = scratch(name).join("report.json");
    fs::write(&path, report.to_string()).unwrap();
    path
}

#[test]
fn a_plc_that_was_not_there_all_the_time_keeps_no_limit_and_is_told_everywhere() {
    fn ended(plc: &mut Value) {
        plc["end"] = "ended itself with code 0".into();
    }
    fn failed(plc: &mut Value) {
        (plc["failed"], plc["end"]) = (true.into(), "triple fault".into());
    }
    fn restarted(plc: &mut Value) {
        plc["restarts"] = 2.into();
    }
    fn lost(plc: &mut Value) {
        plc["lost"] = 1_999.into();
    }
    for (name, change, expected) in [
        (
            "ended",
            ended as fn(&mut Value),
            "it did not run until the end: ended itself with code 0",
        ),
        ("failed", failed, "it has failed: triple fault"),
        ("restarted", restarted, "it was started anew 2 times"),
        ("lost", lost, "1999 releases were lost, 0 are allowed"),
    ] {
        let (report, out) = (report_with(name, change), scratch("not-there"));
        for (options, status) in [(&["--max-latency", "1s"][..], 5), (&[][..], 0)] {
            let output = render(&report, &recorded("samples.json"), &out, options);
            let shown = text(&output.stdout);
            assert_eq!(output.status.code(), Some(status), "{name}: {shown}");
            assert!(!shown.contains("all limits are kept"), "{shown}");
            assert_eq!(shown.contains(&format!("EXCEEDED plc: {expected}")), status == 5);
            assert_eq!(page(&out).contains(&format!("plc {expected}")), status == 5);
        }
    }
    let report = report_with("restarted", restarted);
    let output = render(&report, &recorded("samples.json"), &scratch("not-there"), &[]);
    assert!(text(&output.stdout).contains("\n  restarts 2; stopped by takt\n"), "{output:?}");
}

/// The recorded samples with another course of the load; `None` for no load at all.
fn samples_with(name: &str, change: Option<fn(&mut Value)>) -> PathBuf {
    let mut samples = json(&recorded("samples.json"));
    match change {
        Some(change) => change(&mut samples["loads"][0]),
        None => samples["loads"] = Value::Array(Vec::new()),
    }
    let path = scratch(name).join("samples.json");
    fs::write(&path, samples.to_string()).unwrap();
    path
}

#[test]
fn a_load_that_is_not_proved_keeps_no_limit_and_is_told_everywhere() {
    let stood_still = |load: &mut Value| {
        load["standstill"] =
            serde_json::json!({ "from_ns": 1, "to_ns": 2_000_000_001_u64, "lines": 3 });
    };
    let not_begun = |load: &mut Value| load["points"] = serde_json::json!([[1, 0]]);
    for (samples, expected) in [
        (samples_with("still", Some(stood_still)), "the load compile stood still for 2.000 s"),
        (
            samples_with("short", Some(not_begun)),
            "the load compile began at 0.820 s and had no progress",
        ),
        (samples_with("unseen", None), "the load compile was not seen"),
    ] {
        let out = scratch("not-proved");
        let report = recorded("report.json");
        let limited = ["--load", "compile", "--max-lost", "9999"];
        for (options, status) in [(&limited[..], 5), (&limited[..2], 0)] {
            let output = render(&report, &samples, &out, options);
            let shown = text(&output.stdout);
            assert_eq!(output.status.code(), Some(status), "{shown}");
            assert!(shown.contains("NOT PROVED") && shown.contains(expected), "{shown}");
            assert!(!shown.contains("all limits are kept"), "{shown}");
            assert!(page(&out).contains(expected) && !page(&out).contains("All limits are kept"));
            assert_self_contained(&page(&out));
            let addition = &json(&out.join("report.json"))["jitter"];
            assert_eq!(addition["proof"]["proved"], false);
            assert!(addition["proof"]["reason"].as_str().unwrap().starts_with(expected));
            let kinds = addition["breaches"].as_array().unwrap().iter().map(|b| &b["kind"]);
            assert_eq!(kinds.filter(|kind| **kind == "load").count(), usize::from(status == 5));
        }
        let output = render(&report, &samples, &out, &["--max-lost", "9999"]);
        assert_eq!(output.status.code(), Some(0), "no load was asked for: {output:?}");
    }
}

#[test]
fn files_that_are_of_no_use_are_told_apart() {
    let out = scratch("useless");
    let (good, samples) = (recorded("report.json"), recorded("samples.json"));
    let broken = out.join("broken.json");
    fs::write(&broken, "{").unwrap();
    // Other versions have other keys, too.
    let other = |name: &str, version: u64, missing: &str| {
        let (mut value, path) = (json(&recorded(name)), out.join(format!("other-{name}")));
        value["schema_version"] = version.into();
        value.as_object_mut().unwrap().remove(missing).unwrap();
        fs::write(&path, value.to_string()).unwrap();
        path
    };
    let (old, old_samples) = (other("report.json", 2, "tick"), other("samples.json", 1, "loads"));
    for (report, samples, expected) in [
        (&broken, &samples, "is no report"),
        (&good, &broken, "is no samples file"),
        (&samples, &samples, "is no report"),
        (&good, &good, "is no samples file"),
        (&old, &samples, "is a report of version 2"),
        (&good, &old_samples, "is a samples file of version 1"),
        (&out.join("none"), &samples, "cannot read"),
    ] {
        let output = render(report, samples, &out, &[]);
        assert_eq!(output.status.code(), Some(3), "{expected}");
        let said = text(&output.stderr);
        assert!(said.contains(expected), "{expected}: {said}");
        assert!(!out.join("report.html").exists());
    }
}

#[test]
fn wrong_usage_gives_status_2() {
    for arguments in [
        &[][..],
        &["render"],
        &["x.toml", "--load", "hammer"],
        &["x.toml", "--max-latency", "soon"],
        &["x.toml", "--max-late", "-1"],
    ] {
        let output = Command::new(PROGRAM).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    }
    let help = Command::new(PROGRAM).arg("--help").output().unwrap();
    assert!(help.status.success() && text(&help.stdout).contains("Exit status"));
}

/// A folder with this program, and the one that stands for takt beside it.
fn beside_takt(name: &str) -> PathBuf {
    let folder = scratch(name);
    fs::hard_link(PROGRAM, folder.join("takt-jitter")).unwrap();
    symlink(recorded("takt"), folder.join("takt")).unwrap();
    folder
}

#[test]
fn a_measurement_runs_takt_with_the_load_and_shows_what_it_leaves() {
    let folder = beside_takt("measure");
    let out = folder.join("out");
    let output = Command::new(folder.join("takt-jitter"))
        .args(["some.toml", "--for", "60s", "--load", "compile", "--out"])
        .arg(&out)
        .args(["--", "--lane", "direct"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert!(text(&output.stderr).contains("[takt] what takt says"));
    assert!(
        text(&output.stdout).contains("load compile (linux: compile, 37 objects from 0.820 s on)")
    );
    let arguments = fs::read_to_string(folder.join("arguments")).unwrap();
    let arguments: Vec<&str> = arguments.lines().collect();
    assert_eq!(arguments[..2], ["run", "some.toml"]);
    let followed = |by: [&str; 2]| arguments.windows(2).any(|two| two == by);
    assert!(followed(["--for", "60s"]) && followed(["--append", "takt.load=compile"]));
    assert_eq!(arguments[arguments.len() - 2..], ["--lane", "direct"]);
    let addition = &json(&out.join("report.json"))["jitter"];
    let progress = json(&recorded("samples.json"))["loads"][0].take();
    assert_eq!(progress["points"][2][1], 37);
    assert_eq!(addition["progress"], progress);
    assert_eq!(
        (&addition["proof"]["proved"], &addition["proof"]["reason"]),
        (&true.into(), &Value::Null)
    );
    assert!(page(&out).contains("some.toml --for 60s --load compile --out"));
}

#[test]
fn a_run_that_fails_keeps_its_status_before_any_limit() {
    for (status, drawn) in [("2", false), ("3", false), ("4", true)] {
        let folder = beside_takt(&format!("failing-{status}"));
        fs::write(folder.join("status"), status).unwrap();
        let out = folder.join("out");
        let output = Command::new(folder.join("takt-jitter"))
            .args(["some.toml", "--max-latency", "1ns", "--out"])
            .arg(&out)
            .output()
            .unwrap();
        assert_eq!(output.status.code().map(|code| code.to_string()).as_deref(), Some(status));
        assert_eq!(out.join("report.html").exists(), drawn, "{status}");
    }
}
