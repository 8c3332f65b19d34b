//! What `takt doctor` says of machines of which all is known.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_tests::{Value, root, target, timeout_s};

/// Findings by their check's name.
type Findings = BTreeMap<String, Value>;

/// `takt-doctor` as users have it.
pub fn doctor() -> PathBuf {
    let mut cargo = Command::new("cargo");
    cargo.args(["build", "--release", "--quiet", "--bin", "takt-doctor"]).current_dir(root());
    // What this test's cargo tells its programs is not meant for another cargo.
    for (key, _) in std::env::vars().filter(|(key, _)| {
        key.starts_with("CARGO") && key != "CARGO_HOME" && key != "CARGO_TARGET_DIR"
    }) {
        cargo.env_remove(key);
    }
    assert!(cargo.status().expect("cargo starts").success(), "takt-doctor does not build");
    let own = std::env::current_exe().unwrap();
    own.ancestors().nth(3).map(Path::to_owned).unwrap().join("release/takt-doctor")
}

/// Examines the appliance with a kernel of this flavour; returns the exit status and what was said.
fn examine(flavour: &str) -> (Option<i32>, Value) {
    let file = root().join("configs/plc-alone.toml").canonicalize().unwrap();
    let out = target("tests").join(format!("doctor-{flavour}.out"));
    let _ = fs::remove_dir_all(&out);
    let output = Command::new(root().join("scripts/host"))
        .args(["--kernel", flavour])
        .arg("--program")
        .arg(doctor())
        .arg("--file")
        .arg(&file)
        .arg("--out")
        .arg(&out)
        .arg(root().join("tests/host/doctor"))
        .arg(&file)
        .env("TAKT_TIMEOUT", timeout_s(0))
        .output()
        .unwrap();
    let console = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    let report = fs::read_to_string(out.join("doctor.json")).unwrap_or_default();
    let report = serde_json::from_str(&report).unwrap_or_else(|e| panic!("{e}\n{console}"));
    (output.status.code(), report)
}

fn findings(report: &Value) -> Findings {
    let all = report["findings"].as_array().unwrap().iter();
    all.map(|finding| (finding["check"].as_str().unwrap().to_owned(), finding.clone())).collect()
}

/// Fails unless the check has this severity, and has found something with this text in it.
fn assert_found(findings: &Findings, check: &str, severity: &str, text: &str) {
    let finding = &findings[check];
    let found = finding["found"].as_str().unwrap();
    assert!(finding["severity"] == severity && found.contains(text), "{finding:#}");
}

/// What is the same with every kernel: the machine, and that it is QEMU's.
fn assert_machine(findings: &Findings) {
    assert_found(findings, "privileges", "good", "");
    assert_found(findings, "kvm", "good", "");
    assert_found(findings, "virtualisation", "good", "at hardware speed");
    assert_found(findings, "reservations", "good", "CPU 0: 2 reservations of 50.7 %");
    assert_found(findings, "reservations", "good", "admitted");
    assert_found(findings, "cpus", "good", "0 online");
    // The lab's counter is its clock, which the kernel knows to some millionths; the emulated
    // processor promises nothing.
    let rate = findings["tsc-rate"]["found"].as_str().unwrap();
    let mhz: f64 = rate.split(' ').next().unwrap().parse().unwrap();
    assert!((mhz - 1000.0).abs() < 0.1, "{rate}");
    assert_found(findings, "tsc-rate", "good", "steady within");
    assert_found(findings, "tsc", "warning", "not invariant");
    assert_found(findings, "tsc-watchdog", "good", "by the hypervisor's word");
    assert_found(findings, "clock-steering", "good", "+0.0 ppm");
    assert_found(findings, "clock-rate", "good", "NTP's part is +0.0 ppm");
    // Process 1 of the appliance has switched it off.
    assert_found(findings, "watchdogs", "good", "none on a CPU with windows");
    assert_found(findings, "tick", "good", "one CPU");
    assert_found(findings, "c-states", "good", "");
    assert_found(findings, "smi", "good", "no counter");
    for check in ["smt", "governor", "iommu", "memory", "memlock", "interrupts", "console"] {
        assert_found(findings, check, "good", "");
    }
    // As late as in a run, see docs/timing.md; one thread alone wakes up well within its guard.
    assert_found(findings, "wake-up", "good", "the guard is 20us");
}

#[test]
fn the_appliance_keeps_its_promises_and_is_left_as_it_was() {
    let (status, report) = examine("rt-amd64");
    let findings = findings(&report);
    assert_eq!((status, &report["verdict"]), (Some(1), &"warning".into()), "{report:#}");
    assert_eq!((&report["schema"], &report["windowed_cpus"]), (&1.into(), &vec![0].into()));
    assert_machine(&findings);
    assert_found(&findings, "preemption", "good", "PREEMPT_RT");
    assert_found(&findings, "moved-pages", "good", "");
    assert_found(&findings, "latency", "good", "");
}

#[ignore = "only in the long form: scripts/test --long"]
#[test]
fn a_kernel_without_preempt_rt_is_told_apart() {
    let (status, report) = examine("cloud-amd64");
    let findings = findings(&report);
    assert_eq!((status, &report["verdict"]), (Some(3), &"cannot".into()), "{report:#}");
    assert_machine(&findings);
    assert_found(&findings, "preemption", "cannot", "voluntary without PREEMPT_RT");
    assert_found(&findings, "moved-pages", "warning", "compaction");
    let cannot = findings.values().filter(|finding| finding["severity"] == "cannot").count();
    assert_eq!(cannot, 1, "{report:#}");
}
