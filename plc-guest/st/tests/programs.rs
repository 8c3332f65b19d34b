//! Whole programs: from source to an image, run in this process, with outputs that were worked out by hand.

mod machine;

use takt_program::{Image, address};
use takt_st::build::{BuildError, Built, build, try_build};
use takt_st::hir::{Area, Program, TrapKind};
use takt_st::{project, source::Sources};

fn checked(text: &str) -> Program {
    let mut sources = Sources::new();
    sources.add("main.st", text.as_bytes()).unwrap();
    let checked = project::check("test", &mut sources).unwrap();
    match checked.program {
        Some(program) => program,
        None => {
            panic!("{:#?}", checked.diagnostics.iter().map(|one| &one.found).collect::<Vec<_>>())
        }
    }
}

fn built(text: &str) -> (Program, Built) {
    let program = checked(text);
    let built = build(&program).unwrap();
    (program, built)
}

/// A program that runs, one job of its only task each 100 ms.
struct Plant {
    program: Program,
    machine: machine::Machine,
    cycle: u64,
}

impl Plant {
    const PERIOD_NS: u64 = 100_000_000;

    fn start(text: &str) -> Plant {
        let (program, built) = built(text);
        assert!(Image::verify(&built.image).is_ok());
        let mut machine = machine::Machine::load(&built.native);
        machine.start();
        Plant { program, machine, cycle: 0 }
    }

    fn input(&mut self, byte: u64, bytes: &[u8]) {
        self.machine.write(address::INPUT + byte, bytes);
    }

    fn output<const N: usize>(&self, byte: u64) -> [u8; N] {
        self.machine.read(address::OUTPUT + byte, N).try_into().unwrap()
    }

    fn cycle(&mut self) -> Result<(), takt_st::hir::Trap> {
        let elapsed = if self.cycle == 0 { 0 } else { Self::PERIOD_NS };
        let now = 1_000_000_000 + self.cycle * Self::PERIOD_NS;
        let result =
            self.machine.run(self.program.tasks[0].entry.0 as usize, now, elapsed, self.cycle);
        self.cycle += 1;
        result
    }
}

const PLANT: &str = include_str!("programs/plant.st");

#[test]
fn timers_counters_a_controller_and_arrays_give_what_was_worked_out_by_hand() {
    let mut plant = Plant::start(PLANT);
    // The initial value of an output is there before the first cycle.
    assert_eq!(plant.output::<2>(6), 7i16.to_le_bytes());
    let mut done = Vec::new();
    let mut counts = Vec::new();
    for cycle in 0..8 {
        // Start is pressed from cycle 2 on; a part passes in every other cycle.
        plant.input(0, &[u8::from(cycle >= 2) | u8::from(cycle % 2 == 1) << 1]);
        plant.cycle().unwrap();
        done.push(plant.output::<1>(0)[0] & 1);
        counts.push(i16::from_le_bytes(plant.output(2)));
    }
    // TON of 300 ms, started in cycle 2: on in cycle 5.
    assert_eq!(done, [0, 0, 0, 0, 0, 1, 1, 1]);
    assert_eq!(counts, [0, 1, 1, 2, 2, 3, 3, 4]);
    // The sum of squares of 1 to 10.
    assert_eq!(i16::from_le_bytes(plant.output(4)), 385);
    // The controller of gain 2 and integral time 1 s at an error of 5, in steps of 0.1 s: 2 * (5 + 0.5 * 8).
    assert_eq!(f32::from_le_bytes(plant.output(8)), 18.0);
}

#[test]
fn a_division_by_zero_is_told_with_its_line() {
    let mut plant = Plant::start(include_str!("programs/division.st"));
    let trap = plant.cycle().unwrap_err();
    assert_eq!(trap.kind, TrapKind::ZeroDivide);
    let file = &plant.program.files[usize::from(trap.location.file)];
    assert_eq!(
        format!("{file}:{}: {}", trap.location.line, trap.kind),
        "main.st:5: division by zero"
    );
}

#[test]
fn two_builds_of_a_source_are_equal() {
    assert_eq!(built(PLANT).1.image, built(PLANT).1.image);
}

