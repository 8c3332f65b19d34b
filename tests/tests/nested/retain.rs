//! What a program retains over restarts, the death of Takt, a damaged file, and a download.
//!
//! The program counts its jobs in a RETAIN variable, in a second one in another page, in a PERSISTENT and in a plain one.
//! The plain count is zero at each start, so the others less that one are what they began with, exactly. Both RETAIN
//! counts are the same after each job; a program that finds them different stops with a fault.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Flags, Nanoseconds};
use takt_retain::Generation;
use takt_tests::{File, Value, plc_image, root, save_bytes, target, timeout_s};

use super::st;

const FILE: &str = r#"
version = 1
[system]
name = "retain"
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
on_fault = "warm-restart"
retain = "/out/tank"
retain_every = "100ms"

[[schedule]]
name = "normal"

[[schedule.window]]
partition = "plc"
offset = "0us"
duration = "300us"
"#;

/// Places of the variables.
const COUNT: u32 = 0;
const TOTAL: u32 = 8;
const PLAIN: u32 = 16;
const START: u32 = 24;
const TRIP: u32 = 32;
const TWIN: u32 = 4096;

fn code() -> Vec<u8> {
    let mut code: Vec<u8> = Vec::new();
    let mut add = |opcode: &[u8], offset: Option<u32>| {
        code.extend_from_slice(opcode);
        code.extend(offset.iter().flat_map(|offset| (0x5000_0000 + offset).to_le_bytes()));
    };
    add(&[0x8b, 0x47, 0x20], None); // mov eax, [rdi + 32]
    add(&[0x48, 0x89, 0x04, 0x25], Some(START)); // mov [start], rax
    add(&[0x48, 0x8b, 0x04, 0x25], Some(COUNT)); // mov rax, [count]
    add(&[0x48, 0x3b, 0x04, 0x25], Some(TWIN)); // cmp rax, [twin]
    add(&[0x74, 2, 0x0f, 0x0b], None); // je over; ud2
    add(&[0x48, 0x83, 0x3c, 0x25], Some(TRIP)); // cmp qword [trip], 0
    add(&[0, 0x74, 2, 0x0f, 0x0b], None); // je over; ud2
    for count in [COUNT, TOTAL, PLAIN, TWIN] {
        add(&[0x48, 0xff, 0x04, 0x25], Some(count)); // inc qword
    }
    add(&[0xc3], None);
    code
}

/// The program; in another version a PERSISTENT value is new, and one has another type.
fn image(other: bool) -> Vec<u8> {
    let mut builder = Builder::new("tank");
    builder.version.patch = u16::from(other);
    builder.code = code();
    builder.state_bytes = 3 * 4096;
    let (ty, word) = (builder.elementary(Elementary::Ulint), builder.elementary(Elementary::Lword));
    let mut add = |name: &str, at, flags, ty| {
        builder.variable(Variable::new(name, ty, Area::State, at).with(flags));
    };
    add("count", COUNT, Flags::RETAIN, ty);
    add("twin", TWIN, Flags::RETAIN, ty);
    add("total", TOTAL, Flags::PERSISTENT, ty);
    add("kind", 64, Flags::PERSISTENT, if other { word } else { ty });
    add(if other { "fresh" } else { "gone" }, 72, Flags::PERSISTENT, ty);
    for (name, at) in [("plain", PLAIN), ("start", START), ("trip", TRIP)] {
        add(name, at, Flags::FORCEABLE, ty);
    }
    builder.task(Task {
        budget: Some(Nanoseconds(100_000)),
        ..Task::cyclic("control", Nanoseconds(1_000_000), CodeOffset(0))
    });
    builder.build().unwrap()
}

/// What a line of values says of the start that the program runs since.
#[derive(Debug)]
struct Line {
    /// What RETAIN and PERSISTENT counts were at the start.
    began: [i64; 2],
    /// What they are.
    count: i64,
    total: i64,
    warm: bool,
}

impl Line {
    fn read(line: &str) -> Self {
        let line: Value = serde_json::from_str(line).unwrap();
        let digits = line["values"]["bytes"].as_str().unwrap_or_else(|| panic!("{line}"));
        let word = |at: usize| {
            let digits = &digits[2 * at..2 * at + 16];
            u64::from_str_radix(digits, 16).unwrap().swap_bytes().cast_signed()
        };
        let [count, total, plain, start] = [0, 8, 16, 24].map(word);
        assert_eq!(count, word(40), "both RETAIN counts");
        Self { began: [count - plain, total - plain], count, total, warm: start == 1 }
    }
}

/// What the counts are in a file.
fn in_file(path: PathBuf) -> [i64; 2] {
    let generation = Generation::decode(&fs::read(path).unwrap()).unwrap();
    ["count", "total"].map(|name| {
        let entry = generation.entries.iter().find(|entry| entry.name == name).unwrap();
        i64::from_le_bytes(entry.value[..].try_into().unwrap())
    })
}

