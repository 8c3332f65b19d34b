//! The example programs: formatted, built, and tested by their tables. Needs gcc and make.

mod common;

use std::path::PathBuf;

use common::Folder;

/// Builds an example and runs its table.
fn example(name: &str, options: &[&str]) {
    let source = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../examples").join(name);
    let [main, table] = ["main.st", "table.csv"].map(|file| source.join(file));
    let [main, table, source] = [&main, &table, &source].map(|path| path.to_str().unwrap());
    let folder = Folder::new();
    folder.takt_plc(&["fmt", "--check", main]).expect(0, "");
    folder.takt_plc(&["build", source, "-o", "example.plc"]).expect(0, name);
    let words = [&["test", "example.plc", table], options].concat();
    folder.takt_plc(&words).expect(0, "all as expected");
}

#[test]
fn the_level_of_a_tank_is_controlled() {
    example("tank", &[]);
    example("plant", &[]);
}

#[test]
fn a_drive_keeps_a_motor_at_its_speed_and_notices_that_it_is_silent() {
    example("drive", &[]);
    example("motor", &[]);
}

#[test]
fn a_traffic_light_has_its_phases() {
    example("traffic", &["--step", "1000000"]);
}

#[test]
fn a_conveyor_counts_by_an_event() {
    example("conveyor", &[]);
}

#[test]
fn batches_are_dosed_by_a_program_in_c() {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/dosing");
    Folder::new().run("make", &["-C", source, "test"]).expect(0, "all as expected");
}

#[test]
fn a_press_is_controlled_by_a_program_in_rust() {
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/press");
    Folder::new().run("make", &["-C", source, "test"]).expect(0, "all as expected");
}
