//! Changes of more than fits between two cycles: 1 MiB of instances, each of which gets another layout.
//!
//! In each job 16 instances, which are 4 KiB, count and compare each value with what they wrote 256 jobs before. Versions follow
//! each other, one faults on trial, and roll-backs are ordered, all beside a Linux that compiles.

use std::fs;
use std::path::{Path, PathBuf};

use takt_abi::live::Range;
use takt_change::make::Change;
use takt_points::Search;
use takt_program::Image;
use takt_st::source::Sources;
use takt_st::{build, project, stack};
use takt_tests::{File, Host, Outcome, Value, long, parse, plc_image, save_bytes, target};

use super::hex;

const CELLS: usize = 4096;
/// Bytes of an image in a request, the most that one may have.
const PART: usize = 24_576;
/// The version whose sixth job faults.
const FAULTY: usize = 3;

/// The fields of a cell, in the order of a version. What is an `UDINT` in the first one is wider in all others.
fn fields(version: usize) -> &'static str {
    match version {
        0 => "count : UDINT; last : ULINT; row : ARRAY[1..28] OF LREAL;",
        1 => "fresh : LINT; row : ARRAY[1..28] OF LREAL; last : ULINT; count : ULINT;",
        2 => "last : ULINT; count : ULINT; more : DINT; row : ARRAY[1..28] OF LREAL;",
        _ => "row : ARRAY[1..28] OF LREAL; other : INT; count : ULINT; last : ULINT;",
    }
}

