//! Programs in Structured Text, from source to a test on this machine, as a user goes that way.

mod common;

use common::Folder;

/// A program, run each 100 ms.
fn project(variables: &str, body: &str) -> String {
    format!(
        "PROGRAM Main\nVAR\n{variables}\nEND_VAR\n{body}\nEND_PROGRAM\nCONFIGURATION Plant\n\
         TASK often (INTERVAL := T#100ms, PRIORITY := 1);\nPROGRAM one WITH often : Main;\n\
         END_CONFIGURATION\n"
    )
}

#[test]
fn a_project_is_made_checked_built_inspected_and_tested() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "st"]).expect(0, "tank");
    folder.takt_plc(&["check", "tank"]).expect(0, "");
    let built = folder.takt_plc(&["build", "tank", "-o", "tank.plc"]);
    built.expect(0, "tank.plc: tank 0.1.0").expect(0, "2 tasks, 7 points");
    let shown = folder.takt_plc(&["inspect", "tank.plc"]);
    let shown = shown.expect(0, "every 10 ms, priority 0, budget 500 us");
    for (name, place, ty, flags) in [
        ("level", "%IB0", "REAL", "input forceable"),
        ("alarm", "%QX4.0", "BOOL", "output forceable"),
        ("setpoint", "state+", "REAL", "retain forceable"),
        ("control", "state+", "Control", "forceable"),
    ] {
        let words: Vec<&str> = shown
            .text
            .lines()
            .map(|line| line.split_whitespace().collect::<Vec<_>>())
            .find(|words| words.first() == Some(&name))
            .unwrap_or_else(|| panic!("no {name}: {}", shown.text));
        assert!(words[1].starts_with(place), "{words:?}");
        assert_eq!((words[2], words[3..].join(" ").as_str()), (ty, flags));
    }
    let table = "tank/tests/tank.csv";
    folder.takt_plc(&["test", "tank.plc", table]).expect(0, "21 cycles, 210 ms");
    // The timer of the alarm and the state of the controller are seen from outside.
    folder
        .write("inside.csv", "level,enable,watch.too_high.Q,control.controller.sum\n1,1,0,0.005\n");
    folder.takt_plc(&["test", "tank.plc", "inside.csv"]).expect(0, "all as expected");
    let text = String::from_utf8(folder.read(table)).unwrap();
    folder.write("wrong.csv", &text.replace("0.1055", "0.1155"));
    let ended = folder.takt_plc(&["test", "tank.plc", "wrong.csv"]);
    ended.expect(1, "line 5: valve is 0.1055").expect(1, "expected 0.1155");
}

/// Variables of programs and function blocks are retained one by one. Those of an instance that is retained as a whole are
/// not in the table again.
#[test]
fn what_is_retained_of_an_instance_is_in_the_table_part_by_part() {
    let folder = Folder::new();
    let blocks = "FUNCTION_BLOCK Mixer
VAR RETAIN count : DINT; END_VAR
VAR PERSISTENT hours : DINT; END_VAR
VAR plain : DINT; END_VAR
count := count + 1; hours := hours + 1; plain := plain + 1;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Plain
VAR n : DINT; END_VAR
n := n + 1;
END_FUNCTION_BLOCK
VAR_GLOBAL RETAIN whole : Plain; mixed : Mixer; END_VAR
";
    let program = "VAR a : INT; END_VAR\nVAR RETAIN b : INT; END_VAR\nVAR row : ARRAY[3..4] OF Mixer; plain : Plain;";
    let text = project("", "whole(); mixed(); row[3](); plain(); a := a + 1; b := a;");
    let text = text.replace("VAR\n\nEND_VAR", &format!("{program} END_VAR"));
    folder.write("main.st", &format!("{blocks}{text}"));
    folder.takt_plc(&["build", "main.st", "-o", "p.plc"]).expect(0, "1 tasks, 3 points");
    let shown = folder.takt_plc(&["inspect", "p.plc"]).expect(0, "").text;
    let kept = shown.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
    let kept: Vec<(String, String)> = kept
        .filter(|words| words.iter().any(|word| ["retain", "persistent"].contains(word)))
        .map(|words| (words[0].to_owned(), words[3..].join(" ")))
        .collect();
    let expected = [
        ("mixed.count", "retain part"),
        ("mixed.hours", "persistent part"),
        ("mixed.plain", "retain part"),
        ("one.b", "retain part"),
        ("one.row[3].count", "retain part"),
        ("one.row[3].hours", "persistent part"),
        ("one.row[4].count", "retain part"),
        ("one.row[4].hours", "persistent part"),
        ("whole", "retain forceable"),
    ];
    assert_eq!(kept, expected.map(|(name, flags)| (name.to_owned(), flags.to_owned())), "{shown}");
    // To be retained or not is no other layout of the state: nothing moves.
    folder.write("main.st", &format!("{blocks}{text}").replace("VAR RETAIN b", "VAR b"));
    folder.takt_plc(&["build", "main.st", "-o", "q.plc"]).expect(0, "");
    let diff = folder.takt_plc(&["diff", "p.plc", "q.plc"]).expect(0, "kept         3 more");
    assert!(!diff.text.contains("one.b"), "{}", diff.text);
}

