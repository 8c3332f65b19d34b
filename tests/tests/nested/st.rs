//! Structured Text in a PLC of the lab, from the source to the report.

mod speed;

use std::path::Path;

use takt_st::source::Sources;
use takt_st::{build, project, stack};
use takt_tests::{File, long, plc_image, root, save_bytes};

use super::tasks::{Row, assert_on_time, assert_on_time_in};

/// The image of one file, in Structured Text.
pub(super) fn image(name: &str, file: &str, text: &str) -> Vec<u8> {
    let mut sources = Sources::new();
    sources.add(file, text.as_bytes()).expect("it is a source");
    let checked = project::check(name, &mut sources).expect("there is room for a thread");
    let program = checked.program.unwrap_or_else(|| panic!("{:?}", checked.diagnostics));
    let built = stack::with_room(|| build::build(&program)).expect("there is room for a thread");
    built.expect("the program has an image").image
}

/// The lines of a PLC with the kernel and these programs.
fn programs(test: &str, programs: &[(&str, &str, &str)]) -> String {
    let images = programs.iter().map(|(name, file, text)| {
        (*name, save_bytes(&format!("{test}-{name}.plc"), &image(name, file, text)))
    });
    let images: Vec<_> = images.collect();
    programs_of(images.iter().map(|(name, image)| (*name, image.as_path())))
}

/// The same of programs whose images are in files.
fn programs_of<'a>(images: impl Iterator<Item = (&'a str, &'a Path)>) -> String {
    let tables = images.map(|(name, image)| {
        format!("[[partition.program]]\nimage = {image:?}\nname = {name:?}\n")
    });
    let tables: String = tables.collect();
    format!("image = {:?}\nmemory = \"32MiB\"\n{tables}", plc_image("kernel"))
}

/// A PLC with these programs in windows of 300 us each ms.
fn plc(test: &str, list: &[(&str, &str, &str)]) -> File {
    let lines = programs(test, list);
    File::new("1ms").plc_with("plc", &lines).schedule("normal").window("plc", 0, 300)
}

const PLANT: (&str, &str, &str) = ("plant", "plant.st", include_str!("st/plant.st"));

/// A program in Rust of the same tasks has a PLC of its own in the same run, so what differs is the language.
#[ignore = "takes long: scripts/test --all"]
#[test]
fn a_plant_of_three_tasks_has_the_releases_of_a_program_in_rust_beside_a_compiling_linux() {
    let (duration, jobs) = if long() { ("60s", 59_000) } else { ("4s", 3_000) };
    let rust = root().join("target/examples/press.plc");
    let rust = format!("memory = \"32MiB\"\n[[partition.program]]\nimage = {rust:?}\n");
    let outcome = plc("st-plant", &[PLANT])
        .window("rust", 500, 300)
        .plc_with("rust", &rust)
        .compiling_linux("")
        .run("st-plant")
        .lasting(duration)
        .run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_compiled();
    for program in ["plant", "press"] {
        for (task, jobs) in [("fast", jobs), ("middle", jobs / 10), ("slow", jobs / 100)] {
            Row::of(&outcome, &format!("{program}.{task}")).assert_in_time(jobs - 1);
        }
        let slow = Row::of(&outcome, &format!("{program}.slow"));
        assert!(slow.number("response") > 1_000_000, "it spans windows");
    }
    assert_on_time(&outcome, "plant.fast");
    assert_on_time_in(&outcome, "rust", "press.fast");
    for key in
        ["lost", "late_releases", "overruns", "release_latency_ns.min", "release_latency_ns.p50"]
    {
        let [st, rust] = ["plc", "rust"].map(|partition| outcome.number(partition, key));
        assert_eq!(st, rust, "{key}\n{}", outcome.output);
    }
    // They need not begin in the same frame.
    let [st, rust] = ["plc", "rust"].map(|partition| outcome.number(partition, "releases"));
    assert!(st.abs_diff(rust) < 10, "{st} and {rust} releases\n{}", outcome.output);
    // The programs have checked their controllers by themselves, and that in ST its timers and counters.
    outcome.assert_shows("plant.fast: position settled");
    outcome.assert_shows("press.fast: position settled");
    outcome.assert_shows("20 pulses in time");
    assert!(!outcome.output.contains("wrong"), "{}", outcome.output);
    assert!(!outcome.output.contains("stops"), "{}", outcome.output);
}

#[test]
fn a_trap_is_told_with_file_and_line_and_the_other_programs_go_on() {
    let faulty = ("faulty", "main.st", include_str!("st/faulty.st"));
    let outcome = plc("st-trap", &[PLANT, faulty]).run("st-trap").lasting("2500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("program faulty, task often: main.st:14: division by zero (column ");
    let stopped = outcome.output.lines().filter(|line| line.contains("the program stops")).count();
    assert_eq!(stopped, 1, "{}", outcome.output);
    Row::of(&outcome, "plant.fast").assert_in_time(1_500);
    assert_on_time(&outcome, "plant.fast");
    outcome.assert_shows("20 pulses in time");
}

/// Orders go through a queue and release a task; their number is in a sampling channel too.
#[test]
fn two_plcs_talk_through_channels_and_a_message_releases_a_task() {
    let left = programs("st-left", &[("orders", "orders.st", include_str!("st/orders.st"))]);
    let right = programs("st-right", &[("answers", "answers.st", include_str!("st/answers.st"))]);
    let channel = |name: &str, kind: &str, bytes: u32, ends: [&str; 2], more: &str| {
        let [from, to] = ends;
        format!(
            "[[channel]]\nname = {name:?}\nkind = {kind:?}\nmessage_bytes = {bytes}\n\
             source = {from:?}\ndestinations = [{to:?}]\n{more}\n"
        )
    };
    let file = File::new("1ms")
        .plc_with("left", &left)
        .plc_with("right", &right)
        .lines(&channel("order", "queuing", 16, ["left:orders", "right:orders"], "depth = 4"))
        .lines(&channel("answer", "queuing", 4, ["right:answers", "left:answers"], "depth = 4"))
        .lines(&channel(
            "number",
            "sampling",
            4,
            ["left:number", "right:number"],
            "refresh_period = \"20ms\"",
        ))
        .schedule("normal")
        .window("left", 0, 200)
        .window("right", 400, 200);
    let outcome = file.run("st-channels").lasting("1500ms").run();
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    outcome.assert_shows("the answers are right");
    outcome.assert_shows("the orders are right");
    for wrong in ["wrong", "refused", "released without", "stops"] {
        assert!(!outcome.output.contains(&format!(": {wrong}")), "{}", outcome.output);
    }
    Row::of(&outcome, "answers.on_order").assert_in_time(100);
    outcome.assert_punctual("left");
}
