//! Which task the image names as the writer of an output.

use crate::{build, project, source::Sources};

/// Builds a project of two tasks: the program `A` in `f`, the program `B` in `s`. What is not the text of these two is in
/// front of them.
fn outcome(before: &str, a: &str, b: &str, behind: &[&str]) -> Result<Vec<u8>, String> {
    let text = format!(
        "VAR_GLOBAL motor AT %QW0 : INT; outs AT %QW4 : ARRAY[0..3] OF INT; END_VAR\n{before}\n\
         PROGRAM A {a} END_PROGRAM\nPROGRAM B {b} END_PROGRAM\n\
         CONFIGURATION c\n\
         TASK f (INTERVAL := T#1ms, PRIORITY := 1); TASK s (INTERVAL := T#9ms, PRIORITY := 2);\n\
         PROGRAM pf WITH f : A; PROGRAM ps WITH s : B;\n\
         END_CONFIGURATION"
    );
    let mut sources = Sources::new();
    sources.add("main.st", text.as_bytes()).unwrap();
    for (number, test) in behind.iter().enumerate() {
        sources.add(&format!("test{number}.st"), test.as_bytes()).unwrap();
    }
    let checked = project::check_tests("test", &mut sources).unwrap();
    let told: Vec<String> = checked.diagnostics.iter().map(|one| one.found.clone()).collect();
    let Some(program) = checked.program else { panic!("{told:#?}") };
    build::build(&program).map(|built| built.image).map_err(|error| error.to_string())
}

/// The writers of `motor` and of `outs`, by the names of their tasks.
#[track_caller]
fn writers(before: &str, a: &str, b: &str) -> [Option<String>; 2] {
    let bytes = outcome(before, a, b, &[]).unwrap();
    let image = takt_program::Image::verify(&bytes).unwrap();
    ["motor", "outs"].map(|name| {
        let task = image.variable(name).unwrap().writer?;
        Some(image.task(task).unwrap().name.to_owned())
    })
}

const F: Option<&str> = Some("f");
const S: Option<&str> = Some("s");

#[track_caller]
fn assert_writers(before: &str, a: &str, b: &str, expected: [Option<&str>; 2]) {
    assert_eq!(writers(before, a, b), expected.map(|name| name.map(str::to_owned)));
}

/// Both tasks write this output.
#[track_caller]
fn assert_shared(before: &str, a: &str, b: &str, output: &str) {
    let told = outcome(before, a, b, &[]).map(|image| image.len()).unwrap_err();
    let says = format!("the tasks `f` and `s` both write the output `{output}`, or a part of it");
    assert!(told.starts_with(&says), "{told}");
}

const STOP: &str =
    "FUNCTION_BLOCK Stop VAR_IN_OUT speed : INT; END_VAR speed := 0; END_FUNCTION_BLOCK\n";
const OUTER: &str = "FUNCTION_BLOCK Outer VAR_IN_OUT x : INT; END_VAR VAR inner : Stop; END_VAR\n\
    inner(speed := x); END_FUNCTION_BLOCK\n";

#[test]
fn the_task_that_hands_an_output_on_to_a_block_writes_it() {
    let b = "VAR s : Stop; END_VAR s(speed := motor); s(speed := outs[1]);";
    assert_writers(STOP, ";", b, [S, S]);
    // Two tasks write it, as if both assigned it by its name.
    assert_shared(STOP, "motor := 1500;", b, "motor");
    let nested = format!("{STOP}{OUTER}");
    assert_writers(&nested, "VAR o : Outer; END_VAR o(x := motor);", ";", [F, None]);
}

#[test]
fn a_call_within_a_block_hands_on_for_the_task_that_runs_it() {
    let before = format!(
        "{STOP}FUNCTION_BLOCK Driver VAR s : Stop; END_VAR s(speed := motor); END_FUNCTION_BLOCK\n"
    );
    assert_writers(&before, ";", "VAR d : Driver; END_VAR d();", [S, None]);
}

#[test]
fn the_task_that_hands_an_output_on_to_a_function_writes_it() {
    let before = "FUNCTION Go : INT VAR_IN_OUT x : INT; END_VAR x := x + 1; END_FUNCTION\n";
    let b = "VAR q : INT; END_VAR q := Go(x := motor);";
    assert_writers(before, ";", b, [S, None]);
    assert_shared(before, "motor := 1;", b, "motor");
}

