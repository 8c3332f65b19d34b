//! What does not fit into an image is refused by name.

mod common;

use common::Folder;

const HEAD: &str = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\n";
const RUN: &str = "static void run(const takt_job *job) { (void)job; }\n\
                   TAKT_CYCLIC(run, .period = TAKT_MS(1));\n";

/// The error for a program that has `more`.
fn refused(more: &str, says: &[&str]) {
    let mut ended = Folder::new().c_program("p", &format!("{HEAD}{more}\n{RUN}"));
    for text in says {
        ended = ended.expect(2, text);
    }
}

#[test]
fn constructors_are_refused_with_their_names() {
    let source = "__attribute__((constructor)) static void early(void) { takt_log(\"x\"); }";
    refused(source, &["static constructors: early", "TAKT_INIT"]);
}

#[test]
fn thread_local_variables_are_refused_with_their_names() {
    refused(
        "_Thread_local int counter = 1; int *where(void) { return &counter; }\n\
         static void b(const takt_job *j) { (void)j; *where() = 2; }\n\
         TAKT_CYCLIC(b, .period = TAKT_MS(2));",
        &["thread-local variables: counter"],
    );
}

#[test]
fn unresolved_symbols_are_refused_with_their_names() {
    let source = "double sqrt(double); double x; void *malloc(size_t);\n\
                  static void b(const takt_job *j) { (void)j; x = sqrt(x); malloc(3); }\n\
                  TAKT_CYCLIC(b, .period = TAKT_MS(2));";
    refused(source, &["malloc (p.c:4), sqrt (p.c:4)", "no C library", "takt_math.c"]);
}

#[test]
fn sections_of_an_unknown_kind_are_refused() {
    let source = "__attribute__((section(\"mine\"), used)) int x = 1;\n\
                  static void b(const takt_job *j) { (void)j; *(volatile int *)&x = 2; }\n\
                  TAKT_CYCLIC(b, .period = TAKT_MS(2));";
    refused(source, &["section mine"]);
}

#[test]
fn writable_code_is_refused() {
    let source = "__asm__(\".section .text.w,\\\"awx\\\",@progbits\\n.globl w\\nw: ret\\n.text\");\n\
                  extern void w(void); static void b(const takt_job *j) { (void)j; w(); }\n\
                  TAKT_CYCLIC(b, .period = TAKT_MS(2));";
    refused(source, &["p.o: section .text.w is writable and executable"]);
}

#[test]
fn declarations_that_break_a_rule_are_refused() {
    refused(
        "TAKT_OUTPUT(REAL, level, 65533);",
        &["p.c:3: point `level`", "in no memory of the program"],
    );
    refused(
        "static void b(const takt_job *j) { (void)j; } TAKT_CYCLIC(b, .priority = 3);",
        &["p.c:3: task `b`, period: a cyclic task has a period"],
    );
    refused(
        "static void b(const takt_job *j) { (void)j; } TAKT_EVENT(b, \"sun:rise\", .period = 1);",
        &["task `b`", "`sun:rise`", "allowed are channel:"],
    );
    refused(
        "TAKT_QUEUE(jobs, 5000, 1);",
        &["p.c:3: object `jobs`, message bytes: found 5000, the limit is 4096"],
    );
}

#[test]
fn an_output_has_one_writer() {
    let two = "static void b(const takt_job *j) { (void)j; } TAKT_CYCLIC(b, .period = 9);\n\
               TAKT_OUTPUT(REAL, y, 0);";
    refused(two, &["output `y`", "say which one writes it (TAKT_WRITES"]);
    refused(&format!("{two} TAKT_WRITES(c, y);"), &["point `y`: there is no task `c`"]);
    refused(&format!("{two} TAKT_WRITES(b, y); TAKT_WRITES(b, z);"), &["point `z`: task `b`"]);
    let folder = Folder::new();
    folder.c_program("p", &format!("{HEAD}{two} TAKT_WRITES(b, y);\n{RUN}")).expect(0, "");
    folder.takt_plc(&["inspect", "p.plc", "--json"]).expect(0, "\"writer\": \"b\"");
    folder.c_program("q", &format!("{HEAD}TAKT_OUTPUT(REAL, y, 0);\n{RUN}")).expect(0, "");
    folder.takt_plc(&["inspect", "q.plc", "--json"]).expect(0, "\"writer\": \"run\"");
}

#[test]
fn a_program_declares_itself() {
    let ended = Folder::new().c_program("p", "#include \"takt.h\"\nint x;\n");
    ended.expect(2, "no program is declared");
}

#[test]
fn what_is_no_object_file_is_refused() {
    let folder = Folder::new();
    folder.write("x.o", "nonsense");
    folder.takt_plc(&["build", "x.o", "-o", "x.plc"]).expect(2, "x.o: found text in a file");
    folder.takt_plc(&["build", "y.o", "-o", "x.plc"]).expect(2, "y.o: cannot be read");
}