#[test]
fn two_builds_of_a_source_are_equal_and_another_source_is_not() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "st"]).expect(0, "");
    let mut images = Vec::new();
    for _ in 0..2 {
        folder.takt_plc(&["build", "tank"]).expect(0, "tank.plc: tank");
        images.push(folder.read("tank.plc"));
        std::fs::remove_file(folder.path().join("tank.plc")).unwrap();
    }
    assert!(images[0] == images[1]);
    let source = String::from_utf8(folder.read("tank/main.st")).unwrap();
    folder.write("tank/main.st", &source.replace("RATE := 0.5", "RATE := 0.25"));
    folder.takt_plc(&["build", "tank"]).expect(0, "");
    assert!(images[0] != folder.read("tank.plc"));
}

#[test]
fn a_trap_is_told_with_its_line() {
    let folder = Folder::new();
    let variables = "i AT %IW0 : INT; q AT %QW0 : INT; row : ARRAY[1..3] OF INT := [5, 6, 7];\n\
                     small : INT (0..9); none : REF_TO INT; long : ARRAY[1..200] OF INT;";
    let body = "CASE i OF\n1: q := 10 / (i - 1);\n2: q := row[i + 2];\n3: small := i * 4;\n\
                4: q := none^;\n5: WHILE i > 0 DO\n;\nEND_WHILE;\n6: q := last(long);\nELSE q := row[1]; END_CASE;";
    let last = "FUNCTION last : SINT\nVAR_IN_OUT row : ARRAY[*] OF INT; END_VAR\n\
                last := UPPER_BOUND(row, 1);\nEND_FUNCTION\n";
    folder.write("main.st", &(project(variables, body) + last));
    folder.takt_plc(&["build", "main.st"]).expect(0, "main.plc: main");
    for (input, says) in [
        (1, "main.st:7: division by zero (task often, job 1, at 100 ms)"),
        (2, "main.st:8: index out of bounds"),
        (3, "main.st:9: value out of its subrange"),
        (4, "main.st:10: null reference"),
        (5, "main.st:11: a loop made too many rounds"),
        (6, "main.st:23: value out of its subrange"),
    ] {
        folder.write("t.csv", &format!("Main.i,Main.q\n0,5\n{input},\n"));
        let ended = folder.takt_plc(&["test", "main.plc", "t.csv", "--time-limit", "60000"]);
        ended.expect(3, says);
    }
}

#[test]
fn a_mistake_is_told_as_check_tells_it_and_leaves_no_image() {
    let folder = Folder::new();
    folder.write("main.st", &project("level : INT;", "levl := 3;"));
    let built = folder.takt_plc(&["build", "main.st"]);
    let built = built.expect(2, "error[unknown-name]: main.st:5:1: ");
    let checked = folder.takt_plc(&["check", "main.st"]).expect(2, "1 error,");
    assert_eq!(built.text, checked.text);
    folder
        .takt_plc(&["build", "main.st", "--message-format", "json"])
        .expect(2, "\"code\":\"unknown-name\"");
    assert!(!folder.path().join("main.plc").exists());
    folder.write("alone.st", "FUNCTION f : INT\nf := 1;\nEND_FUNCTION\n");
    folder.takt_plc(&["build", "alone.st"]).expect(2, "nothing runs a program");
}