#[test]
fn the_image_says_where_variables_are_and_what_traps() {
    let (program, built) = built(PLANT);
    let image = Image::verify(&built.image).unwrap();
    let variable = image.variable("parts").unwrap();
    assert_eq!((variable.area, variable.offset), (takt_program::Area::Output, 2));
    assert!(variable.flags.has(takt_program::Flags::OUTPUT));
    assert_eq!(program.area_size(Area::Output), 12);
    assert_eq!(image.tasks().count(), 1);
    assert!(built.native.traps.iter().any(|site| site.trap.kind == TrapKind::Bounds));
}

#[test]
fn a_project_without_a_task_has_no_image() {
    let program = checked(
        "FUNCTION twice : DINT\nVAR_INPUT x : DINT; END_VAR\ntwice := 2 * x;\nEND_FUNCTION\n",
    );
    assert!(matches!(build(&program), Err(BuildError::NoTask)));
}

/// A program whose parameter stands for a marker that is assigned by another name and type.
const TWO_TYPES: &str = "FUNCTION SumIo : INT\n\
    VAR_IN_OUT x : INT; END_VAR\n\
    VAR i : INT; END_VAR\n\
    FOR i := 1 TO 3 DO %MW0 := INT_TO_WORD(i); SumIo := SumIo + x; END_FOR;\n\
    END_FUNCTION\n\
    FUNCTION SumBoth : INT\n\
    VAR_IN_OUT x : INT; w : WORD; END_VAR\n\
    VAR i : INT; END_VAR\n\
    FOR i := 1 TO 3 DO w := INT_TO_WORD(i); SumBoth := SumBoth + x; END_FOR;\n\
    END_FUNCTION\n\
    FUNCTION SumThrough : INT\n\
    VAR_IN_OUT x : INT; END_VAR\n\
    VAR_INPUT r : REF_TO WORD; END_VAR\n\
    VAR i : INT; END_VAR\n\
    FOR i := 1 TO 3 DO r^ := INT_TO_WORD(i); SumThrough := SumThrough + x; END_FOR;\n\
    END_FUNCTION\n\
    PROGRAM Main\n\
    VAR mi AT %MW0 : INT; mw AT %MW0 : WORD; q AT %QW0 : ARRAY[0..2] OF INT; END_VAR\n\
    mi := 100; q[0] := SumIo(x := mi);\n\
    mi := 100; q[1] := SumBoth(x := mi, w := mw);\n\
    mi := 100; q[2] := SumThrough(x := mi, r := REF(mw));\n\
    END_PROGRAM\n\
    CONFIGURATION C TASK t (INTERVAL := T#100ms, PRIORITY := 1); PROGRAM p WITH t : Main; END_CONFIGURATION\n";

#[test]
fn a_parameter_may_stand_for_a_marker_that_has_another_type_too() {
    let mut plant = Plant::start(TWO_TYPES);
    plant.cycle().unwrap();
    let sums = plant.output::<6>(0);
    assert_eq!(sums.as_chunks::<2>().0, [6i16; 3].map(i16::to_le_bytes));
}

/// The machine code of the program `Slow`, which runs beside `Fast`.
fn slow(globals: &str, fast: &str, slow: &str) -> String {
    let program = checked(&format!(
        "VAR_GLOBAL {globals} END_VAR\n\
         PROGRAM Fast {fast} END_PROGRAM\nPROGRAM Slow {slow} END_PROGRAM\n\
         CONFIGURATION c\n\
         TASK often (INTERVAL := T#1ms, PRIORITY := 1); TASK seldom (INTERVAL := T#9ms, PRIORITY := 2);\n\
         PROGRAM fast WITH often : Fast; PROGRAM slow WITH seldom : Slow;\n\
         END_CONFIGURATION"
    ));
    let all = takt_st::native::assembly(&program);
    let (_, from) = all.split_once("; Slow\n").unwrap();
    from.split("\n; ").next().unwrap().to_owned()
}