#[test]
fn what_a_generator_of_c_emits_is_linked() {
    let folder = Folder::new();
    // Globals with initial values in several files, doubles, structures that are copied, function tables, and
    // position-independent code.
    folder.write("lib.c", "struct big { double x[40]; }; struct big a = {{1, 2}}, b;\nvoid copy(void) { b = a; }\ndouble second(void) { return b.x[1]; }\n");
    let flags =
        ["-O2", "-fPIC", "-ffreestanding", "-fno-stack-protector", "-c", "lib.c", "-o", "lib.o"];
    folder.run("gcc", &flags).expect(0, "");
    folder.run("ar", &["rcs", "lib.a", "lib.o"]).expect(0, "");
    let main = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\nTAKT_OUTPUT(LREAL, y, 0);\n\
                void copy(void); double second(void);\n\
                static double (*const table[])(void) = { second };\n\
                int row[3] = { 1, 2, 3 }; TAKT_POINT(DINT, row, TAKT_FORCEABLE);\n\
                static void run(const takt_job *job) { copy(); y = table[job->task]() + row[2]; }\n\
                TAKT_CYCLIC(run, .period = TAKT_MS(1));\n";
    folder.c_program_with("p", main, &["-fPIC"]).expect(2, "copy (p.c:7), second");
    let words = ["build", "p.o", "takt.o", "lib.a", "-o", "p.plc"];
    folder.takt_plc(&words).expect(0, "");
    folder.write("t.csv", "y,row[2],set row[2]\n5,3,\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "");
    folder.write("t.csv", "y,set row[2]\n5.5,3\n7,5\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(1, "line 2: y is 5, expected 5.5");
}

#[test]
fn what_a_linker_takes_but_a_program_cannot_use_is_refused() {
    let b = "static void b(const takt_job *j) { (void)j; result = f(); }\n\
             TAKT_CYCLIC(b, .period = TAKT_MS(2));";
    let weak = "extern int f(void) __attribute__((weak)); int result;";
    refused(&format!("{weak}{b}"), &["weak and nowhere defined: f;"]);
    let chosen = "static int one(void) { return 1; } static int (*choose(void))(void) { return one; }\n\
                  int f(void) __attribute__((ifunc(\"choose\"))); int result;";
    refused(&format!("{chosen}{b}"), &["chosen when it is loaded (ifunc): f;"]);
    let folder = Folder::new();
    folder.write("f.c", "int f(void) { return 1; }\n");
    folder.run("gcc", &["-flto", "-c", "f.c", "-o", "later.o"]).expect(0, "");
    folder.run("gcc", &["-c", "f.c"]).expect(0, "");
    folder.run("ar", &["rcsT", "thin.a", "f.o"]).expect(0, "");
    folder.run("ar", &["rcs", "later.a", "later.o"]).expect(0, "");
    folder.write("script.a", "/* GNU ld script\n*/\nGROUP ( /lib/libm-2.36.a )\n");
    let build = |input: &str| folder.takt_plc(&["build", input, "-o", "x.plc"]);
    build("later.o").expect(2, "later.o has no code, only what gcc or clang keep for link-time");
    build("later.a").expect(2, "later.a has no code");
    build("thin.a").expect(2, "thin.a is a thin archive");
    build("script.a").expect(2, "a script for a linker");
}

#[test]
fn names_that_linkers_take_for_options_are_files() {
    let folder = Folder::new();
    folder.c_program("p", &format!("{HEAD}{RUN}")).expect(0, "");
    std::fs::copy(folder.path().join("p.o"), folder.path().join("@p.o")).unwrap();
    std::fs::copy(folder.path().join("p.o"), folder.path().join("-p.o")).unwrap();
    folder.takt_plc(&["build", "@p.o", "takt.o", "-o", "q.plc"]).expect(0, "");
    folder.takt_plc(&["build", "-o", "q.plc", "--", "-p.o", "takt.o"]).expect(0, "");
}

#[test]
fn an_input_is_not_overwritten() {
    let folder = Folder::new();
    folder.c_program("p", &format!("{HEAD}{RUN}")).expect(0, "");
    let words = ["build", "p.o", "takt.o", "-o", "./p.o"];
    folder.takt_plc(&words).expect(2, "p.o would be overwritten");
    assert!(folder.read("p.o").starts_with(b"\x7FELF"));
}

#[test]
fn two_tasks_write_no_bit_in_common() {
    let tasks = "static void b(const takt_job *j) { (void)j; } TAKT_CYCLIC(b, .period = TAKT_MS(9));\n\
                 TAKT_WRITES(b, two); TAKT_WRITES(run, one);";
    let common = [
        "TAKT_OUTPUT(REAL, one, 0); TAKT_OUTPUT(DINT, two, 2);",
        "TAKT_OUTPUT(REAL, one, 0); TAKT_OUTPUT_BIT(two, 3, 7);",
        "TAKT_OUTPUT_BIT(one, 3, 7); TAKT_OUTPUT_BIT(two, 3, 7);",
    ];
    for outputs in common {
        refused(
            &format!("{outputs}{tasks}"),
            &["p.c:3: output `one`, which task `run`", "`two`", "a bit in common"],
        );
    }
    for outputs in [
        "TAKT_OUTPUT(REAL, one, 0); TAKT_OUTPUT_BIT(two, 4, 0);",
        "TAKT_OUTPUT_BIT(one, 3, 6); TAKT_OUTPUT_BIT(two, 3, 7);",
    ] {
        let ended = Folder::new().c_program("p", &format!("{HEAD}{outputs}{tasks}\n{RUN}"));
        ended.expect(0, "");
    }
}
