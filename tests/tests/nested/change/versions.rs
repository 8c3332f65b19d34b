//! Changes in a row between ten versions of a program with 1 MiB of state, against a model.
//!
//! Each value counts by a step of its own, which its name gives, so it tells since when it has been there: the model knows
//! from the declarations alone which values a change keeps, converts and begins anew. In each job 4 KiB of the state
//! change, and the program compares each byte of them with what it wrote 256 jobs before.

use std::collections::HashMap;
use std::fs;

use takt_points::{Point, Search};
use takt_program::Image;
use takt_st::source::Sources;
use takt_st::{build, layout, project, stack};
use takt_tests::{File, Host, Value, long, parse, plc_image, save_bytes, target};

use super::hex;

const VERSIONS: usize = 10;
/// Counts begin anew here, so that each fits into every type.
const MODULUS: u64 = 1_000;
/// Bytes of an image in a request, the most that one may have.
const PART: usize = 24_576;

/// The type of a single variable in a version, if it is there: integers and reals grow and shrink.
fn single(version: usize, number: usize) -> Option<&'static str> {
    let here = (version * 7 + number * 5) % 10 < 7;
    let width = (version + number) % 3;
    let ty = match number % 2 {
        0 => ["INT", "DINT", "LINT"][width],
        _ => ["REAL", "REAL", "LREAL"][width],
    };
    here.then_some(ty)
}

/// The capacity of the text of a version.
fn capacity(version: usize) -> usize {
    8 + 8 * (version % 3)
}

/// The bounds of an array of a version.
fn bounds(version: usize) -> (i64, i64) {
    let low = [1, 0, 1, -2][version % 4];
    (low, [3, 5, 8, 4][version * 3 % 4])
}

/// The fields of a block of a version, behind the first one.
fn fields(version: usize) -> Vec<(&'static str, &'static str)> {
    let second = ["DINT", "LINT", "INT"][version % 3];
    let all = [("second", second), ("third", "LREAL"), ("fourth", "UDINT")];
    all[..1 + version % 3].to_vec()
}

fn counted(name: &str, step: impl std::fmt::Display) -> String {
    format!(
        "{name} := {name} + {step};\nIF {name} >= {MODULUS} THEN {name} := {name} - {MODULUS}; END_IF;\n"
    )
}

/// What a value counts by.
fn step(name: &str) -> u64 {
    let last = name.rsplit(['.', '_']).next().unwrap_or_default();
    match last {
        "first" => 3,
        "second" => 5,
        "third" => 7,
        "fourth" => 11,
        _ => match last.split_once('[') {
            // The steps of an array are those of its indices.
            Some((_, index)) => {
                index.trim_end_matches(']').parse::<i64>().unwrap().unsigned_abs() + 1
            }
            None => last.parse::<u64>().unwrap() + 1,
        },
    }
}

fn source(version: usize) -> String {
    let singles = || (0..8).filter_map(|number| Some((number, single(version, number)?)));
    let mut declared: String =
        singles().map(|(number, ty)| format!("v_{number} : {ty};\n")).collect();
    let mut body: String =
        singles().map(|(number, _)| counted(&format!("v_{number}"), number + 1)).collect();
    let (low, high) = bounds(version);
    declared += &format!("v_row : ARRAY[{low}..{high}] OF DINT;\n");
    body += &format!(
        "FOR index := {low} TO {high} DO\nv_row[index] := (v_row[index] + ABS(index) + 1) MOD {MODULUS};\nEND_FOR;\n"
    );
    declared += &format!("v_note : STRING[{}];\n", capacity(version));
    body += &format!("IF v_note = '' THEN v_note := 'v{version}'; END_IF;\n");
    let mut of_block = "first : INT;\n".to_owned();
    let mut in_block = counted("first", step("first"));
    for (name, ty) in fields(version) {
        of_block += &format!("{name} : {ty};\n");
        in_block += &counted(name, step(name));
    }
    let number = version + 1;
    format!(
        "
FUNCTION_BLOCK Meter
VAR
{of_block}END_VAR
{in_block}END_FUNCTION_BLOCK

PROGRAM Main
VAR
    history : ARRAY[0..131071] OF LREAL;
    v_jobs, v_born, v_wrong : ULINT;
    v_version : UINT;
    v_meters : ARRAY[1..2] OF Meter;
{declared}
END_VAR
VAR_TEMP
    index, start : DINT;
    before, now : LREAL;
END_VAR
IF v_version <> {number} THEN
    v_version := {number};
    v_born := v_jobs;
END_IF;
v_jobs := v_jobs + 1;
start := ULINT_TO_DINT(v_jobs MOD 256) * 512;
now := ULINT_TO_LREAL(v_jobs);
IF v_jobs > 256 THEN before := now - 256.0; END_IF;
FOR index := 0 TO 511 DO
    IF history[start + index] <> before THEN v_wrong := v_wrong + 1; END_IF;
    history[start + index] := now;
END_FOR;
{body}
v_meters[1]();
v_meters[2]();
END_PROGRAM

CONFIGURATION Plant
    TASK often (INTERVAL := T#1ms, PRIORITY := 1);
    PROGRAM main WITH often : Main;
END_CONFIGURATION
"
    )
}

/// The images of all versions, each laid out after the one before.
fn images() -> Vec<Vec<u8>> {
    let mut images: Vec<Vec<u8>> = Vec::new();
    for version in 0..VERSIONS {
        let mut sources = Sources::new();
        sources.add("main.st", source(version).as_bytes()).unwrap();
        let checked = project::check("tank", &mut sources).unwrap();
        let mut program = checked.program.unwrap_or_else(|| panic!("{:#?}", checked.diagnostics));
        if let Some(old) = images.last() {
            layout::keep(&mut program, &Image::parse(old).unwrap());
        }
        let built = stack::with_room(|| build::build(&program)).unwrap();
        images.push(built.unwrap().image);
    }
    images
}

/// The order of the versions: pseudo-random, never twice the same.
fn order(times: usize) -> Vec<usize> {
    let mut state = 1u64;
    let mut last = 0;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        last = (last + 1 + (state >> 33) as usize % (VERSIONS - 1)) % VERSIONS;
        last
    };
    (0..times).map(|_| next()).collect()
}

