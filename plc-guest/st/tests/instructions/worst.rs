//! The bound on the instructions of a job: never below what a job takes, and not far above where there is one path only.

use takt_st::hir::Program;
use takt_st::native::{self, Cost, Worst};

use crate::{count, generate, machine, of_speed, program};

fn bound(program: &Program) -> Worst {
    let worst = native::worst(program).unwrap();
    assert_eq!(worst.len(), program.tasks.len());
    worst[0].clone()
}

fn cost(program: &Program) -> Cost {
    match bound(program) {
        Worst::Bounded(cost) => cost,
        Worst::Unbounded(loops) => panic!("not bounded: {loops:?}"),
    }
}

/// The lines of the loops without a bound.
fn lines(source: &str) -> Vec<u32> {
    match bound(&program(source)) {
        Worst::Bounded(cost) => panic!("bounded by {cost:?}"),
        Worst::Unbounded(loops) => loops.iter().map(|at| at.line).collect(),
    }
}

fn taken(program: &Program) -> u64 {
    let compiled = native::compile(program).unwrap();
    let mut machine = machine::Machine::load(&compiled);
    machine.start();
    let counted = count::job(&mut machine, &compiled, program.tasks[0].entry.0 as usize, 0);
    counted.ended.unwrap();
    counted.own
}

const TASK: &str = "CONFIGURATION c TASK t (INTERVAL := T#1s, PRIORITY := 1);
PROGRAM p WITH t : Main; END_CONFIGURATION";

#[test]
fn what_has_one_path_is_counted_to_the_instruction_but_for_jumps() {
    for kernel in ["filter", "matrix"] {
        let program = program(&of_speed(&format!("{kernel}.st")));
        let (taken, bound) = (taken(&program), cost(&program).instructions);
        assert!(bound >= taken && bound - taken < taken / 100, "{kernel}: {taken}, bound {bound}");
    }
}

#[test]
fn what_has_several_paths_is_bounded_by_the_longest() {
    for kernel in ["pid", "crc", "state-machine"] {
        let program = program(&of_speed(&format!("{kernel}.st")));
        let (taken, bound) = (taken(&program), cost(&program).instructions);
        assert!(bound >= taken && bound < 2 * taken, "{kernel}: {taken}, bound {bound}");
    }
}

#[test]
fn calls_of_the_runtime_are_counted_apart() {
    let cost = cost(&program(&of_speed("text.st")));
    // A copy for the empty string; then 12 times the length of two, two copies for CONCAT, and one for the assignment.
    assert_eq!(cost.runtime_calls, 1 + 12 * 5);
}

#[test]
fn a_loop_without_a_bound_is_named_wherever_it_is() {
    let found = lines(&format!(
        "FUNCTION search : INT
VAR_INPUT last : DINT; END_VAR
VAR i : DINT; END_VAR
FOR i := 1 TO last DO
  search := search + 1;
END_FOR;
END_FUNCTION
PROGRAM Main
VAR n : INT; i : DINT; END_VAR
FOR i := 1 TO 10 DO
  n := search(i);
  WHILE n > 0 DO n := n - 1; END_WHILE;
END_FOR;
REPEAT
  n := n + 2;
  UNTIL n > 100
END_REPEAT;
END_PROGRAM
{TASK}"
    ));
    assert_eq!(found, [4, 12, 14]);
}

#[test]
fn the_type_of_an_end_value_bounds_a_loop() {
    let source = |last| {
        format!(
            "PROGRAM Main
VAR i, sum : DINT; last AT {last}; END_VAR
FOR i := 1 TO last DO sum := sum + i; END_FOR;
END_PROGRAM
{TASK}"
        )
    };
    let cost = cost(&program(&source("%IB0 : USINT")));
    assert!(cost.instructions > 255 * 3 && cost.instructions < 255 * 8, "{cost:?}");
    assert_eq!(lines(&source("%ID0 : DINT")), [3]);
}

/// What a job of a program takes that has these variables and statements.
fn of_statements(variables: &str, statements: &str) -> Worst {
    let source =
        format!("PROGRAM Main\nVAR\n{variables}\nEND_VAR\n{statements}\nEND_PROGRAM\n{TASK}");
    bound(&program(&source))
}

#[test]
fn the_loops_of_the_library_have_bounds() {
    for (ty, value) in [
        ("BYTE", "16#12"),
        ("LWORD", "16#12"),
        ("LINT", "-5"),
        ("ULINT", "5"),
        ("LREAL", "0.1"),
        ("TIME", "T#1h2ms"),
        ("TOD", "TOD#12:34:56.789"),
        ("DATE", "D#2026-11-22"),
        ("DT", "DT#2026-11-22-12:34:56"),
    ] {
        let variables = format!("v : {ty} := {value}; text : STRING;");
        for statement in
            [format!("text := {ty}_TO_STRING(v);"), format!("v := STRING_TO_{ty}(text);")]
        {
            let Worst::Bounded(cost) = of_statements(&variables, &statement) else {
                panic!("{statement} {:?}", of_statements(&variables, &statement))
            };
            assert!(
                cost.instructions < 500_000 && cost.runtime_calls < 25_000,
                "{statement} {cost:?}"
            );
        }
    }
    for statement in [
        "b := UINT_TO_BCD_WORD(WORD_BCD_TO_UINT(b));",
        "s(IN := 1.0, SIZE := 20);",
        "x := IS_VALID_BCD(b);",
    ] {
        let worst = of_statements("b : WORD; s : STATISTICS; x : BOOL;", statement);
        assert!(
            matches!(worst, Worst::Bounded(cost) if cost.instructions < 50_000),
            "{statement} {worst:?}"
        );
    }
}

#[test]
fn the_length_of_a_text_and_a_limit_bound_a_loop() {
    for end in ["LEN(text)", "LIMIT(0, n, 10)", "MIN(n, 10)", "MAX(MIN(n, 9), 10)"] {
        let worst = of_statements(
            "n, i, sum : LINT; text : STRING[10];",
            &format!("FOR i := 1 TO {end} DO sum := sum + i; END_FOR;"),
        );
        assert!(
            matches!(worst, Worst::Bounded(cost) if cost.instructions < 250),
            "{end} {worst:?}"
        );
    }
    let worst =
        of_statements("n, i, sum : LINT;", "FOR i := 1 TO MAX(n, 10) DO sum := sum + i; END_FOR;");
    assert!(matches!(worst, Worst::Unbounded(_)), "{worst:?}");
}

#[test]
fn no_random_program_takes_more_than_its_bound() {
    let (mut compared, mut seed) = (0, 0);
    while compared < 15 {
        let program = generate::generate(seed);
        seed += 1;
        assert!(seed < 1000, "few random programs have a bound");
        let Worst::Bounded(cost) = bound(&program) else { continue };
        let compiled = native::compile(&program).unwrap();
        let mut machine = machine::Machine::load(&compiled);
        machine.start();
        let counted = count::job(&mut machine, &compiled, program.tasks[0].entry.0 as usize, 0);
        // A trap is one instruction more.
        let most = cost.instructions + u64::from(counted.ended.is_err());
        assert!(counted.own <= most, "seed {}: {} of {cost:?}", seed - 1, counted.own);
        compared += 1;
    }
}