#[test]
fn what_is_retained_outlives_restarts_and_the_death_of_takt() {
    let (folder, out) = (target("tests/retain"), target("tests/retain.out"));
    for folder in [&folder, &out] {
        let _ = fs::remove_dir_all(folder);
        fs::create_dir_all(folder).unwrap();
    }
    let folder = fs::canonicalize(&folder).unwrap();
    for (name, other) in [("retain", false), ("download", true)] {
        let path = folder.join(name).with_extension("plc");
        fs::write(&path, image(other)).unwrap();
        let text = FILE.replace("IMAGE", path.to_str().unwrap());
        fs::write(folder.join(name).with_extension("toml"), text).unwrap();
    }
    let output = Command::new(root().join("scripts/host"))
        .args(["--program", env!("CARGO_BIN_EXE_talk")])
        .arg("--file")
        .arg(&folder)
        .arg("--out")
        .arg(&out)
        .arg(root().join("tests/host/retain"))
        .arg(&folder)
        .env("TAKT_TIMEOUT", timeout_s(0))
        .output()
        .unwrap();
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_default();
    let said: Vec<String> = (1..=4).map(|run| read(&format!("takt-{run}"))).collect();
    let all = said.join("\n") + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{all}");
    let lines = read("values");
    println!("{lines}");
    let lines: Vec<Line> = lines.lines().map(Line::read).collect();
    let [first, program, warm, cold, killed, damaged, download] = &lines[..] else {
        panic!("{lines:?}\n{all}")
    };
    println!("{lines:#?}");
    assert_eq!((first.began, first.warm), ([0, 0], false));

    // The program alone, warm: each value as the failed job found it, of which none is lost.
    assert!(program.warm && program.began[0] >= first.count, "{program:?} after {first:?}");
    assert_eq!(program.began[0], program.began[1]);
    assert!(said[0].contains("the program starts anew, warm"), "{}", said[0]);

    // The PLC, warm: values of one cycle, at most 100 ms and Takt's turns before the stop.
    assert!(warm.warm && warm.began[0] >= program.count - 300, "{warm:?} after {program:?}");
    assert_eq!(warm.began[0], warm.began[1], "of one cycle");

    // Cold: RETAIN is lost, PERSISTENT is not.
    assert!(!cold.warm && cold.began[0] == 0, "{cold:?}");
    assert!(cold.began[1] >= warm.total - 300, "{cold:?} after {warm:?}");

    // Takt was killed. What it had written is there, of one cycle.
    let apart = |line: &Line| line.total - line.count;
    assert!(killed.warm, "{killed:?}");
    assert!(killed.began[0] >= cold.count - 400, "{killed:?} after {cold:?}");
    assert_eq!(apart(killed), apart(cold), "of one cycle");
    let taken = "tank: RETAIN and PERSISTENT values are those of cycle";
    assert!(said[1].contains(taken), "{}", said[1]);

    // One of two files is cut: what the other one has.
    let other = in_file(out.join("2.b"));
    assert_eq!((damaged.began, damaged.warm), (other, true), "{}", said[2]);
    assert!(said[2].contains("tank: /out/tank.a: it has 100 bytes"), "{}", said[2]);
    let both = [in_file(out.join("2.a")), other];
    assert!((1..=300).contains(&(both[0][0] - both[1][0]).abs()), "{both:?}");

    // Another image: PERSISTENT by name and type only.
    assert!(!download.warm && download.began[0] == 0, "{download:?}");
    assert!(download.began[1] >= damaged.total - 300, "the end of a run writes what is newest");
    for text in [
        "tank: PERSISTENT values are those of cycle",
        "tank: 2 RETAIN values start anew, because another image ran; new: fresh; dropped: gone; of another type, start \
         anew: kind (ULINT -> LWORD)",
    ] {
        assert!(said[3].contains(text), "{text}\n{}", said[3]);
    }
    for said in &said {
        assert!(!said.contains("not written") && !said.contains("cannot be"), "{said}");
    }
    let faults = all.matches("invalid opcode").count();
    assert_eq!(faults, 1, "the one that was asked for\n{all}");
}

/// Fails in each hundredth job of a start, and tells what the start began with.
const STARTS: &str = "
FUNCTION_BLOCK Counter
    VAR_OUTPUT RETAIN kept : DINT; END_VAR
    VAR_OUTPUT plain : DINT; END_VAR
    kept := kept + 1;
    plain := plain + 1;
END_FUNCTION_BLOCK
PROGRAM Main
    VAR RETAIN starts : DINT; END_VAR
    VAR PERSISTENT hours : DINT; END_VAR
    VAR jobs, zero : DINT; counters : ARRAY[1..2] OF Counter; END_VAR
    IF jobs = 0 THEN
        LOG_LINE(CONCAT('starts ', DINT_TO_STRING(starts), CONCAT(' hours ', DINT_TO_STRING(hours)),
            CONCAT(' kept ', DINT_TO_STRING(counters[2].kept), ' plain ', DINT_TO_STRING(counters[2].plain))));
        starts := starts + 1;
        hours := hours + 10;
    END_IF;
    counters[2]();
    jobs := jobs + 1;
    IF jobs = 100 THEN zero := 1 / zero; END_IF;
END_PROGRAM
CONFIGURATION Plant
    TASK often (INTERVAL := T#1ms, PRIORITY := 3);
    PROGRAM main WITH often : Main;
END_CONFIGURATION
";

#[ignore = "takes long: scripts/test --all"]
#[test]
fn variables_of_programs_and_blocks_in_structured_text_outlive_starts_as_their_sources_say() {
    let image = save_bytes("retain-st.plc", &st::image("p", "main.st", STARTS));
    let run = |on_fault: &str| {
        let lines = format!(
            "image = {:?}\nmemory = \"32MiB\"\n[[partition.program]]\nimage = {image:?}\nname = \"p\"\n\
             on_fault = {on_fault:?}\n",
            plc_image("kernel")
        );
        let name = format!("retain-st-{on_fault}");
        let file =
            File::new("1ms").plc_with("plc", &lines).schedule("normal").window("plc", 0, 300);
        let outcome = file.run(&name).lasting("500ms").run();
        assert_eq!(outcome.status, 0, "{}", outcome.output);
        outcome
    };
    let (warm, cold) = (run("warm-restart"), run("restart"));
    for start in 0..3 {
        let (hours, kept) = (10 * start, 100 * start);
        warm.assert_shows(&format!("starts {start} hours {hours} kept {kept} plain 0"));
        cold.assert_shows(&format!("starts 0 hours {hours} kept 0 plain 0"));
    }
}