fn source(version: usize) -> String {
    let fields = fields(version);
    let number = version + 1;
    let fault = if version == FAULTY {
        "IF v_jobs > v_born + 5 THEN zero := 1 / zero; END_IF;"
    } else {
        ""
    };
    format!(
        "
FUNCTION_BLOCK Cell
VAR_INPUT
    jobs : ULINT;
END_VAR
VAR_OUTPUT
    wrong : UDINT;
END_VAR
VAR
    {fields}
END_VAR
VAR_TEMP
    index : DINT;
    before, now : LREAL;
END_VAR
IF count <> (jobs - 1) / 256 OR (count > 0 AND last + 256 <> jobs) THEN wrong := wrong + 1; END_IF;
before := ULINT_TO_LREAL(last);
now := ULINT_TO_LREAL(jobs);
FOR index := 1 TO 28 DO
    IF row[index] <> before THEN wrong := wrong + 1; END_IF;
    row[index] := now;
END_FOR;
count := count + 1;
last := jobs;
END_FUNCTION_BLOCK

PROGRAM Main
VAR
    v_jobs, v_born, v_wrong, v_version : ULINT;
    cells : ARRAY[0..{}] OF Cell;
END_VAR
VAR_TEMP
    index, start : DINT;
    zero : DINT;
END_VAR
IF v_version <> {number} THEN
    v_version := {number};
    v_born := v_jobs;
END_IF;
v_jobs := v_jobs + 1;
start := ULINT_TO_DINT(v_jobs MOD 256) * 16;
FOR index := start TO start + 15 DO
    cells[index](jobs := v_jobs);
    v_wrong := v_wrong + cells[index].wrong;
END_FOR;
{fault}
END_PROGRAM

CONFIGURATION Plant
    TASK often (INTERVAL := T#1ms, PRIORITY := 1);
    PROGRAM main WITH often : Main;
END_CONFIGURATION
",
        CELLS - 1
    )
}

fn image(source: &str) -> Vec<u8> {
    let mut sources = Sources::new();
    sources.add("main.st", source.as_bytes()).unwrap();
    let checked = project::check("tank", &mut sources).unwrap();
    let program = checked.program.unwrap_or_else(|| panic!("{:#?}", checked.diagnostics));
    let built = stack::with_room(|| build::build(&program)).unwrap();
    built.unwrap().image
}

/// Where a version has a variable.
fn place(image: &[u8], name: &str) -> Range {
    let name = format!("tank.{name}");
    let points = Search::run("tank", 0, &Image::parse(image).unwrap(), &name).unwrap();
    points.first().unwrap_or_else(|| panic!("no {name}")).range
}

/// Leaves the requests and steps of a test in a folder. What is looked at of a version are the values of these names.
fn requests(name: &str, images: &[Vec<u8>], watched: &[&str], order: &str) -> PathBuf {
    let folder = target("tests").join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, text: String| fs::write(folder.join(name), text).unwrap();
    let of = |request: &str, rest: &str| {
        let program = r#""partition":"plc","program":"tank""#;
        format!(r#"{{"version":2,"request":"{request}",{program}{rest}}}"#)
    };
    for (version, image) in images.iter().enumerate() {
        let parts = image.len().div_ceil(PART);
        for (part, data) in image.chunks(PART).enumerate() {
            let rest = format!(r#","part":{part},"parts":{parts},"data":"{}""#, hex(data));
            write(&format!("load-{version}-{part:02}"), of("load", &rest));
        }
        let ranges = watched.iter().map(|name| {
            let range = place(image, name);
            format!("[0,1,{},{}]", range.offset, range.bytes)
        });
        let ranges = ranges.collect::<Vec<_>>().join(",");
        let request = r#""version":2,"request":"watch","partition":"plc""#;
        write(&format!("watch-{version}"), format!(r#"{{{request},"ranges":[{ranges}]}}"#));
    }
    write("commit", of("commit", ""));
    write("roll-back", of("roll-back", ""));
    write("order", order.to_owned());
    fs::canonicalize(folder).unwrap()
}

/// The partition with the first of these images, and room for large changes.
fn plc(name: &str, image: &[u8]) -> (PathBuf, PathBuf, String) {
    let image = fs::canonicalize(save_bytes(&format!("{name}.plc"), image)).unwrap();
    let kernel = fs::canonicalize(plc_image("kernel")).unwrap();
    let table = format!(
        "memory = \"16MiB\"\nimage = {kernel:?}\n[[partition.program]]\nimage = {image:?}\n\
         name = \"tank\"\nbank = \"1MiB\"\nstate = \"2MiB\"\nsecond_state = true\nallow_force = true"
    );
    (image, kernel, table)
}

/// What was answered: the change of each look, and the numbers of 64 bits of the line of values that belongs to it.
struct Told {
    answers: Vec<Value>,
}

impl Told {
    fn read(out: &Path) -> Self {
        let text = fs::read_to_string(out.join("answers")).unwrap_or_default();
        Self { answers: text.lines().map(parse).collect() }
    }

    fn of(&self, kind: &str) -> Vec<&Value> {
        self.answers.iter().filter(|answer| answer["answer"] == *kind).collect()
    }

    fn looks(&self) -> Vec<(&Value, u64, Vec<u64>)> {
        let words = |line: &Value| {
            let digits = line["values"]["bytes"].as_str().unwrap();
            let word = |at: usize| u64::from_str_radix(&digits[at..at + 16], 16).unwrap();
            (0..digits.len() / 16).map(|number| word(16 * number).swap_bytes()).collect()
        };
        let (changes, lines) = (self.of("versions"), self.of("values"));
        assert_eq!(changes.len(), lines.len());
        let both = changes.into_iter().zip(lines);
        both.map(|(change, line)| {
            let cycle = line["values"]["cycle"].as_u64().unwrap();
            (&change["versions"][0], cycle, words(line))
        })
        .collect()
    }

    /// The first task of the program, at the end.
    fn task(&self) -> &Value {
        &self.of("status").last().unwrap()["status"]["partitions"][0]["programs"][0]["tasks"][0]
    }
}

/// A step: what is loaded, or none for the order to go back; the phase that it comes to; the version that runs then.
type Step = (Option<usize>, &'static str, usize);

fn steps() -> Vec<Step> {
    let round = [
        (Some(1), "held", 1),
        (Some(FAULTY), "rolled-back", 1),
        (Some(2), "held", 2),
        (None, "rolled-back", 1),
        (Some(2), "held", 2),
    ];
    let again = [(Some(1), "held", 1), (Some(2), "held", 2)];
    let times = if long() { 100 } else { 1 };
    round.into_iter().chain(again.into_iter().cycle().take(2 * (times - 1))).collect()
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_megabyte_gets_another_layout_and_no_cycle_is_lost() {
    let longest = if long() { "300s" } else { "20s" };
    let out = target("tests/change-large.out");
    let _ = fs::remove_dir_all(&out);
    let images: Vec<Vec<u8>> = (0..=FAULTY).map(|version| image(&source(version))).collect();
    let steps = steps();
    let lines = steps.iter().map(|(load, phase, running)| match load {
        Some(version) => {
            format!("load {version}\nsay commit\nuntil {phase}\nlook {running}\n")
        }
        None => format!("say roll-back\nuntil {phase}\nlook {running}\n"),
    });
    let watched = ["main.v_jobs", "main.v_born", "main.v_wrong", "main.v_version"];
    let folder = requests("change-large", &images, &watched, &lines.collect::<String>());
    let (first, kernel, table) = plc("change-large", &images[0]);
    let file = File::new("1ms")
        .plc_with("plc", &table)
        .compiling_linux("")
        .schedule("normal")
        .window("plc", 0, 300)
        .save("change-large");
    let host = Host::new().with("--memory", "576").with("--program", env!("CARGO_BIN_EXE_talk"));
    let linux = [target("guest/vmlinuz"), target("tests/load-initrd.img")];
    let host = [&file, &folder, &first, &kernel, &linux[0], &linux[1]]
        .into_iter()
        .fold(host, |host, path| host.with_file(path));
    let (file, folder) = (file.to_str().unwrap(), folder.to_str().unwrap());
    let arguments = [file, folder, longest, "compiling"];
    let outcome = host.given_up_after(3_000).run("change-large", &arguments);
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_default();
    assert_eq!(outcome.status, 0, "{}\n{}", outcome.output, read("answer"));
    let load: Vec<u64> = read("load").lines().map(|line| line.parse().unwrap()).collect();
    println!("compiled before and after the changes: {load:?}");
    assert!(load.len() == 2 && load[0] < load[1], "Linux did not compile: {load:?}");

    let told = Told::read(&out);
    let looks = told.looks();
    assert_eq!(looks.len(), steps.len());
    let (mut running, mut lost) = (0, 0);
    let mut ahead: Option<u64> = None;
    for (step, (change, cycle, values)) in steps.iter().zip(looks) {
        let (load, phase, now) = *step;
        assert_eq!(change["phase"], phase, "{change:#}");
        let number = |key: &str| change[key].as_u64().unwrap();
        let (took, pages, carrying) =
            (number("took_ns"), number("carried_pages"), number("carrying_ns"));
        println!("{step:?}: {took} ns, {pages} pages carried in {carrying} ns");
        assert!((1..=10_000).contains(&took), "{change:#}");
        if let Some(version) = load
            && phase == "held"
        {
            let parsed = [running, version].map(|version| Image::parse(&images[version]).unwrap());
            let planned = Change::between(&parsed[0], &parsed[1]).large.unwrap();
            let (steps, time) = (planned.records, planned.nanoseconds);
            println!("  by the model {steps} steps in {time} ns");
            // All pages once, and those again that jobs have changed meanwhile.
            assert!(pages >= 256 && carrying <= time * pages / 256, "{change:#}");
        }
        running = now;
        let [jobs, born, wrong, version] = values[..] else { panic!("{values:?}") };
        assert_eq!((wrong, version), (0, now as u64 + 1), "{step:?}");
        assert!(born < jobs);
        // One job for each cycle; a version that fails costs some.
        let before = ahead.replace(cycle - jobs).unwrap_or(cycle - jobs);
        lost += cycle - jobs - before;
        assert!(before == cycle - jobs || load == Some(FAULTY), "at cycle {cycle}");
    }
    println!("cycles lost by the version that faulted: {lost}");
    assert!(lost <= 2, "{lost}");
    for key in ["missed", "overruns"] {
        assert_eq!(told.task()[key], 0, "{:#}", told.task());
    }
    outcome.assert_kept_its_time("plc", 1_000);
    let latest = outcome.number("plc", "release_latency_ns.max");
    println!("the latest release: {latest} ns");
    assert!(latest <= 10, "{}", outcome.output);
}

/// A program whose event task waits for a variable of the state; that has a value which it never writes on a page of its own; and
/// that writes to each page of a megabyte in each of as many jobs as it is told. If it is told so, it divides by zero when so many
/// of these are left.
fn busy(version: usize) -> String {
    let fields = if version == 0 { "a : DINT; b : LINT;" } else { "b : LINT; c : LINT; a : DINT;" };
    let number = version + 1;
    format!(
        "
TYPE Pair : STRUCT {fields} END_STRUCT; END_TYPE

PROGRAM Events
VAR
    v_events : ULINT;
END_VAR
v_events := v_events + 1;
END_PROGRAM

PROGRAM Main
VAR_EXTERNAL
    go : BOOL;
END_VAR
VAR
    v_jobs, v_fast, v_faulty, v_version : ULINT;
    before : ARRAY[0..511] OF LREAL;
    v_operator : ULINT;
    pairs : ARRAY[0..1023] OF Pair;
    pages : ARRAY[0..131071] OF LREAL;
END_VAR
VAR_TEMP
    index : DINT;
END_VAR
v_version := {number};
v_jobs := v_jobs + 1;
go := v_jobs MOD 2 = 0;
IF v_fast <> 0 THEN
    v_fast := v_fast - 1;
    IF v_faulty <> 0 AND v_fast = v_faulty THEN v_jobs := v_jobs / (v_fast - v_faulty); END_IF;
    FOR index := 0 TO 255 DO
        pages[index * 512] := ULINT_TO_LREAL(v_jobs);
    END_FOR;
END_IF;
END_PROGRAM

CONFIGURATION Plant
    VAR_GLOBAL
        go : BOOL;
    END_VAR
    TASK often (INTERVAL := T#1ms, PRIORITY := 1);
    TASK edge (SINGLE := go, INTERVAL := T#1ms, PRIORITY := 0);
    PROGRAM main WITH often : Main;
    PROGRAM events WITH edge : Events;
END_CONFIGURATION
"
    )
}

/// Jobs in which it writes to all pages.
const FAST: u64 = 300;

/// Runs its first version through these steps. There are requests to write `operator`, `fast` and `faulty`.
fn run_busy(test: &str, order: &str) -> (Told, Outcome) {
    let out = target("tests").join(format!("{test}.out"));
    let _ = fs::remove_dir_all(&out);
    let images = [image(&busy(0)), image(&busy(1))];
    let names = ["main.v_jobs", "events.v_events", "main.v_operator", "main.v_version"];
    let folder = requests(test, &images, &names, order);
    for (file, image, name, value) in [
        ("operator", &images[0], "main.v_operator", 7),
        ("fast", &images[1], "main.v_fast", FAST),
        ("faulty", &images[1], "main.v_faulty", 1),
    ] {
        let Range { offset, bytes, .. } = place(image, name);
        let request = format!(
            "{{\"version\":2,\"request\":\"write\",\"partition\":\"plc\",\"point\":[0,1,{offset},{bytes},255],\
             \"value\":{value},\"name\":\"tank.{name}\",\"text\":\"{value}\"}}"
        );
        fs::write(folder.join(file), request).unwrap();
    }
    let (first, kernel, table) = plc(test, &images[0]);
    let file = File::new("1ms")
        .plc_with("plc", &table)
        .schedule("normal")
        .window("plc", 0, 300)
        .save(test);
    let host = Host::new().with("--memory", "512").with("--program", env!("CARGO_BIN_EXE_talk"));
    let needed = [&file, &folder, &first, &kernel];
    let host = needed.into_iter().fold(host, |host, path| host.with_file(path));
    let arguments = [file.to_str().unwrap(), folder.to_str().unwrap(), "20s"];
    let outcome = host.given_up_after(600).run_as(test, "change-large", &arguments);
    let answer = fs::read_to_string(out.join("answer")).unwrap_or_default();
    assert_eq!(outcome.status, 0, "{}\n{answer}", outcome.output);
    (Told::read(&out), outcome)
}

#[test]
fn a_fault_while_an_ordered_way_back_waits_leads_back_at_once() {
    let order = "load 1\nsay commit\nuntil held\nlook 1\nsay faulty\nsay fast\nsay roll-back\n\
                 until rolled-back\nlook 0\n";
    let (told, outcome) = run_busy("change-busy-fault", order);
    let looks = told.looks();
    let [(_, _, there), (back, _, again)] = &looks[..] else { panic!("{looks:?}") };
    assert_eq!(back["reason"], "a fault of the new version", "{back:#}");
    let ([.., 2], [jobs, .., 1]) = (&there[..], &again[..]) else { panic!("{looks:?}") };
    assert!(
        *jobs >= there[0] + FAST - 1,
        "it had all values of the job before the fault: {looks:?}"
    );
    assert!(!outcome.output.contains("the program stops"), "{}", outcome.output);
}

#[test]
fn what_the_kernel_writes_gets_there_and_a_state_that_changes_too_fast_waits() {
    let order = "load 1\nsay operator\nsay commit\nuntil held\nlook 1\nsay fast\nsay roll-back\n\
                 until rolled-back\nlook 0\n";
    let (told, _) = run_busy("change-busy", order);
    let looks = told.looks();
    let [(held, cycle, there), (back, later, again)] = &looks[..] else { panic!("{looks:?}") };
    for (values, version) in [(there, 2), (again, 1)] {
        let [jobs, events, operator, runs] = values[..] else { panic!("{values:?}") };
        assert_eq!((operator, runs), (7, version), "{values:?}");
        assert!(events.abs_diff(jobs / 2) <= 1, "an event task waits for the rise: {values:?}");
    }
    // The way back waited until there was time for it, and no cycle was lost.
    println!("held: {held:#}\nback: {back:#}");
    let left = back["cycle"].as_u64().unwrap();
    assert!(left >= there[0] + FAST, "left after {left} jobs, and {} before", there[0]);
    assert!(back["carried_pages"].as_u64().unwrap() > 1_000, "{back:#}");
    assert_eq!(cycle - there[0], later - again[0]);
    for change in [held, back] {
        assert!((1..=10_000).contains(&change["took_ns"].as_u64().unwrap()), "{change:#}");
    }
    for key in ["missed", "overruns", "skipped"] {
        assert_eq!(told.task()[key], 0, "{:#}", told.task());
    }
}
