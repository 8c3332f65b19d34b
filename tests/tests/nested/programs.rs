//! Program images in a PLC: how they get into the guest's memory, and which never do.

use takt_program::signature;
use takt_test_programs::{Entry, Program, cyclic, cyclic_from, us};
use takt_tests::{File, Outcome, root, save_bytes};

/// A private key, for tests.
const PRIVATE: [u8; 32] = [3; 32];

/// A PLC with the built-in kernel and one program, in windows of 300 us each ms.
fn plc(test: &str, image: &[u8], more: &str) -> File {
    let image = save_bytes(&format!("{test}.plc"), image);
    let program = format!("[[partition.program]]\nimage = {image:?}\n{more}\n");
    File::new("1ms").plc_with("plc", &format!("memory = \"16MiB\"\n{program}"))
}

/// A control task each ms, and a lesser one whose jobs take 600,000 rounds: several windows.
fn image() -> Vec<u8> {
    let program = Program::new("tank")
        .task(cyclic("control", us(1_000), 0, Entry::Destroy), 0)
        .task(cyclic("slow", us(20_000), 9, Entry::Work), 400_000);
    program.image()
}

fn key(private: &[u8; 32]) -> String {
    let digits =
        signature::public(private).iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    format!("keys = [\"{digits}\"]")
}

/// The count of jobs in the last row of a task's figures.
fn jobs(outcome: &Outcome, task: &str) -> u64 {
    let rows = outcome.output.lines().filter_map(|line| line.trim().strip_prefix("[plc] "));
    let row = rows.rev().find(|row| row.split_whitespace().next() == Some(task));
    let row = row.unwrap_or_else(|| panic!("no figures of {task}\n{}", outcome.output));
    row.split_whitespace().nth(1).and_then(|jobs| jobs.parse().ok()).unwrap_or(0)
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_program_runs_beside_a_linux_and_its_tasks_span_windows() {
    let file = plc("program-linux", &image(), "")
        .linux("sleep 1")
        .schedule("normal")
        .window("plc", 0, 300);
    let outcome = file.run("program-linux").lasting("60s").until("linux# ").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("[takt] plc: programs without a signature: tank");
    outcome.assert_shows("linux# ");
    // Not a window of those in which the lesser task went on is an overrun, and none costs a release.
    assert!(outcome.number("plc", "unfinished_windows") > 100, "{}", outcome.output);
    for key in ["overruns", "lost", "late_releases"] {
        assert_eq!(outcome.number("plc", key), 0, "{key}\n{}", outcome.output);
    }
    outcome.assert_punctual("plc");
    assert!(jobs(&outcome, "tank.control") > 1_000 && jobs(&outcome, "tank.slow") > 50);
}

#[test]
fn a_signed_program_runs_with_its_key_only() {
    let mut signed = image();
    signature::sign(&mut signed, &PRIVATE).expect("the image is whole");
    let run = |test: &str, image: &[u8], keys: &str| {
        let file = plc(test, image, keys).schedule("normal").window("plc", 0, 300);
        file.run(test).lasting("1500ms").run()
    };
    let right = run("program-signed", &signed, &key(&PRIVATE));
    assert_eq!(right.status, 0, "{}", right.output);
    assert!(jobs(&right, "tank.control") > 500, "{}", right.output);
    assert!(!right.output.contains("without a signature"), "{}", right.output);
    let wrong = run("program-other-key", &signed, &key(&[4; 32]));
    assert_eq!(wrong.status, 2, "{}", wrong.output);
    wrong.assert_shows("the image is signed with another key, ");
    let none = run("program-unsigned", &image(), &key(&PRIVATE));
    assert_eq!(none.status, 2, "{}", none.output);
    none.assert_shows("the image is not signed");
}

#[test]
fn an_image_that_is_damaged_starts_nothing() {
    let good = image();
    let mut changed = good.clone();
    let last = changed.len() - 1;
    changed[last] ^= 1;
    for (test, image) in [
        ("program-changed", &changed[..]),
        ("program-cut", &good[..good.len() / 2]),
        ("program-none", b"\x7fELF"),
    ] {
        let file = plc(test, image, "").schedule("normal").window("plc", 0, 300);
        let outcome = file.run(test).lasting("1s").run();
        assert_eq!(outcome.status, 2, "{}", outcome.output);
        outcome.assert_shows(&format!("{test}.plc is no program image: "));
        outcome.assert_shows(" = allowed: a program image of version 1");
    }
}

/// A guest that ends itself for a program's fault, and is started anew: it finds its programs again.
#[test]
fn a_guest_that_is_started_anew_finds_its_programs_whole() {
    // Not in the first window: a guest that ends before its first scan is not started again.
    let fault = cyclic_from(us(50_000), cyclic("fault", us(100_000), 5, Entry::Divide));
    let program =
        Program::new("tank").task(cyclic("control", us(1_000), 0, Entry::Work), 100).task(fault, 0);
    let file = plc("program-restart", &program.image(), "on_fault = \"stop-partition\"")
        .schedule("normal")
        .window("plc", 0, 300)
        .health("plc", "application-error", "warm-start");
    let outcome = file.run("program-restart").lasting("3s").run();
    let told = outcome.output.matches("task fault: tank.st:12: division by zero").count();
    assert_eq!(told, 4, "one start and three more\n{}", outcome.output);
    assert_eq!(outcome.number("plc", "restarts"), 3, "{}", outcome.output);
    assert_eq!(outcome.number("plc", "illegal_accesses"), 0, "{}", outcome.output);
}

/// The example program in C, which `scripts/run` builds by its Makefile because the file names it.
#[test]
fn a_program_in_c_doses_what_a_simulated_button_orders() {
    let image = root().join("target/examples/dosing.plc");
    let inputs = [
        ("flow", "{ shape = \"constant\", value = 1.0 }"),
        ("amount", "{ shape = \"constant\", value = 0.1 }"),
        // An order each 500 ms, of which a batch takes 100.
        ("button", "{ shape = \"square\", period = \"500ms\" }"),
    ];
    let inputs = inputs
        .map(|(point, value)| format!("[[partition.io]]\npoint = {point:?}\nsimulate = {value}\n"));
    let lines = format!(
        "memory = \"16MiB\"\n[[partition.program]]\nimage = {image:?}\n{}",
        inputs.concat()
    );
    let file = File::new("1ms").plc_with("plc", &lines).schedule("normal").window("plc", 0, 300);
    let outcome = file.run("program-c").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    let batches = outcome.output.matches("dosing.dose: a batch is complete").count();
    assert!((4..=5).contains(&batches), "{batches}\n{}", outcome.output);
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
    assert!(jobs(&outcome, "dosing.order") >= 3 && jobs(&outcome, "dosing.dose") > 150);
    outcome.assert_punctual("plc");
}
