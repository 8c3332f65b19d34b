//! TEST blocks: what passes, what fails and how it is told, and what a test can do with time and tasks.

mod common;

use common::Folder;

const FILL: &str = "VAR_GLOBAL level AT %IW0 : INT; pump AT %QX0.0 : BOOL; END_VAR
FUNCTION_BLOCK Delay
VAR_INPUT on : BOOL; END_VAR
VAR_OUTPUT q : BOOL; END_VAR
VAR timer : TON; END_VAR
timer(IN := on, PT := T#50ms);
q := timer.Q;
END_FUNCTION_BLOCK
PROGRAM Main
VAR delay : Delay; END_VAR
delay(on := level < 10);
pump := delay.q;
END_PROGRAM
CONFIGURATION Plant
TASK often (INTERVAL := T#10ms, PRIORITY := 1);
PROGRAM one WITH often : Main;
END_CONFIGURATION
";

#[test]
fn tests_pass_fail_and_break_each_for_itself() {
    let folder = Folder::with_tests(
        FILL,
        "TEST 'a block alone'
VAR delay : Delay; END_VAR
delay(on := TRUE);
ADVANCE(T#49ms);
delay(on := TRUE);
ASSERT(NOT delay.q);
ASSERT(delay.timer.ET = T#49ms);
ADVANCE(T#1ms);
delay(on := TRUE);
ASSERT(delay.q);
END_TEST
TEST 'the whole program'
level := 3;
RUN(T#50ms);
ASSERT(NOT pump, 'too early');
RUN(T#20ms);
ASSERT(pump);
level := 30;
RUN(T#10ms);
ASSERT(pump, 'it \"goes\" on');
ASSERT(FALSE);
END_TEST
TEST 'a trap'
VAR i : INT; END_VAR
i := 10 / level;
END_TEST
TEST 'state begins anew'
ASSERT(level = 0);
ASSERT(NOT pump);
END_TEST
",
    );
    let ended = folder.takt_plc(&["test", "main.st", "t.st", "--junit", "report.xml"]);
    let ended = ended.expect(1, "4 tests, 1 failed, 1 broken");
    let ended = ended.expect(1, "ok     t.st:1: a block alone\n");
    let ended = ended.expect(
        1,
        "FAILED t.st:12: the whole program\n    t.st:20: ASSERT(pump, 'it \"goes\" on'): it \"goes\" on\n",
    );
    let ended = ended.expect(1, "BROKEN t.st:23: a trap\n    t.st:25: division by zero");
    ended.expect(1, "ok     t.st:27: state begins anew\n");
    let xml = String::from_utf8(folder.read("report.xml")).unwrap();
    for part in [
        "tests=\"4\" failures=\"1\" errors=\"1\"",
        "<testcase name=\"a block alone\" classname=\"test\" time=\"",
        "file=\"t.st\" line=\"12\"><failure message=\"t.st:20: ASSERT(pump, 'it &quot;goes&quot; on'): it &quot;goes&quot; on\">",
        "<error message=\"t.st:25: division by zero",
    ] {
        assert!(xml.contains(part), "{part}: {xml}");
    }
    let ended = folder.takt_plc(&["test", "main.st", "t.st", "--filter", "state"]);
    ended.expect(0, "test: 1 tests, all as expected");
    let ended = folder.takt_plc(&["test", "main.st", "t.st", "--filter", "none such"]);
    ended.expect(2, "found no test with `none such` in its name");
}

#[test]
fn a_comparison_is_told_with_both_values() {
    for (declaration, assertion, says) in [
        ("x : INT := 2;", "ASSERT(x = 3);", "found 2, expected 3\n"),
        (
            "x : INT := -2;",
            "ASSERT(x >= 3, 'grows');",
            "'grows'): grows\n      found -2, expected at least 3",
        ),
        ("x : REAL := 1.5;", "ASSERT_NEAR(x, 1.6, 0.05);", "found 1.5, expected 1.6 +-0.05"),
        ("x : TIME := T#1.5s;", "ASSERT(x < T#1s);", "found T#1500ms, expected less than T#1s"),
        ("x : STRING := 'ab';", "ASSERT(x = 'ac');", "found 'ab', expected 'ac'"),
        ("x : Colour;", "ASSERT(x = Green);", "found Red, expected Green"),
        (
            "x : WORD := 16#AB;",
            "ASSERT(x <> 16#AB);",
            "found 16#00AB, expected something other than 16#00AB",
        ),
        ("x : BOOL;", "ASSERT(x);", "t.st:5: ASSERT(x)\n"),
        // Kept in a register by a loop, and seen all the same.
        (
            "x, i : INT;",
            "FOR i := 1 TO 9 DO x := x + i; ASSERT(x < 10); END_FOR;",
            "found 10, expected less than 10",
        ),
    ] {
        let folder = Folder::with_tests(
            FILL,
            &format!(
                "TYPE Colour : (Red, Green); END_TYPE\nTEST 'one'\nVAR {declaration} END_VAR\n\n{assertion}\nEND_TEST\n"
            ),
        );
        folder.takt_plc(&["test", "main.st", "t.st"]).expect(1, says);
    }
}

#[test]
fn a_test_that_does_not_end_or_lets_too_much_time_pass_is_broken() {
    let folder = Folder::with_tests(
        FILL,
        "TEST 'endless'
VAR i : DINT; b : BOOL; END_VAR
WHILE NOT b DO FOR i := 1 TO 1000000 DO IF i < 0 THEN b := TRUE; END_IF; END_FOR; END_WHILE;
END_TEST
TEST 'ages'
ADVANCE(T#300d);
END_TEST
",
    );
    let ended = folder.takt_plc(&["test", "main.st", "t.st", "--time-limit", "100"]);
    let ended = ended.expect(1, "it did not end in time");
    ended.expect(1, "t.st:6: it takes more than");
}

#[test]
fn tests_are_no_part_of_the_image_and_the_program_cannot_use_what_they_declare() {
    let folder = Folder::with_tests(
        FILL,
        "FUNCTION Helper : INT\nHelper := 1;\nEND_FUNCTION\nTEST 'a'\nASSERT(Helper() = 1);\nEND_TEST\n",
    );
    folder.takt_plc(&["build", "main.st", "-o", "plain.plc"]).expect(0, "");
    folder.takt_plc(&["build", "main.st", "t.st", "-o", "plain2.plc"]).expect(0, "");
    let [plain, with] = ["plain.plc", "plain2.plc"].map(|name| folder.read(name).len());
    assert_eq!(plain, with);
    folder.takt_plc(&["check", "main.st", "t.st"]).expect(0, "");
    folder.write("main.st", &FILL.replace("level < 10", "level < Helper()"));
    let ended = folder.takt_plc(&["check", "main.st", "t.st"]);
    ended.expect(2, "there is no function `Helper`");
}

#[test]
fn log_lines_are_shown_with_task_and_time() {
    let folder = Folder::new();
    let body = "IF level = 1 THEN LOG_LINE('level is one'); END_IF;\npump := level > 1;";
    let source = FILL.replace("pump := delay.q;", body);
    folder.write("main.st", &source);
    folder.write("t.st", "TEST 'a'\nLOG_LINE('here');\nlevel := 1;\nRUN(T#10ms);\nEND_TEST\n");
    let ended = folder.takt_plc(&["test", "main.st", "t.st"]);
    ended.expect(0, "[0 ns test-block] here\n").expect(0, "[0 ns often] level is one\n");
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    folder.write("t.csv", "level,pump\n1,0\n2,1\n");
    folder.takt_plc(&["test", "main.plc", "t.csv"]).expect(0, "[0 ns often] level is one\n");
}

/// They say why.
#[test]
fn log_lines_of_tests_that_fail_and_break_are_shown() {
    let body = "IF level = 1 THEN LOG_LINE('level is one'); level := level / (level - 1); END_IF;";
    let folder = Folder::with_tests(
        &FILL.replace("pump := delay.q;", body).replace("AT %IW0", ""),
        "TEST 'fails'
LOG_LINE('before it fails');
ASSERT(FALSE);
END_TEST
TEST 'breaks in a job'
LOG_LINE('before the job');
level := 1;
RUN(T#10ms);
END_TEST
TEST 'breaks itself'
VAR i : INT; END_VAR
LOG_LINE('first');
LOG_LINE('second');
i := 1 / i;
END_TEST
",
    );
    let mut ended = folder.takt_plc(&["test", "main.st", "t.st"]);
    for line in [
        "[0 ns test-block] before it fails\nFAILED",
        "[0 ns test-block] before the job\n[0 ns often] level is one\nBROKEN",
        "[0 ns test-block] first\n[0 ns test-block] second\nBROKEN",
    ] {
        ended = ended.expect(1, line);
    }
}

#[test]
fn a_body_that_declares_eno_decides_what_it_is() {
    let folder = Folder::with_tests(
        FILL,
        "FUNCTION divided : REAL
VAR_INPUT a, b : REAL; END_VAR
VAR_OUTPUT ENO : BOOL := TRUE; END_VAR
IF ABS(b) < 1.0E-6 THEN ENO := FALSE; RETURN; END_IF;
divided := a / b;
END_FUNCTION
TEST 'eno'
VAR good : BOOL; r : REAL; END_VAR
r := divided(a := 1.0, b := 2.0, ENO => good);
ASSERT(good);
r := divided(a := 1.0, b := 0.0, ENO => good);
ASSERT(NOT good);
r := divided(EN := TRUE, a := 1.0, b := 2.0, ENO => good);
ASSERT(good);
r := divided(EN := FALSE, a := 3.0, b := 2.0, ENO => good);
ASSERT(NOT good);
ASSERT_NEAR(r, 0.5, 0.0);
END_TEST
",
    );
    folder.takt_plc(&["test", "main.st", "t.st"]).expect(0, "1 tests, all as expected");
}

/// A sequence of steps, a cascade, recipes, alarms, a ramp, a checksum, a buffer, references, arrays of any size, shifts:
/// what automation engineers write, each in a file with a test.
#[test]
fn ten_programs_as_engineers_write_them_pass_their_tests() {
    let project = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/programs/engineers");
    let folder = Folder::new();
    folder.takt_plc(&["fmt", "--check", project]).expect(0, "");
    folder.takt_plc(&["test", project]).expect(0, "10 tests, all as expected");
    folder.takt_plc(&["build", project, "-o", "engineers.plc"]).expect(0, "2 tasks");
}

/// A test is the other partition: it gives messages, and takes what the program writes.
#[test]
fn a_test_exchanges_messages_with_the_program_at_its_ports() {
    let folder = Folder::new();
    folder.write(
        "main.st",
        "TYPE Order : STRUCT number : DINT; urgent : BOOL; END_STRUCT; END_TYPE
VAR_GLOBAL jobs : DINT; last : LINT; END_VAR
PROGRAM Main
VAR order : Order; text : STRING[15]; i : DINT; END_VAR
jobs := jobs + 1;
last := CHANNEL_READ('orders', order);
IF last > 0 THEN
    order.number := order.number * 2;
    IF order.urgent = TRUE THEN order.number := order.number + 1; END_IF;
    last := CHANNEL_WRITE('done', order);
    text := 'done';
    CHANNEL_WRITE('log', text, LENGTH := LEN(text));
END_IF;
(* In a register, but for the message. *)
FOR i := 1 TO 3 DO CHANNEL_WRITE('count', i); END_FOR;
END_PROGRAM
CONFIGURATION Plant
TASK on_order (CHANNEL := 'orders', INTERVAL := T#2ms, PRIORITY := 1);
PROGRAM one WITH on_order : Main;
END_CONFIGURATION
",
    );
    folder.write(
        "t.st",
        "TYPE Raw : STRUCT number : DINT; urgent : BYTE; END_STRUCT; END_TYPE
TEST 'orders'
VAR raw : Raw; done : Order; text : ARRAY[0..15] OF BYTE; i, n : DINT; END_VAR
RUN(T#10ms);
ASSERT(jobs = 0, 'no message, no job');
ASSERT(CHANNEL_READ('done', done) = -6, 'empty');
FOR i := 1 TO 3 DO
    raw.number := i;
    raw.urgent := 16#80; // no value of BOOL
    ASSERT(CHANNEL_WRITE('orders', raw) = 0);
END_FOR;
RUN(T#3ms);
ASSERT(jobs = 2, 'one each 2 ms');
RUN(T#10ms);
ASSERT(jobs = 3);
FOR i := 1 TO 3 DO
    ASSERT(CHANNEL_READ('done', done) = 8);
    ASSERT(done.number = 2 * i + 1);
    ASSERT(done.urgent);
END_FOR;
ASSERT(CHANNEL_READ('log', text) = 4);
ASSERT(text[0] = 16#64);
FOR i := 1 TO 3 DO
    ASSERT(CHANNEL_READ('count', n) = 4);
    ASSERT(n = i);
END_FOR;
END_TEST
TEST 'a length that the message does not have'
VAR text : STRING[15]; i : INT := 17; END_VAR
CHANNEL_WRITE('orders2', text, LENGTH := i);
END_TEST
",
    );
    let refused = folder.takt_plc(&["test", "main.st", "t.st"]);
    refused.expect(2, "the program has no port `orders2`");
    let text = String::from_utf8(folder.read("t.st")).unwrap();
    folder.write(
        "t.st",
        &text
            .replace("CHANNEL_WRITE('orders2', text", "CHANNEL_WRITE('orders', order")
            .replace("VAR text : STRING[15]; i : INT := 17", "VAR order : Order; i : INT := 9"),
    );
    let ended = folder.takt_plc(&["test", "main.st", "t.st"]);
    let ended = ended.expect(1, "ok     t.st:2: orders");
    ended.expect(1, "t.st:30: value out of its subrange");
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    let shown = folder.takt_plc(&["inspect", "main.plc"]);
    let shown =
        shown.expect(0, "port 0: orders in, 8 bytes").expect(0, "port 1: done out, 8 bytes");
    shown.expect(0, "on_order").expect(0, "channel orders");
    // A program under a table has no other partition.
    folder.write("t.csv", "jobs\n0\n0\n");
    folder.takt_plc(&["test", "main.plc", "t.csv", "--step", "1000"]).expect(0, "as expected");
}

#[test]
fn a_message_has_nothing_behind_the_text_of_a_string() {
    let folder = Folder::new();
    folder.write(
        "main.st",
        "TYPE Note : STRUCT number : BYTE; wide : WSTRING[4]; texts : ARRAY[1..2] OF STRING[9]; END_STRUCT; END_TYPE
VAR_GLOBAL kept : STRING[19] := 'a long secret'; END_VAR
FUNCTION Remember : LREAL
VAR row : ARRAY[1..40] OF LREAL; k : INT; END_VAR
FOR k := 1 TO 40 DO row[k] := 1.0E300; END_FOR;
Remember := row[7];
END_FUNCTION
FUNCTION Say : LINT
VAR text : STRING[19]; END_VAR
text := 'hi';
Say := CHANNEL_WRITE('local', text);
END_FUNCTION
PROGRAM Main
VAR note : Note; x : LREAL; END_VAR
note.wide := \"wide\"; note.texts[1] := 'confident'; note.texts[2] := 'full text';
note.wide := \"w\"; note.texts[1] := 'c';
kept := 'a';
x := Remember();
Say();
CHANNEL_WRITE('kept', kept);
CHANNEL_WRITE('note', note);
END_PROGRAM
CONFIGURATION Plant
TASK often (INTERVAL := T#10ms, PRIORITY := 1);
PROGRAM one WITH often : Main;
END_CONFIGURATION
",
    );
    folder.write(
        "t.st",
        "TEST 'tails'
VAR text : ARRAY[0..19] OF BYTE; note : ARRAY[0..31] OF BYTE; copy : Note; k : INT; END_VAR
RUN(T#5ms);
ASSERT(CHANNEL_READ('kept', text) = 20);
ASSERT(text[0] = 16#61);
FOR k := 1 TO 19 DO ASSERT(text[k] = 0, 'kept'); END_FOR;
ASSERT(CHANNEL_READ('local', text) = 20);
ASSERT(text[1] = 16#69);
FOR k := 2 TO 19 DO ASSERT(text[k] = 0, 'local'); END_FOR;
ASSERT(CHANNEL_READ('note', note) = 32);
ASSERT(note[2] = 16#77 AND note[12] = 16#63);
FOR k := 4 TO 11 DO ASSERT(note[k] = 0, 'wide'); END_FOR;
FOR k := 13 TO 21 DO ASSERT(note[k] = 0, 'first'); END_FOR;
ASSERT(note[22] = 16#66 AND note[30] = 16#74 AND note[31] = 0);
END_TEST
",
    );
    folder.takt_plc(&["test", "main.st", "t.st"]).expect(0, "ok     t.st:1: tails");
}
