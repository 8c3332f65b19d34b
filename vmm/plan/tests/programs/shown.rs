//! What `takt check` says of programs.

use takt_plan::check::{needs, report};
use takt_program::build::Variable;
use takt_program::{Area, Elementary, Flags, TaskId, Version};

use super::Case;
use super::images::{PRIVATE, builder, public, signed, task};

#[test]
fn programs_are_shown_with_tasks_points_and_writers() {
    let mut program = builder("tank");
    program.version = Version { major: 1, minor: 2, patch: 3 };
    program.task(task("log", 10_000_000, 0, 9));
    (program.input_bytes, program.output_bytes) = (8, 1);
    let (real, bool_type) =
        (program.elementary(Elementary::Real), program.elementary(Elementary::Bool));
    program.variable(Variable::new("Main.level", real, Area::Input, 4).with(Flags::INPUT));
    let valve = Variable::new("Main.valve", bool_type, Area::Output, 0);
    program.variable(Variable { bit: Some(2), writer: Some(TaskId(0)), ..valve });
    program.variable(Variable::new("Main.inner", real, Area::State, 0));
    let image = program.build().unwrap();
    let keys = format!("keys = [\"{}\"]\nname = \"signed\"", public(&PRIVATE));
    let case = Case::new("shown").file("tank.plc", &image).file("s.plc", &signed("s"));
    let case = case.program("tank.plc", "on_fault = \"restart\"").program("s.plc", &keys);
    let file = case.good();
    let text = report(&file);
    for line in [
        "tasks of plc: they may ask for ",
        "  task         released   priority  budget  deadline  worst response  verdict",
        "  tank.main    each 1ms   0         50us    1ms       57us            meets, 943us of 1ms to spare",
        "  tank.log     each 10ms  9         none    10ms      -               not analysed: it has no budget",
        "programs of plc",
        "  tank: tank 1.2.3",
        "    not signed",
        "    fault -> restart, overrun -> skip, deadline -> log",
        "    point   name        type  writer  connected to",
        "    %IB4    Main.level  REAL  -       not connected",
        "    %QX0.2  Main.valve  BOOL  main    not connected",
        "  signed: s 0.0.0",
        &format!("    signed with {}", public(&PRIVATE)),
    ] {
        assert!(text.contains(line), "no {line:?} in\n{text}");
    }
    assert!(!text.contains("Main.inner") && !text.contains("not analysed\n"), "{text}");
    let needs = needs(&file);
    let place = case.folder.canonicalize().unwrap();
    assert!(needs.contains(&format!("file {}/s.plc\n", place.display())), "{needs}");
}