#[test]
fn what_cannot_be_built_together_or_named_is_refused() {
    let folder = Folder::new();
    folder.write("main.st", &project("level : INT;", "level := 3;"));
    folder.write("a.o", "!<arch>\n");
    folder.takt_plc(&["build", "main.st", "a.o"]).expect(2, "one or the other");
    folder.takt_plc(&["build", "a.o"]).expect(2, "-o IMAGE");
    folder.takt_plc(&["build", "a.o", "--emit", "ir"]).expect(2, "for Structured Text");
    folder.takt_plc(&["build", "main.st", "-o", "two words.plc"]).expect(2, "found `two words`");
    folder.takt_plc(&["build", "none.st"]).expect(2, "none.st: cannot be read");
}

#[test]
fn stages_of_the_compiler_are_shown() {
    let folder = Folder::new();
    folder.write("main.st", &project("level : INT;", "level := level + 3;"));
    folder.takt_plc(&["build", "main.st", "--emit", "types"]).expect(0, "this.level + INT#3");
    folder.takt_plc(&["build", "main.st", "--emit", "ir"]).expect(0, "iadd");
    let words = folder.takt_plc(&["build", "main.st", "--emit", "tokens"]);
    words.expect(0, "3:1 Identifier level\n").expect(0, "5:7 Sign(Assign) :=");
    folder.takt_plc(&["build", "main.st", "--emit", "ast"]).expect(0, "kind: Program");
    folder.takt_plc(&["build", "main.st", "--emit", "asm"]).expect(0, "pushq %rbp");
    folder.write("wrong.st", "PROGRAM Main\nx := ;\nEND_PROGRAM\n");
    folder.takt_plc(&["build", "wrong.st", "--emit", "ast"]).expect(2, "wrong.st:2:6");
    assert!(!folder.path().join("main.plc").exists());
}