#[test]
fn an_open_array_is_written_by_who_assigns_its_elements() {
    let before = "FUNCTION SumOf : INT VAR_INPUT a : ARRAY[*] OF INT; END_VAR SumOf := a[0] + a[1]; END_FUNCTION\n\
        FUNCTION Clear : INT VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR a[0] := 0; Clear := 0; END_FUNCTION\n\
        FUNCTION Deep : INT VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR Deep := Clear(a := a); END_FUNCTION\n\
        FUNCTION Lend : INT VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR Lend := One(x := a[1]); END_FUNCTION\n\
        FUNCTION One : INT VAR_IN_OUT x : INT; END_VAR x := 1; One := 0; END_FUNCTION\n\
        FUNCTION_BLOCK Sum VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR VAR_OUTPUT q : INT; END_VAR q := a[0]; END_FUNCTION_BLOCK\n";
    let read = "VAR z : INT; s : Sum; END_VAR z := SumOf(outs); s(a := outs);";
    assert_writers(before, "outs[1] := 5;", read, [None, F]);
    for call in ["Clear", "Deep", "Lend"] {
        let b = format!("VAR z : INT; END_VAR z := {call}(a := outs);");
        assert_writers(before, ";", &b, [None, S]);
        assert_shared(before, "outs[1] := 5;", &b, "outs");
    }
}

#[test]
fn a_message_is_written_where_it_is_read_from_a_channel() {
    let send = "CHANNEL_WRITE(PORT := 'out', MESSAGE := motor);";
    let receive = "CHANNEL_READ(PORT := 'in', MESSAGE := motor);";
    assert_writers("", "motor := 1;", send, [F, None]);
    assert_writers("", ";", receive, [S, None]);
}

#[test]
fn the_only_task_that_assigns_through_references_writes_what_is_referred_to() {
    let taken = "VAR r : REF_TO INT; END_VAR r := REF(motor); r^ := 1;";
    assert_writers("", taken, ";", [F, None]);
    assert_shared("", taken, "motor := 2;", "motor");
    // A reference that is only read writes nothing, and one of another type writes another output.
    let read = "VAR r : REF_TO INT; n : INT; END_VAR r := REF(motor); n := r^;";
    assert_writers("", read, "motor := 2;", [S, None]);
    // Another task takes it than assigns.
    let before = "VAR_GLOBAL r : REF_TO INT; END_VAR\n";
    assert_writers(before, "r := REF(motor);", "IF r <> NULL THEN r^ := 1; END_IF;", [S, None]);
    // Handed on, and of a part of an array.
    let before = format!("{STOP}VAR_GLOBAL all : REF_TO ARRAY[0..3] OF INT; END_VAR\n");
    let a = "all := REF(outs);";
    assert_writers(&before, a, "VAR s : Stop; END_VAR s(speed := all^[2]);", [None, S]);
    let part = "VAR one : REF_TO INT; END_VAR one := REF(all^[2]); one^ := 1;";
    assert_writers(&before, a, part, [None, S]);
}

#[test]
fn an_output_that_two_tasks_write_is_refused() {
    assert_shared("", "motor := motor + 1;", "motor := motor + 1;", "motor");
    // In part.
    assert_shared("", "outs[0] := 1;", "outs[1] := 1;", "outs");
    let byte = "VAR_GLOBAL lamps AT %QB2 : BYTE; END_VAR\n";
    assert_shared(byte, "lamps.0 := TRUE;", "lamps.1 := TRUE;", "lamps");
    // A test is no task of the program.
    let test = "TEST 'one' VAR r : REF_TO INT; END_VAR motor := 1; r := REF(motor); END_TEST";
    let b = "VAR n : INT; r : REF_TO INT; END_VAR r := REF(n); r^ := 1;";
    assert!(outcome("", "motor := 1;", b, &[test]).is_ok());
}

#[test]
fn each_bit_of_a_byte_has_a_writer_for_itself() {
    let bits =
        "VAR_GLOBAL left AT %QX3.0 : BOOL; right AT %QX3.1 : BOOL; end AT %QX3.7 : BOOL; END_VAR\n";
    let bytes = outcome(bits, "left := TRUE; end := left;", "right := left;", &[]).unwrap();
    let image = takt_program::Image::verify(&bytes).unwrap();
    let writer = |name| image.task(image.variable(name).unwrap().writer?).map(|task| task.name);
    assert_eq!(["left", "right", "end"].map(writer), [F, S, F]);
}

#[test]
fn a_reference_that_two_tasks_may_assign_through_is_refused() {
    let a = "VAR r : REF_TO INT; END_VAR r := REF(motor); r^ := 1;";
    let b = "VAR n : INT; r : REF_TO INT; END_VAR r := REF(n); r^ := 1;";
    assert_eq!(
        outcome("", a, b, &[]).map(|image| image.len()).unwrap_err(),
        "REF of the output `motor`, and the tasks `f` and `s` both assign through references of its type"
    );
    // Of no output there is nothing to say, and a test is no task of the program.
    assert!(outcome("", b, b, &[]).is_ok());
    let test = "TEST 'one' VAR n : INT; r : REF_TO INT; END_VAR r := REF(n); r^ := 1; r := REF(motor); END_TEST";
    assert!(outcome("", a, ";", &[test]).is_ok());
}