#[test]
fn a_bit_that_lies_beside_those_of_another_task_is_assigned_by_one_instruction() {
    let globals = "a AT %MX0.0 : BOOL; b AT %MX0.1 : BOOL; w : WORD; alone AT %MX9.0 : BOOL; lamp AT %QX0.0 : BOOL;";
    let (fast, input) = ("b := TRUE; w.4 := b;", "VAR i AT %IX0.0 : BOOL; END_VAR ");
    let locked = |text: &str| {
        let code = slow(globals, fast, &format!("{input}{text}"));
        code.lines().filter(|line| line.trim_start().starts_with("lock ")).count()
    };
    // A constant needs one, another value one that sets and one that clears.
    assert_eq!(locked("a := TRUE;"), 1);
    assert_eq!(locked("a := FALSE;"), 1);
    assert_eq!(locked("a := i;"), 2);
    assert_eq!(locked("w.3 := TRUE;"), 1);
    // No other task uses this byte, and a task has its outputs for itself.
    assert_eq!(locked("alone := i; lamp := i;"), 0);
}

#[test]
fn a_bit_that_two_tasks_use_leaves_the_bits_beside_it() {
    let program = checked(
        "PROGRAM One VAR a AT %MX0.0 : BOOL; i AT %IX0.0 : BOOL; END_VAR a := i; END_PROGRAM\n\
         PROGRAM Two VAR b AT %MX0.3 : BOOL; i AT %IX0.1 : BOOL; END_VAR b := NOT i; END_PROGRAM\n\
         CONFIGURATION c\n\
         TASK one (INTERVAL := T#1ms, PRIORITY := 1); TASK two (INTERVAL := T#9ms, PRIORITY := 2);\n\
         PROGRAM p WITH one : One; PROGRAM q WITH two : Two;\n\
         END_CONFIGURATION",
    );
    let native = build(&program).unwrap().native;
    let mut machine = machine::Machine::load(&native);
    machine.start();
    machine.write(address::MARKER, &[0b1010_0010]);
    for (input, expected) in
        [(0u8, 0b1010_1010u8), (1, 0b1010_1011), (3, 0b1010_0011), (2, 0b1010_0010)]
    {
        machine.write(address::INPUT, &[input]);
        for task in &program.tasks {
            machine.run(task.entry.0 as usize, 0, 0, 0).unwrap();
        }
        assert_eq!(machine.read(address::MARKER, 1), [expected], "input {input}");
    }
}

/// What `takt plc check` tells about a program that has no image.
fn refused(text: &str) -> (String, String) {
    let mut sources = Sources::new();
    sources.add("main.st", text.as_bytes()).unwrap();
    let program = project::check("test", &mut sources).unwrap().program.unwrap();
    // What is refused must not end the compiler here either.
    takt_st::native::assembly(&program);
    takt_st::native::intermediate(&program);
    let one = try_build(&program).unwrap_err().diagnostic(&program, &sources);
    let text = format!("{} {}: {}", sources.position(one.span), one.code, one.found);
    (text, one.hint.unwrap())
}

#[test]
fn a_frame_that_no_stack_holds_is_refused_before_it_is_laid_out() {
    const HUGE: &str = "TYPE Huge : ARRAY[0..8388607] OF LREAL; END_TYPE\n";
    // Beyond what Cranelift's 32 bits with a sign hold.
    let locals: String = (0..33).map(|number| format!("v{number} : Huge; ")).collect();
    let function = format!("{HUGE}FUNCTION Large : INT VAR {locals}END_VAR\nEND_FUNCTION\n");
    let (found, hint) = refused(&function);
    let needs = "needs 2214592512 bytes of stack; a task has at most 1044480";
    assert_eq!(found, format!("2:10 stack-too-large: `Large` {needs}"));
    assert!(hint.starts_with("`Large` takes most: 2214592512 bytes, of which its variable `v"));
    let (found, _) = refused(&format!(
        "{function}PROGRAM Main Large(); END_PROGRAM\nCONFIGURATION c\n\
         TASK t (INTERVAL := T#1ms, PRIORITY := 1);\nPROGRAM p WITH t : Main;\nEND_CONFIGURATION"
    ));
    assert_eq!(found, format!("6:6 stack-too-large: the task `t` {needs}"));
    // Beyond 32 bits: the sum would be 0 again, though none of the calls is reached.
    let (found, _) = refused(&format!(
        "{HUGE}FUNCTION Make : Huge END_FUNCTION\n\
         FUNCTION Many VAR_IN_OUT a : Huge; END_VAR\nRETURN;\n{}END_FUNCTION\n",
        "a := Make();\n".repeat(64)
    ));
    let needs = "needs 4294967296 bytes of stack; a task has at most 1044480";
    assert_eq!(found, format!("3:10 stack-too-large: `Many` {needs}"));
}