#[test]
fn the_instructions_of_a_job_are_bounded_or_the_loop_without_a_bound_is_named() {
    let folder = Folder::new();
    let source = "PROGRAM Short
VAR i, sum : DINT; name : STRING; END_VAR
FOR i := 1 TO 9 DO sum := sum + i; END_FOR;
name := 'short';
END_PROGRAM
PROGRAM Long
VAR n : DINT; END_VAR
n := 1000;
WHILE n > 0 DO
  n := n - 3;
END_WHILE;
END_PROGRAM
CONFIGURATION c
TASK often (INTERVAL := T#10ms, PRIORITY := 1);
TASK seldom (INTERVAL := T#1s, PRIORITY := 2);
PROGRAM a WITH often : Short;
PROGRAM b WITH seldom : Long;
END_CONFIGURATION
";
    folder.write("main.st", source);
    let shown = folder.takt_plc(&["inspect", "main.st"]);
    let shown = shown.expect(0, "no bound: the rounds of the loop at main.st:9 are not known");
    shown.expect(0, "without those of functions for strings, copies and reals (calls: 1)");
    let shown = folder.takt_plc(&["inspect", "main.st", "--json"]).expect(0, "\"main.st:9\"");
    let start = shown.text.find('{').expect("JSON");
    let shown: serde_json::Value = serde_json::from_str(&shown.text[start..]).expect("JSON");
    let often = shown["tasks"][0]["instructions"].as_u64().expect("a number");
    assert!((9 * 3..9 * 10).contains(&often), "{shown}");
    assert_eq!(shown["tasks"][1]["instructions"], serde_json::Value::Null);

    folder.write("a.plc", "no image");
    folder.takt_plc(&["inspect", "a.plc", "main.st"]).expect(2, "one image, or sources");
}

#[test]
fn a_project_of_plcopen_is_imported_built_and_tested() {
    let folder = Folder::new();
    let project = r#"<project><types><pous><pou name="Doubler" pouType="program"><interface><localVars>
<variable name="measured" address="%IW0"><type><INT/></type></variable>
<variable name="doubled" address="%QW0"><type><INT/></type></variable>
</localVars></interface><body><ST>doubled := 2 * measured;</ST></body></pou></pous></types>
<instances><configurations><configuration name="Plant"><resource name="Cpu">
<task name="often" priority="1" interval="T#20ms"><pouInstance name="one" typeName="Doubler"/></task>
</resource></configuration></configurations></instances></project>"#;
    folder.write("plant.xml", project);
    folder.takt_plc(&["import", "plant.xml", "plant"]).expect(0, "plant/Doubler.st");
    folder.takt_plc(&["build", "plant", "-o", "plant.plc"]).expect(0, "plant.plc: plant");
    folder.takt_plc(&["inspect", "plant.plc"]).expect(0, "every 20 ms");
    folder.write("t.csv", "Doubler.measured,Doubler.doubled\n4,8\n-3,-6\n");
    folder.takt_plc(&["test", "plant.plc", "t.csv"]).expect(0, "2 cycles, 40 ms");
}

#[test]
fn what_is_as_deep_as_allowed_is_built() {
    let folder = Folder::new();
    let sum = "a + ".repeat(240);
    let calls = format!("{}r{}", "SIN(".repeat(95), ")".repeat(95));
    let blocks = format!("{}a := {sum}a;{}", "IF a < 3 THEN ".repeat(98), " END_IF;".repeat(98));
    let text = project("a : DINT; r : LREAL;", &format!("{blocks}\nr := {calls};"));
    folder.write("main.st", &text);
    folder.takt_plc(&["build", "main.st"]).expect(0, "main.plc: main");
    folder.takt_plc(&["build", "main.st", "--emit", "ir"]).expect(0, "function");
    folder.takt_plc(&["test", "main.plc"]).expect(0, "1 cycles");
}

/// Whole programs with structures, enumerations, references, strings, timers and a controller; the tables were
/// worked out by hand.
#[test]
fn larger_programs_do_what_was_worked_out() {
    let folder = Folder::new();
    for (name, source, table, cycles) in [
        ("lights", include_str!("programs/lights.st"), include_str!("programs/lights.csv"), 17),
        ("batch", include_str!("programs/batch.st"), include_str!("programs/batch.csv"), 17),
    ] {
        folder.write(&format!("{name}.st"), source);
        folder.write("t.csv", table);
        folder.takt_plc(&["build", &format!("{name}.st")]).expect(0, ".plc: ");
        let ended = folder.takt_plc(&["test", &format!("{name}.plc"), "t.csv"]);
        ended.expect(0, &format!("{cycles} cycles"));
    }
}

#[test]
fn durations_in_tables_are_written_as_in_the_source() {
    let folder = Folder::new();
    let variables = "pause AT %IL0 : TIME; twice AT %QL0 : LTIME;";
    folder.write("main.st", &project(variables, "twice := pause + pause;"));
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    folder.write("t.csv", "Main.pause,Main.twice\nT#1.5s,LT#3s\nT#-20ms,T#-40ms\n7,14\n");
    folder.takt_plc(&["test", "main.plc", "t.csv"]).expect(0, "3 cycles");
    folder.write("t.csv", "Main.pause,Main.twice\nT#1.5s,T#4s\n-7,T#0s\n");
    let ended = folder.takt_plc(&["test", "main.plc", "t.csv"]);
    ended.expect(1, "is T#3s, expected T#4s").expect(1, "is T#-14ns, expected T#0ns");
    for wrong in ["5ms", "T#", "T#5", "T#5x", "X#1s", "D#2026-01-01", "T#99999999999999999999s"] {
        folder.write("t.csv", &format!("Main.pause\n{wrong}\n"));
        let ended = folder.takt_plc(&["test", "main.plc", "t.csv"]);
        ended.expect(2, &format!("line 2, column 1: found `{wrong}`; a duration is"));
    }
}

/// Each instance of a block has its own inputs and outputs: VAR_CONFIG places them, or the compiler.
#[test]
fn instances_of_blocks_have_inputs_and_outputs_where_var_config_places_them() {
    let folder = Folder::new();
    folder.write(
        "main.st",
        "FUNCTION_BLOCK Doubler
VAR source AT %I* : INT; target AT %Q* : INT := 7; END_VAR
IF source <> 0 THEN target := 2 * source; END_IF;
END_FUNCTION_BLOCK
TYPE Unit : STRUCT number : INT; inner : Doubler; END_STRUCT; END_TYPE
PROGRAM Main
VAR one : Doubler; more : ARRAY[1..2] OF Doubler; units : ARRAY[1..2] OF Unit; total AT %Q* : INT; END_VAR
one(); more[1](); more[2](); units[2].inner();
total := total + 1;
END_PROGRAM
CONFIGURATION Plant
VAR_CONFIG
    Main1.one.source AT %IW1 : INT;
    Main1.one.target AT %QW2 : INT;
    Main1.more[2].target AT %QW3 : INT;
    Main1.total AT %QW0 : INT;
END_VAR
TASK t (INTERVAL := T#1ms, PRIORITY := 1);
PROGRAM Main1 WITH t : Main;
END_CONFIGURATION
",
    );
    folder.takt_plc(&["fmt", "main.st"]).expect(0, "main.st");
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    let shown = folder.takt_plc(&["inspect", "main.plc"]);
    let shown = shown.expect(0, "Main1.one.source     %IB2").expect(0, "Main1.one.target     %QB4");
    let shown = shown.expect(0, "Main1.more[2].target %QB6").expect(0, "Main.total           %QB0");
    shown.expect(0, "Main1.more[1].source %IB4").expect(0, "Main1.more[1].target %QB8");
    folder.write(
        "t.csv",
        "Main1.one.source,Main1.more[1].source,Main1.one.target,Main1.more[1].target,Main1.more[2].target,Main.total,\
         Main1.units[2].inner.source,Main1.units[2].inner.target\n\
         0,0,7,7,7,1,0,7\n3,0,6,7,7,2,4,8\n0,5,6,10,7,3,0,8\n",
    );
    folder.takt_plc(&["test", "main.plc", "t.csv"]).expect(0, "as expected");
}

/// Blocks and functions are called by several tasks, and each call is of the task that it runs in.
#[test]
fn each_task_has_its_own_release_interval_and_count() {
    let folder = Folder::new();
    folder.write(
        "m.st",
        "FUNCTION Interval : LINT
Interval := TIME_TO_LINT(RELEASE_INTERVAL()) / 1000000;
END_FUNCTION
VAR_GLOBAL seldom_ms, often_ms, seldom_count, often_count, seldom_at_ms, often_at_ms : LINT; END_VAR
PROGRAM Seldom
seldom_ms := Interval();
seldom_count := ULINT_TO_LINT(RELEASE_COUNT());
seldom_at_ms := TIME_TO_LINT(RELEASE_TIME()) / 1000000;
END_PROGRAM
PROGRAM Often
often_ms := Interval();
often_count := ULINT_TO_LINT(RELEASE_COUNT());
often_at_ms := TIME_TO_LINT(RELEASE_TIME()) / 1000000;
END_PROGRAM
CONFIGURATION c
TASK first (INTERVAL := T#10ms, PRIORITY := 5);
TASK second (INTERVAL := T#2ms, PRIORITY := 0);
PROGRAM x WITH first : Seldom;
PROGRAM y WITH second : Often;
END_CONFIGURATION
",
    );
    folder.takt_plc(&["build", "m.st", "-o", "m.plc"]).expect(0, "2 tasks");
    // A row is 2 ms.
    let table = "seldom_ms, often_ms, seldom_count, often_count, seldom_at_ms, often_at_ms
0,  0, 0, 0,  0,  0
0,  2, 0, 1,  0,  2
0,  2, 0, 2,  0,  4
0,  2, 0, 3,  0,  6
0,  2, 0, 4,  0,  8
10, 2, 1, 5, 10, 10
10, 2, 1, 6, 10, 12
";
    folder.write("m.csv", table);
    folder.takt_plc(&["test", "m.plc", "m.csv"]).expect(0, "all as expected");
}