/// What the model knows of a value.
#[derive(Clone, Debug)]
struct Known {
    ty: String,
    /// How many jobs there were before its first one.
    born: u64,
    /// Of a text: the version that wrote it.
    text: usize,
}

/// Whether each value of the first type is one of the second.
fn fits(old: &str, new: &str) -> bool {
    let families = [["INT", "DINT", "LINT"], ["REAL", "LREAL", ""]];
    let place = |family: &[&str; 3], ty| family.iter().position(|other| *other == ty);
    old == new
        || families.iter().any(|family| {
            place(family, old).zip(place(family, new)).is_some_and(|(old, new)| old < new)
        })
}

/// The values of a line by their names.
fn values(points: &[Point], from: u32, line: &Value) -> HashMap<String, String> {
    let digits = line["values"]["bytes"].as_str().unwrap();
    let bytes: Vec<u8> = (0..digits.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&digits[at..at + 2], 16).unwrap())
        .collect();
    let show = |point: &Point| {
        let at = (point.range.offset - from) as usize;
        let text = point.show(&bytes[at..at + usize::from(point.range.bytes)]);
        (point.name.trim_start_matches("tank.main.v_").to_owned(), text)
    };
    points.iter().map(show).collect()
}

/// The model of what the program has.
#[derive(Default)]
struct Model {
    known: HashMap<String, Known>,
}

impl Model {
    /// Goes on to this version, whose first job had `born` before it.
    fn change(&mut self, version: usize, points: &[Point], born: u64) {
        let old = std::mem::take(&mut self.known);
        for point in points {
            let name = point.name.trim_start_matches("tank.main.v_").to_owned();
            let text = format!("STRING {}", capacity(version));
            let ty = if name == "note" { text } else { point.type_name.clone() };
            let kept = old.get(&name).filter(|old| match name == "note" {
                true => old.ty.len() < ty.len() || old.ty.len() == ty.len() && old.ty <= ty,
                false => fits(&old.ty, &ty),
            });
            let anew = Known { ty: ty.clone(), born, text: version };
            let now = kept.map_or(anew, |kept| Known { ty, ..kept.clone() });
            self.known.insert(name, now);
        }
    }

    /// What it is after this many jobs, as it is shown.
    fn value(&self, name: &str, jobs: u64) -> u64 {
        let known = &self.known[name];
        (jobs - known.born) * step(name) % MODULUS
    }