/// Structures in each other as deep as that, with a level for the number in the innermost.
fn nested(depth: usize, inner_first: bool) -> String {
    let mut types: Vec<String> = (2..=depth)
        .map(|level| match level {
            2 => "T2 : STRUCT a : INT; END_STRUCT;\n".to_owned(),
            _ => format!("T{level} : STRUCT a : T{}; END_STRUCT;\n", level - 1),
        })
        .collect();
    if !inner_first {
        types.reverse();
    }
    format!("TYPE\n{}END_TYPE\n", types.concat())
}

#[test]
fn types_are_as_deep_as_allowed_whatever_their_order() {
    let codes = |text: String| -> Vec<String> {
        let mut sources = Sources::new();
        sources.add("main.st", text.as_bytes()).unwrap();
        let checked = project::check("test", &mut sources).unwrap();
        checked.diagnostics.iter().map(|one| format!("{}: {}", one.code, one.found)).collect()
    };
    let told = ["too-deep: a type with 101 types within each other"];
    for inner_first in [true, false] {
        assert_eq!(codes(nested(100, inner_first)), [""; 0]);
        assert_eq!(codes(nested(101, inner_first)), told);
        let block = "FUNCTION_BLOCK Block VAR a : T100; END_VAR END_FUNCTION_BLOCK\n";
        assert_eq!(codes(nested(100, inner_first) + block), told);
        assert_eq!(
            codes(nested(100, inner_first) + "VAR_GLOBAL a : ARRAY[0..1] OF T100; END_VAR\n"),
            told
        );
        // What refers to a structure is no deeper for what is in that.
        let list = "TYPE L : STRUCT next : REF_TO L; a : REF_TO T100; END_STRUCT; END_TYPE\n";
        assert_eq!(codes(nested(100, inner_first) + list), [""; 0]);
    }
    let references: String =
        (1..120).map(|level| format!("R{level} : REF_TO R{};\n", level - 1)).collect();
    assert_eq!(codes(format!("TYPE R0 : INT;\n{references}END_TYPE\n"))[0], told[0]);
    // As many as a stack would not hold.
    assert!(codes(nested(50_000, true)).contains(&told[0].to_owned()));
}

#[test]
fn an_image_has_its_own_limit_of_depth() {
    let image = |depth| {
        let text = format!(
            "{}PROGRAM Main VAR a : T{depth}; END_VAR a := a; END_PROGRAM\n\
             CONFIGURATION c\nTASK t (INTERVAL := T#1ms, PRIORITY := 1);\n\
             PROGRAM p WITH t : Main;\nEND_CONFIGURATION",
            nested(depth, true)
        );
        build(&checked(&text)).map(drop).map_err(|error| error.to_string())
    };
    assert_eq!(image(31), Ok(()));
    let told = image(32).unwrap_err();
    assert!(told.contains("depth: found 33, the limit is 32"), "{told}");
}

#[test]
fn a_literal_is_the_nearest_real() {
    let mut plant = Plant::start(
        "PROGRAM Main VAR q AT %QD0 : ARRAY[0..4] OF REAL; one : REAL := 1.0; END_VAR\n\
         q[0] := 1.00000005960464478;\n\
         q[1] := -1.00000005960464478;\n\
         q[2] := REAL#1.00000005960464478;\n\
         q[3] := one * 1.00000005960464478;\n\
         q[4] := 3.40282356779733661E38;\n\
         END_PROGRAM\nCONFIGURATION c\nTASK t (INTERVAL := T#1ms, PRIORITY := 1);\n\
         PROGRAM p WITH t : Main;\nEND_CONFIGURATION",
    );
    plant.cycle().unwrap();
    // Each lies so close beside the middle of two REALs that the nearest LREAL is that middle.
    let above = 1.0 + f32::EPSILON;
    let expected = [above, -above, above, above, f32::MAX];
    assert_eq!(plant.output::<20>(0).as_chunks::<4>().0, expected.map(f32::to_le_bytes));
}
