//! What a test runs is what a PLC would run: at which times, with which outputs, and by which names.

mod common;

use common::Folder;

const TICKS: &str = "VAR_GLOBAL tick : BOOL; count, jobs : INT; END_VAR
PROGRAM Ticks tick := NOT tick; END_PROGRAM
PROGRAM Counts count := count + 1; END_PROGRAM
PROGRAM Always jobs := jobs + 1; END_PROGRAM
CONFIGURATION Plant
TASK often (INTERVAL := T#10ms, PRIORITY := 1);
TASK e (SINGLE := tick, INTERVAL := T#1ms, PRIORITY := 0);
PROGRAM a WITH often : Ticks; PROGRAM b WITH e : Counts; PROGRAM c : Always;
END_CONFIGURATION
";

const SUMS: &str = "VAR_GLOBAL level AT %ID0 : REAL; n : INT; END_VAR
PROGRAM A n := n + REAL_TO_INT(level); END_PROGRAM
CONFIGURATION Plant
TASK f (INTERVAL := T#1ms, PRIORITY := 1);
PROGRAM a WITH f : A;
END_CONFIGURATION
";

#[test]
fn each_event_in_a_long_time_releases_its_task() {
    let test = "TEST 'a second'
RUN(T#0s);
ASSERT(jobs = 0, 'no time for a job');
RUN(T#1s);
ASSERT(count = 50);
ASSERT(jobs = 100, 'one in each period');
END_TEST
";
    let folder = Folder::with_tests(TICKS, test);
    folder.takt_plc(&["test", "main.st", "t.st"]).expect(0, "1 tests, all as expected");
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    folder.write("t.csv", "count,jobs\n5,1\n10,2\n");
    let ended = folder.takt_plc(&["test", "main.plc", "t.csv", "--step", "100000"]);
    ended.expect(0, "2 cycles, 200 ms");
}

#[test]
fn a_program_without_a_task_runs_all_the_time() {
    let main = "VAR_GLOBAL jobs : INT; END_VAR
PROGRAM Always jobs := jobs + 1; END_PROGRAM
CONFIGURATION Plant
PROGRAM c : Always;
END_CONFIGURATION
";
    let test = "TEST 'a while'\nRUN(T#0s);\nRUN(T#5ms);\nASSERT(jobs = 5);\nEND_TEST\n";
    let folder = Folder::with_tests(main, test);
    folder.takt_plc(&["test", "main.st", "t.st"]).expect(0, "1 tests, all as expected");
}

#[test]
fn a_test_that_lets_no_time_pass_ends_at_the_limit() {
    let test = "TEST 'waits'\nWHILE TRUE DO\nRUN(T#0s);\nEND_WHILE;\nEND_TEST\n";
    let folder = Folder::with_tests(TICKS, test);
    let ended = folder.takt_plc(&["test", "main.st", "t.st", "--time-limit", "200"]);
    ended.expect(1, "did not end in time");
}

#[test]
fn an_output_of_two_tasks_is_refused_with_both_places() {
    let main = "VAR_GLOBAL n AT %QW0 : INT; END_VAR
PROGRAM A
n := n + 1;
END_PROGRAM
PROGRAM B
n := n + 1;
END_PROGRAM
CONFIGURATION Plant
TASK f (INTERVAL := T#1ms, PRIORITY := 1); TASK s (INTERVAL := T#9ms, PRIORITY := 2);
PROGRAM a WITH f : A; PROGRAM b WITH s : B;
END_CONFIGURATION
";
    let folder = Folder::with_tests(main, "TEST 'both'\nRUN(T#9ms);\nASSERT(n = 10);\nEND_TEST\n");
    for words in [&["check", "main.st"][..], &["build", "main.st"], &["test", "main.st", "t.st"]] {
        let ended = folder.takt_plc(words);
        let ended = ended.expect(2, "main.st:6:1: the tasks `f` and `s` both write the output `n`");
        ended.expect(2, "main.st:3:1: the task `f` writes here");
    }
}

#[test]
fn what_a_test_writes_is_no_second_writer() {
    let main = "VAR_GLOBAL n AT %QW0 : INT; m AT %QW2 : INT; END_VAR
PROGRAM A n := n + 1; END_PROGRAM
PROGRAM B m := m + 1; END_PROGRAM
CONFIGURATION Plant
TASK f (INTERVAL := T#1ms, PRIORITY := 1); TASK test (INTERVAL := T#1ms, PRIORITY := 2);
PROGRAM a WITH f : A; PROGRAM b WITH test : B;
END_CONFIGURATION
";
    // A task of the program may have the name `test`.
    let test = "TEST 'goes on'\nn := 7;\nRUN(T#2ms);\nASSERT(n = 9);\nASSERT(m = 2);\nEND_TEST\n";
    let folder = Folder::with_tests(main, test);
    folder.takt_plc(&["test", "main.st", "t.st"]).expect(0, "1 tests, all as expected");
}

#[test]
fn what_would_test_nothing_is_told() {
    let folder = Folder::with_tests(SUMS, "TEST 'nothing'\nRUN(T#2ms);\nEND_TEST\n");
    let ended = folder.takt_plc(&["test", "main.st", "t.st"]);
    ended.expect(0, "warning[no-effect]: t.st:1:6: a TEST without an assertion");
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    folder.write("t.csv", "level,n\n1.0,\n");
    folder.takt_plc(&["test", "main.plc", "t.csv"]).expect(2, "t.csv expects nothing");
}

#[test]
fn no_value_stands_in_a_column_without_a_name() {
    let folder = Folder::with_tests(SUMS, "");
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    folder.write("t.csv", "level,n,\n1.0,1,1\n");
    let ended = folder.takt_plc(&["test", "main.plc", "t.csv"]);
    ended.expect(2, "line 2, column 7: `1` in a column without a name");
    folder.write("t.csv", "level,n,,\n1.0,1,,\n");
    folder.takt_plc(&["test", "main.plc", "t.csv"]).expect(0, "all as expected");
}
