//! What `takt check` says of programs.

use takt_plan::check::{needs, report};
use takt_program::build::{Builder, Object, Task, Variable, When};
use takt_program::{Area, CodeOffset, Elementary, Flags, Nanoseconds, ObjectKind, TaskId, Version};

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
    let settings = "on_fault = \"restart\"\nwatch = \"6KiB\"\nretain = \"values/tank\"";
    let case = case.program("tank.plc", settings);
    let case = case.program("s.plc", &format!("{keys}\nallow_force = true"));
    let file = case.good();
    let text = report(&file);
    for line in [
        "tasks of plc: they may ask for ",
        "  task         released   priority  budget  deadline  worst response  verdict",
        "  tank.main    each 1ms   0         50us    1ms       63us            meets, 937us of 1ms to spare",
        "  tank.log     each 10ms  9         none    10ms      -               not analysed: it has no budget",
        "  warning: a job that never ends is told of and goes on, with its outputs as they are: tank.log\n",
        "programs of plc",
        "  tank: tank 1.2.3",
        "    not signed",
        "    fault -> restart, overrun -> skip, deadline -> log",
        "    from outside: 6KiB in a cycle, read only",
        "    from outside: 1KiB in a cycle, may be written and forced",
        "\n  from outside: 7KiB in a cycle, in at most 8 steps of 20000 TSC ticks that no task needs",
        "    point   name        type  writer  connected to",
        "    %IB4    Main.level  REAL  -       not connected",
        "    %QX0.2  Main.valve  BOOL  main    not connected",
        "    warning: inputs that no [[partition.io]] connects, and that read as 0: Main.level",
        "    warning: outputs that no [[partition.io]] connects to anything: Main.valve",
        "  signed: s 0.0.0",
        &format!("    signed with {}", public(&PRIVATE)),
    ] {
        assert!(text.contains(line), "no {line:?} in\n{text}");
    }
    assert!(!text.contains("Main.inner") && !text.contains("not analysed\n"), "{text}");
    let needs = needs(&file);
    let place = case.folder.canonicalize().unwrap();
    assert!(needs.contains(&format!("file {}/s.plc\n", place.display())), "{needs}");
    assert!(needs.contains(&format!("\nfolder {}/values\n", place.display())), "{needs}");
}

/// A program with these inputs or outputs of one byte each.
fn bytes(name: &str, area: Area, points: &[&str]) -> Vec<u8> {
    let mut program = builder(name);
    (program.input_bytes, program.output_bytes) = (64, 64);
    let byte = program.elementary(Elementary::Byte);
    for (at, point) in points.iter().enumerate() {
        program.variable(Variable::new(point, byte, area, at as u32));
    }
    program.build().unwrap()
}

#[test]
fn a_point_without_a_connection_and_a_connection_without_a_point_are_warned_of() {
    let source = bytes("source", Area::Output, &["read", "lost"]);
    let sink =
        bytes("sink", Area::Input, &["i0", "i1", "i2", "i3", "i4", "i5", "i6", "i7", "i8", "i9"]);
    let from = |at: &str| {
        format!(
            "[[partition.io]]\nprogram = \"sink\"\nat = \"{at}\"\n\
             output = \"read\"\noutput_of = \"source\""
        )
    };
    let case = Case::new("unconnected").file("source.plc", &source).file("sink.plc", &sink);
    let case = case.program("source.plc", "").program("sink.plc", "");
    let text = report(&case.with(&from("%IB0")).with(&from("%IB20")).good());
    for line in [
        "  input %IB0 of sink; input %IB20 of sink\n",
        "    warning: outputs that no [[partition.io]] connects to anything: lost\n",
        "that read as 0: i1, i2, i3, i4, i5, i6, i7, i8 and 1 more\n",
        "at which the program declares no point: %IB20\n",
    ] {
        assert!(text.contains(line), "no {line:?} in\n{text}");
    }
    assert_eq!(text.matches("warning: ").count(), 3, "{text}");

    let whole = bytes("sink", Area::Input, &["i0"]);
    let source = bytes("source", Area::Output, &["read"]);
    let case = Case::new("connected").file("source.plc", &source).file("sink.plc", &whole);
    let case = case.program("source.plc", "").program("sink.plc", "").with(&from("%IB0"));
    let text = report(&case.good());
    assert!(!text.contains("warning: ") && !text.contains("not connected"), "{text}");
}

#[test]
fn tasks_that_wait_for_holders_of_semaphores_are_told() {
    let program = |name: &str, ceilings: &[u8], tasks: &[(&str, u8)]| {
        let mut builder = Builder::new(name);
        builder.code = vec![0xc3];
        for ceiling in ceilings {
            let kind = ObjectKind::Semaphore { ceiling: *ceiling };
            builder.object(Object { name: format!("s{ceiling}"), kind });
        }
        for (name, priority) in tasks {
            builder.task(task(name, 1_000_000, 1_000, *priority));
        }
        builder.build().unwrap()
    };
    let text = |b: &[u8]| {
        let a = program("a", &[], &[("fast", 1), ("slow", 5)]);
        let case = Case::new("holders").file("a.plc", &a).file("b.plc", b);
        report(&case.program("a.plc", "").program("b.plc", "").good())
    };
    let warning = "their times do not allow for it: ";
    // `b.low` may hold it, and runs before `a.slow` and `b.high` then. The ceiling counts as 3.
    let told = text(&program("b", &[0], &[("high", 3), ("low", 9)]));
    assert!(told.contains(&format!("{warning}b.high, a.slow\n")), "{told}");
    let told = text(&program("b", &[9, 1], &[("high", 1), ("low", 9)]));
    assert!(told.contains(&format!("{warning}a.fast, b.high, a.slow\n")), "{told}");
    // No task is less urgent than `b.low`, and only it takes this one.
    let told = text(&program("b", &[9], &[("high", 3), ("low", 9)]));
    assert!(!told.contains(warning), "{told}");
    let told = text(&program("b", &[], &[("high", 3), ("low", 9)]));
    assert!(!told.contains(warning), "{told}");
    // A freewheeling task without a budget is given no semaphore.
    for (budget, waiting) in [(None, false), (Some(Nanoseconds(1_000)), true)] {
        let mut builder = Builder::new("b");
        builder.code = vec![0xc3];
        builder.object(Object { name: "s".into(), kind: ObjectKind::Semaphore { ceiling: 3 } });
        builder.task(task("high", 1_000_000, 1_000, 3));
        builder.task(Task { budget, ..Task::new("idle", When::Freewheeling, CodeOffset(0)) });
        let told = text(&builder.build().unwrap());
        assert_eq!(told.contains(&format!("{warning}b.high, a.slow\n")), waiting, "{told}");
        assert_eq!(told.contains(warning), waiting, "{told}");
    }
}
