//! What `takt plc write` and `force` refuse before they ask a PLC that runs.

mod common;

use std::fs;

use common::Folder;
use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Flags, Nanoseconds};

/// A folder with a partition file and a program of which one value is forceable, one is not and one is a constant.
fn plant() -> Folder {
    let mut image = Builder::new("tank");
    image.code = vec![0xc3];
    image.state_bytes = 12;
    let real = image.elementary(Elementary::Real);
    let values =
        [("setpoint", Flags::FORCEABLE), ("integral", Flags::NONE), ("limit", Flags::CONSTANT)];
    for (offset, (name, flags)) in (0..).step_by(4).zip(values) {
        image.variable(Variable::new(name, real, Area::State, offset).with(flags));
    }
    let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
    task.budget = Some(Nanoseconds(10_000));
    image.task(task);
    let folder = Folder::new();
    fs::write(folder.path().join("tank.plc"), image.build().unwrap()).unwrap();
    let text = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\ncontrol = \"s\"\n\
        [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
        [[partition.program]]\nimage = \"tank.plc\"\nallow_force = true\n[[schedule]]\nname = \"normal\"\n\
        [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n";
    folder.write("plant.toml", text);
    folder
}

#[test]
fn what_is_not_declared_as_forceable_is_not_forced_and_a_constant_is_not_written() {
    let folder = plant();
    let forced = |name: &str| folder.takt_plc(&["force", "plant.toml", name, "1.5"]);
    forced("tank.integral")
        .expect(2, "tank.integral: the program does not declare it as forceable");
    forced("tank.limit").expect(2, "tank.limit: the program does not declare it as forceable");
    let written = |name: &str| folder.takt_plc(&["write", "plant.toml", name, "1.5"]);
    written("tank.limit").expect(2, "tank.limit: it is a constant of the program");
    // These get as far as to a Takt that does not run.
    forced("tank.setpoint").expect(6, "");
    written("tank.integral").expect(6, "");
}