    /// Compares all values of a line.
    fn compare(&self, line: &HashMap<String, String>, jobs: u64) {
        for (name, shown) in line {
            match name.as_str() {
                "jobs" | "born" | "version" => {}
                "wrong" => assert_eq!(shown, "0"),
                "note" => assert_eq!(*shown, format!("'v{}'", self.known[name].text)),
                _ => {
                    let shown: f64 = shown.parse().unwrap();
                    assert_eq!(
                        shown,
                        self.value(name, jobs) as f64,
                        "{name}: {:?}",
                        self.known[name]
                    );
                }
            }
        }
    }
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn ten_versions_follow_each_other_and_each_value_is_that_of_the_model() {
    let (times, longest) = if long() { (1_000, "1000s") } else { (12, "20s") };
    let (folder, out) = (target("tests/change-versions"), target("tests/change-versions.out"));
    for folder in [&folder, &out] {
        let _ = fs::remove_dir_all(folder);
        fs::create_dir_all(folder).unwrap();
    }
    let write = |name: &str, text: String| fs::write(folder.join(name), text).unwrap();
    let images = images();
    let mut tables = Vec::new();
    for (version, image) in images.iter().enumerate() {
        let parts = image.len().div_ceil(PART);
        for (part, data) in image.chunks(PART).enumerate() {
            let request = format!(
                r#"{{"version":2,"request":"load","partition":"plc","program":"tank","part":{part},"parts":{parts},"data":"{}"}}"#,
                hex(data)
            );
            write(&format!("load-{version}-{part:02}"), request);
        }
        let points =
            Search::run("tank", 0, &Image::parse(image).unwrap(), "tank.main.v_*").unwrap();
        let from = points.iter().map(|point| point.range.offset).min().unwrap();
        let ends = points.iter().map(|point| point.range.offset + u32::from(point.range.bytes));
        let bytes = ends.max().unwrap() - from;
        write(
            &format!("watch-{version}"),
            format!(
                r#"{{"version":2,"request":"watch","partition":"plc","ranges":[[0,1,{from},{bytes}]]}}"#
            ),
        );
        tables.push((points, from));
    }
    let order = order(times);
    write("order", order.iter().map(|version| format!("{version}\n")).collect());
    write(
        "commit",
        r#"{"version":2,"request":"commit","partition":"plc","program":"tank"}"#.to_owned(),
    );
    let folder = fs::canonicalize(folder).unwrap();
    let image = fs::canonicalize(save_bytes("change-versions.plc", &images[0])).unwrap();
    let kernel = fs::canonicalize(plc_image("kernel")).unwrap();
    let table = format!(
        "memory = \"32MiB\"\nimage = {kernel:?}\nrelease_guard = \"10us\"\n[[partition.program]]\nimage = {image:?}\n\
         name = \"tank\"\nstate = \"2MiB\"\nwatch = \"16KiB\""
    );
    let file = File::new("1ms")
        .plc_with("plc", &table)
        .schedule("normal")
        .window("plc", 0, 300)
        .save("change-versions");
    let host = Host::new().with("--memory", "512").with("--program", env!("CARGO_BIN_EXE_talk"));
    let host =
        [&file, &folder, &image, &kernel].into_iter().fold(host, |host, path| host.with_file(path));
    let arguments = [file.to_str().unwrap(), folder.to_str().unwrap(), longest];
    let outcome = host.given_up_after(6_000).run("change-versions", &arguments);
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_default();
    assert_eq!(outcome.status, 0, "{}\n{}", outcome.output, read("takt"));

    let answers: Vec<Value> = read("answers").lines().map(parse).collect();
    let of = |kind: &str| -> Vec<&Value> {
        answers.iter().filter(|answer| answer["answer"] == *kind).collect()
    };
    assert!(of("error").is_empty(), "{:#?}", of("error"));
    let changes: Vec<&Value> = of("versions").iter().map(|answer| &answer["versions"][0]).collect();
    let lines = of("values");
    assert_eq!((changes.len(), lines.len()), (times, times));
    let mut model = Model::default();
    model.change(0, &tables[0].0, 0);
    let (mut before, mut ahead) = (0, None);
    let mut took = Vec::new();
    for ((version, change), line) in order.iter().zip(&changes).zip(&lines) {
        assert_eq!((&change["phase"], &change["reason"]), (&"held".into(), &Value::Null));
        took.push(change["took_ns"].as_u64().unwrap());
        let (points, from) = &tables[*version];
        let shown = values(points, *from, line);
        let number = |name: &str| shown[name].parse::<u64>().unwrap();
        let (jobs, born) = (number("jobs"), number("born"));
        assert_eq!(number("version"), *version as u64 + 1);
        assert!(before < born && born < jobs, "{before} {born} {jobs}");
        model.change(*version, points, born);
        model.compare(&shown, jobs);
        // One job for each cycle, through all changes.
        let cycle = line["values"]["cycle"].as_u64().unwrap();
        assert_eq!(*ahead.get_or_insert(cycle - jobs), cycle - jobs, "at cycle {cycle}");
        before = jobs;
    }
    println!(
        "{times} changes, {before} jobs; took {:?} to {:?} ns",
        took.iter().min(),
        took.iter().max()
    );
    assert!(took.iter().all(|took| (1..=10_000).contains(took)), "{took:?}");
    let status = &of("status").last().unwrap()["status"]["partitions"][0]["programs"][0];
    for key in ["missed", "overruns", "skipped"] {
        assert_eq!(status["tasks"][0][key], 0, "{status:#}");
    }
    let report = parse(&read("report.json"));
    let plc = &report["partitions"][0];
    for key in ["lost", "late_releases", "unrecorded"] {
        assert_eq!(plc[key], 0, "{key}: {plc:#}");
    }
    let latest = plc["release_latency_ns"]["max"].as_u64().unwrap();
    println!("the latest release: {latest} ns");
    assert!(latest <= 10, "{plc:#}");
}
