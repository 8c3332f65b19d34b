//! What several tasks use stays in memory.

use super::*;
use crate::{project, source::Sources};

/// The areas of what may live in registers during the loops of the program `Slow`, beside another task.
fn promoted(fast: &str) -> Vec<Area> {
    let text = format!(
        "VAR_GLOBAL marker AT %MW4 : INT; output AT %QW2 : INT; input AT %IW0 : INT; sum : INT; r : REF_TO INT; END_VAR\n\
         PROGRAM Slow VAR i : INT; END_VAR\n\
         FOR i := 1 TO 9 DO sum := sum + marker + input; output := output + 1; END_FOR;\n\
         END_PROGRAM\n\
         PROGRAM Fast {fast} END_PROGRAM\n\
         CONFIGURATION c\n\
         TASK often (INTERVAL := T#1ms, PRIORITY := 1); TASK seldom (INTERVAL := T#9ms, PRIORITY := 2);\n\
         PROGRAM fast WITH often : Fast; PROGRAM slow WITH seldom : Slow;\n\
         END_CONFIGURATION"
    );
    let mut sources = Sources::new();
    sources.add("main.st", text.as_bytes()).unwrap();
    let program = project::check("test", &mut sources).unwrap().program.unwrap();
    let knowledge = Knowledge::of(&program);
    let routine = program.routines.iter().find(|routine| routine.name == "Slow").unwrap();
    let mut collector = Collector::new(&program, routine, &knowledge.summaries);
    collector.block(&routine.body);
    let cells = knowledge.promotable(routine, &collector.effects);
    let mut areas: Vec<Area> = cells
        .iter()
        .filter_map(|(cell, _)| match cell.base {
            Base::Area(area) => Some(area),
            _ => None,
        })
        .collect();
    areas.sort_unstable();
    areas
}

#[test]
fn what_another_task_assigns_by_its_name_is_in_no_register() {
    assert_eq!(promoted(";"), [Area::State, Area::Input, Area::Output, Area::Marker]);
    assert_eq!(promoted("marker := 1;"), [Area::State, Area::Input, Area::Output]);
}

#[test]
fn what_another_task_may_assign_through_a_reference_is_in_no_register() {
    assert_eq!(promoted("r := REF(marker); r^ := 1;"), []);
}

/// The machine code of the program's only task, compiled with the given tests.
fn code(tests: &str) -> String {
    let text = "VAR_GLOBAL sum, n : INT; END_VAR\n\
        PROGRAM Main VAR i : INT; END_VAR FOR i := 1 TO n DO sum := sum + i; END_FOR; END_PROGRAM\n\
        CONFIGURATION c TASK t (INTERVAL := T#1ms, PRIORITY := 1); PROGRAM p WITH t : Main; END_CONFIGURATION";
    let mut sources = Sources::new();
    sources.add("main.st", text.as_bytes()).unwrap();
    sources.add("tests.st", tests.as_bytes()).unwrap();
    let program = project::check_tests("test", &mut sources).unwrap().program.unwrap();
    let all = crate::native::assembly(&program);
    let (_, from) = all.split_once("; Main\n").unwrap();
    from.split("\n; ").next().unwrap().to_owned()
}

#[test]
fn a_test_runs_the_code_of_the_image() {
    let test = "TEST 'the sum' n := 3; sum := 0; RUN(T#1ms); ASSERT(sum = 6); END_TEST";
    assert_eq!(code(test), code(""));
}
