//! A program becomes another version of itself while it runs, and loses no cycle.
//!
//! The program checks itself: it counts its jobs, adds the counts up, and compares the sum with the formula in
//! each job. A value that does not get to where the new version looks for it is a fault in the next cycle.

mod compiling;
mod killed;
mod large;
mod shadow;
mod versions;

use std::fs;
use std::process::Command;

use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Nanoseconds, Version, signature};
use takt_tests::{Value, root, target, timeout_s};

const PRIVATE: [u8; 32] = [3; 32];

const FILE: &str = r#"
version = 1
[system]
name = "change"
major_frame = "1ms"

[[partition]]
name = "plc"
kind = "plc"
cpu = 0
memory = "16MiB"

[[partition.program]]
image = "IMAGE"
name = "tank"
allow_force = true
keys = ["KEY"]

[[schedule]]
name = "normal"

[[schedule.window]]
partition = "plc"
offset = "0us"
duration = "300us"
"#;

/// What a version does when its job is complete.
#[derive(Clone, Copy, PartialEq)]
enum End {
    Return,
    Fault,
    Never,
    /// After some 20,000 instructions.
    Late,
}

/// A version with these variables in this order; `count` and `sum` are among them.
struct Tank {
    patch: u16,
    variables: Vec<(&'static str, Elementary, u64)>,
    end: End,
    category: u32,
    task: &'static str,
    budget_us: u64,
    /// Bytes of state behind the variables that have no name.
    nameless: u32,
}

impl Tank {
    fn new(patch: u16, variables: &[(&'static str, Elementary, u64)]) -> Self {
        let variables = variables.to_vec();
        let (end, task) = (End::Return, "control");
        Self { patch, variables, end, category: 7, task, budget_us: 100, nameless: 0 }
    }

    /// Name, type and place of each.
    fn places(&self) -> Vec<(&'static str, Elementary, u32)> {
        let mut end = 0u32;
        let place = |&(name, ty, _): &(&'static str, Elementary, u64)| {
            let at = end.next_multiple_of(ty.bytes());
            end = at + ty.bytes();
            (name, ty, at)
        };
        self.variables.iter().map(place).collect()
    }

    fn code(&self) -> Vec<u8> {
        let find = |name| self.places().into_iter().find(|place| place.0 == name).unwrap();
        let (_, count_type, count) = find("count");
        let (_, _, sum) = find("sum");
        let address = |offset: u32| (0x5000_0000 + offset).to_le_bytes();
        let mut code: Vec<u8> = Vec::new();
        let mut add = |opcode: &[u8], offset: Option<u32>| {
            code.extend_from_slice(opcode);
            code.extend(offset.iter().flat_map(|offset| address(*offset)));
        };
        let wide = count_type.bytes() == 8;
        // rcx = count; it may be behind the number of the job by one for each version that failed.
        add(if wide { &[0x48, 0x8b, 0x0c, 0x25][..] } else { &[0x8b, 0x0c, 0x25] }, Some(count));
        add(&[0x48, 0x8b, 0x47, 0x08], None); // mov rax, [rdi + 8]
        add(&[0x48, 0x29, 0xc8], None); // sub rax, rcx
        add(&[0x48, 0x83, 0xf8, 4, 0x76, 2, 0x0f, 0x0b], None); // cmp rax, 4; jbe over; ud2
        add(&[0x48, 0xff, 0xc1], None); // inc rcx
        add(if wide { &[0x48, 0x89, 0x0c, 0x25][..] } else { &[0x89, 0x0c, 0x25] }, Some(count));
        add(&[0x48, 0x01, 0x0c, 0x25], Some(sum)); // add [sum], rcx
        add(&[0x48, 0x8d, 0x51, 1], None); // lea rdx, [rcx + 1]
        add(&[0x48, 0x0f, 0xaf, 0xd1], None); // imul rdx, rcx
        add(&[0x48, 0xd1, 0xea], None); // shr rdx, 1
        add(&[0x48, 0x3b, 0x14, 0x25], Some(sum)); // cmp rdx, [sum]
        add(&[0x74, 2, 0x0f, 0x0b], None); // je over; ud2
        // What is not known in the first version still has its initial value.
        for ((name, ty, at), (_, _, initial)) in self.places().into_iter().zip(&self.variables) {
            if !matches!(name, "count" | "sum") {
                assert_eq!(ty, Elementary::Ulint);
                add(&[0x48, 0x83, 0x3c, 0x25], Some(at));
                add(&[*initial as u8, 0x74, 2, 0x0f, 0x0b], None); // cmp; je over; ud2
            }
        }
        add(
            match self.end {
                End::Return => &[0xc3],
                End::Fault => &[0x0f, 0x0b],
                End::Never => &[0xeb, 0xfe],
                // mov ecx, 10000; dec ecx; jnz back; ret
                End::Late => &[0xb9, 0x10, 0x27, 0, 0, 0xff, 0xc9, 0x75, 0xfc, 0xc3],
            },
            None,
        );
        code
    }

    fn unsigned(&self) -> Vec<u8> {
        let mut builder = Builder::new("tank");
        builder.version = Version { major: 1, minor: 0, patch: self.patch };
        builder.category = self.category;
        builder.code = self.code();
        for ((name, ty, at), (_, _, initial)) in self.places().into_iter().zip(&self.variables) {
            let id = builder.elementary(ty);
            builder.variable(Variable::new(name, id, Area::State, at));
            builder.state.resize(at as usize, 0);
            builder.state.extend_from_slice(&initial.to_le_bytes()[..ty.bytes() as usize]);
        }
        builder.state_bytes = builder.state.len() as u32 + self.nameless;
        builder.task(Task {
            budget: Some(Nanoseconds(1_000 * self.budget_us)),
            ..Task::cyclic(self.task, Nanoseconds(1_000_000), CodeOffset(0))
        });
        builder.build().unwrap()
    }

    fn image(&self) -> Vec<u8> {
        let mut image = self.unsigned();
        signature::sign(&mut image, &PRIVATE).unwrap();
        image
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// What Takt said on its socket, on its output, and its report.
fn run() -> (Vec<Value>, String, Value) {
    use Elementary::{Udint, Ulint};
    let (folder, out) = (target("tests/change"), target("tests/change.out"));
    for folder in [&folder, &out] {
        let _ = fs::remove_dir_all(folder);
        fs::create_dir_all(folder).unwrap();
    }
    let first = Tank::new(0, &[("count", Udint, 0), ("sum", Ulint, 0)]);
    let with =
        |patch| Tank::new(patch, &[("fresh", Ulint, 7), ("count", Ulint, 0), ("sum", Ulint, 0)]);
    let grown = with(1);
    let load = |name: &str, image: &[u8]| {
        let data = hex(image);
        let request = format!(
            r#"{{"version":2,"request":"load","partition":"plc","program":"tank","part":0,"parts":1,"data":"{data}"}}"#
        );
        fs::write(folder.join(name), request).unwrap();
    };
    load("unsigned", &grown.unsigned());
    let mut other_key = grown.unsigned();
    signature::sign(&mut other_key, &[4; 32]).unwrap();
    load("other-key", &other_key);
    let image = grown.image();
    load("truncated", &image[..image.len() - 4096]);
    let mut damaged = image.clone();
    damaged[0x1000] ^= 1;
    load("damaged", &damaged);
    load("other-category", &Tank { category: 8, ..with(1) }.image());
    load("other-task", &Tank { task: "other", ..with(1) }.image());
    load("nameless", &Tank { nameless: 128, ..with(1) }.image());
    load("greedy", &Tank { budget_us: 400, ..with(1) }.image());
    load("grown", &image);
    load("faulting", &Tank { end: End::Fault, ..with(2) }.image());
    load("endless", &Tank { end: End::Never, ..with(3) }.image());
    load("tight", &Tank { end: End::Late, budget_us: 5, ..with(5) }.image());
    let longer = Tank::new(
        4,
        &[("sum", Ulint, 0), ("more", Ulint, 9), ("count", Ulint, 0), ("fresh", Ulint, 7)],
    );
    load("longer", &longer.image());
    for order in ["commit", "roll-back"] {
        let request =
            format!(r#"{{"version":2,"request":"{order}","partition":"plc","program":"tank"}}"#);
        fs::write(folder.join(order), request).unwrap();
    }
    let (image, file) = (folder.join("first.plc"), folder.join("change.toml"));
    // The place of `fresh` in version 1.0.1 is that of `sum` in version 1.0.4.
    let fresh = |at| format!(r#""partition":"plc","point":[0,1,{at},8,255]"#);
    let named = r#""value":7,"name":"tank.fresh","text":"7""#;
    for (name, request) in [
        ("force", format!(r#""force",{},{named}"#, fresh(0))),
        ("release", format!(r#""release",{}"#, fresh(0))),
        ("force-longer", format!(r#""force",{},{named}"#, fresh(24))),
        ("release-longer", format!(r#""release",{}"#, fresh(24))),
        ("watch", r#""watch","partition":"plc","ranges":[[0,1,0,8]]"#.to_owned()),
    ] {
        fs::write(folder.join(name), format!(r#"{{"version":2,"request":{request}}}"#)).unwrap();
    }
    fs::write(&image, first.image()).unwrap();
    let (folder, image) = (fs::canonicalize(&folder).unwrap(), fs::canonicalize(&image).unwrap());
    let text = FILE.replace("IMAGE", image.to_str().unwrap());
    fs::write(&file, text.replace("KEY", &hex(&signature::public(&PRIVATE)))).unwrap();
    let output = Command::new(root().join("scripts/host"))
        .args(["--program", env!("CARGO_BIN_EXE_talk")])
        .arg("--file")
        .arg(&folder)
        .arg("--out")
        .arg(&out)
        .arg(root().join("tests/host/change"))
        .arg(folder.join("change.toml"))
        .arg(&folder)
        .env("TAKT_TIMEOUT", timeout_s(0))
        .output()
        .unwrap();
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_default();
    let console = String::from_utf8_lossy(&output.stdout).into_owned() + &read("takt");
    let said = console.clone() + &read("answers") + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    let answers = read("answers");
    let answers = answers.lines().map(|line| serde_json::from_str(line).unwrap());
    (answers.collect(), console, serde_json::from_str(&read("report.json")).unwrap())
}

#[test]
fn a_program_changes_while_it_runs_and_loses_no_cycle() {
    let (answers, console, report) = run();
    let of = |kind: &str| -> Vec<&Value> {
        answers.iter().filter(|answer| answer["answer"] == *kind).collect()
    };
    // What is no version of the program is refused, and it goes on.
    let reasons = [
        "the image is not signed, and the partition file names keys",
        "signed with a key that the partition file does not name",
        "bytes are needed, the file has",
        "the content has changed since the image was made",
        "the category is 8, and 7 in the running version",
        "the name of task 0 is other, and control in the running version",
        "has 88 bytes of state at offset 64 that no variable names",
        "in the schedule \"normal\" the task \"tank.control\" is not proven to meet its deadlines",
        "1 of its values are forced: release them first",
        "another version",
        "values of tank are watched no longer",
        "1 of its values are forced: release them first",
    ];
    let refusals = of("error");
    assert_eq!(refusals.len(), reasons.len(), "{answers:#?}");
    for (refusal, reason) in refusals.iter().zip(reasons) {
        assert!(refusal["text"].as_str().unwrap().contains(reason), "{reason}: {refusal}");
    }
    let done: Vec<&str> = of("done").iter().filter_map(|answer| answer["text"].as_str()).collect();
    let said = |text: &str| done.iter().filter(|done| done.contains(text)).count();
    assert_eq!((said("tank.fresh := 7, forced"), said("tank.fresh is forced no longer")), (2, 2));
    let versions: Vec<&Value> =
        of("versions").iter().map(|answer| &answer["versions"][0]).collect();
    let [grown, faulting, endless, tight, longer, back, anew] = versions[..] else {
        panic!("{answers:#?}")
    };
    let story = |version: &Value| {
        let text = |key: &str| version[key].as_str().unwrap_or("-").to_owned();
        (version["running"]["version"].as_str().unwrap().to_owned(), text("phase"), text("reason"))
    };
    let told =
        |running: &str, phase: &str, reason: &str| (running.into(), phase.into(), reason.into());
    assert_eq!(story(grown), told("1.0.1", "held", "-"), "{console}");
    assert_eq!(story(faulting), told("1.0.1", "rolled-back", "a fault of the new version"));
    let budget = "a job of the new version used up its budget";
    assert_eq!(story(endless), told("1.0.1", "rolled-back", budget), "{console}");
    // The budget is that of the version, whose job would have fitted into the one before.
    assert_eq!(story(tight), told("1.0.1", "rolled-back", budget), "{console}");
    assert_eq!(story(longer), told("1.0.4", "held", "-"), "{console}");
    assert_eq!(story(back), told("1.0.1", "rolled-back", "an operator's order"), "{console}");
    // A guest that starts anew has the version that was entered last.
    assert_eq!(story(anew), told("1.0.1", "none", "-"), "{console}");
    for version in [grown, faulting, endless, tight, longer, back] {
        let took = version["took_ns"].as_u64().unwrap();
        println!("change: {took} ns at cycle {}", version["cycle"]);
        assert!((1..=10_000).contains(&took), "{version:#}");
    }

    // The processor's time that the change took of the PLC's, from the order to prepare to the end of the trial.
    let statuses: Vec<&Value> = of("status");
    let [first, second, third] = statuses[..] else { panic!("{statuses:#?}") };
    let spent = |from: &Value, to: &Value| {
        let of = |status: &Value, key: &str| {
            let plc = &status["status"]["partitions"][0];
            plc.pointer(key).and_then(Value::as_f64).unwrap_or_else(|| panic!("{plc:#}"))
        };
        ["/cpu_time_ns", "/releases/happened"].map(|key| of(to, key) - of(from, key))
    };
    let ([time, windows], [with, windows_with]) = (spent(first, second), spent(second, third));
    let took = with - time / windows * windows_with;
    println!("the change took {took:.0} ns of the PLC's processor time, in {windows_with} windows");
    assert!((0.0..1_000_000.0).contains(&took), "{took} ns");

    // Up to then each job ran, and each found the values that the one before it left: else it had faulted.
    let task = &third["status"]["partitions"][0]["programs"][0]["tasks"][0];
    for key in ["missed", "overruns", "skipped"] {
        assert_eq!(task[key], 0, "{task:#}");
    }
    let faults = console.matches(": invalid opcode").count();
    assert_eq!(faults, 1, "the faulting version only\n{console}");

    let plc = &report["partitions"][0];
    for key in ["lost", "late_releases", "unrecorded"] {
        assert_eq!(plc[key], 0, "{key}: {plc:#}");
    }
    let latest = plc["release_latency_ns"]["max"].as_u64().unwrap();
    println!("the latest release: {latest} ns");
    assert!(latest <= 10, "{plc:#}");
}
