//! Each linker that is looked for makes the same program, and refuses the same.

mod common;

use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use common::Folder;

const SOURCE: &str = "#include \"takt.h\"
    TAKT_PROGRAM(\"p\", 1, 0, 0, 0);
    TAKT_INPUT(DINT, number, 4);
    TAKT_OUTPUT(DINT, result, 4);
    static int one(void) { return 1; }
    static int two(void) { return 2; }
    static int (*const table[])(void) = { one, two };
    static int counter = 40, zero;
    static void run(const takt_job *job) {
        (void)job;
        result = table[number & 1]() + counter++ + zero;
    }
    TAKT_CYCLIC(run, .period = TAKT_MS(1));";

/// Folders that have only one linker each, and `rustc`.
fn paths(folder: &Folder) -> Vec<PathBuf> {
    let found = |name: &str| {
        let path = std::env::var_os("PATH").unwrap();
        std::env::split_paths(&path).map(|dir| dir.join(name)).find(|file| file.is_file())
    };
    let rustc = found("rustc").unwrap();
    let sysroot = Command::new(&rustc).args(["--print", "sysroot"]).output().unwrap().stdout;
    let sysroot = String::from_utf8(sysroot).unwrap();
    let lld = Path::new(sysroot.trim()).join("lib/rustlib/x86_64-unknown-linux-gnu/bin/rust-lld");
    let mut paths = Vec::new();
    let mut path = |name: &str, links: &[(&Path, &str)]| {
        let path = folder.path().join(name);
        std::fs::create_dir(&path).unwrap();
        links.iter().for_each(|(to, name)| symlink(to, path.join(name)).unwrap());
        paths.push(path);
    };
    path("gnu", &[(&found("ld").unwrap(), "ld")]);
    path("rust", &[(&rustc, "rustc")]);
    // LLVM's linker is the same program by another name.
    path("llvm", &[(&found("ld.lld").unwrap_or(lld), "ld.lld")]);
    paths
}

#[test]
fn each_linker_makes_a_program_that_runs() {
    let folder = Folder::new();
    folder.c_program("p", SOURCE).expect(0, "");
    folder.write("t.csv", "number,result\n0,41\n1,43\n");
    for path in paths(&folder) {
        let words = ["build", "p.o", "takt.o", "-o", "q.plc"];
        folder.takt_plc_with(&path, &words).expect(0, "");
        folder.takt_plc(&["test", "q.plc", "t.csv"]).expect(0, "");
    }
}

#[test]
fn each_linker_refuses_the_same() {
    let head =
        "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0); TAKT_OUTPUT(DINT, result, 0);\n";
    let run = |body: &str| {
        format!(
            "static void run(const takt_job *job) {{ (void)job; {body} }}\n\
             TAKT_CYCLIC(run, .period = TAKT_MS(1));\n"
        )
    };
    let programs = [
        (
            "_Thread_local int counter = 1; int *where(void) { return &counter; }",
            "result = *where();",
            "thread-local variables: counter",
        ),
        (
            "__attribute__((constructor)) static void early(void) { takt_log(\"x\"); }",
            "",
            "static constructors: early",
        ),
        ("int nowhere(void);", "result = nowhere();", "nowhere defined: nowhere"),
        (
            "static int noted __attribute__((section(\".note.mine\"))) = 5;",
            "result = noted++;",
            "section .note.mine",
        ),
        (
            "__attribute__((section(\".init\"), used)) static void early(void) {}",
            "",
            "a function in the section .init",
        ),
    ];
    let folder = Folder::new();
    let paths = paths(&folder);
    for (more, body, says) in programs {
        folder.c_program("p", &format!("{head}{more}\n{}", run(body))).expect(2, says);
        for path in &paths {
            let words = ["build", "p.o", "takt.o", "-o", "p.plc"];
            folder.takt_plc_with(path, &words).expect(2, says);
        }
    }
}

#[test]
fn constants_and_state_are_where_the_program_looks_for_them_whatever_their_alignment() {
    let source = "#include \"takt.h\"
        TAKT_PROGRAM(\"p\", 1, 0, 0, 0);
        TAKT_OUTPUT(LINT, constant, 0);
        TAKT_OUTPUT(LINT, variable, 8);
        TAKT_OUTPUT(LINT, counter, 16);
        const int64_t table[2] __attribute__((aligned(ALIGNMENT))) = { 11, 22 };
        int64_t state[2] __attribute__((aligned(ALIGNMENT))) = { 33, 44 };
        int64_t zero[2] __attribute__((aligned(ALIGNMENT)));
        static void run(const takt_job *job) {
            constant = ((const volatile int64_t *)table)[job->cycle & 1];
            variable = ((const volatile int64_t *)state)[job->cycle & 1];
            counter = ++zero[1];
        }
        TAKT_CYCLIC(run, .period = TAKT_MS(1));";
    let folder = Folder::new();
    let paths = paths(&folder);
    folder.write("t.csv", "constant,variable,counter\n11,33,1\n22,44,2\n");
    for alignment in ["8", "4096", "8192", "65536", "1048576"] {
        folder.c_program("p", &source.replace("ALIGNMENT", alignment)).expect(0, "");
        for path in &paths {
            let words = ["build", "p.o", "takt.o", "-o", "q.plc"];
            folder.takt_plc_with(path, &words).expect(0, "");
            folder.takt_plc(&["test", "q.plc", "t.csv"]).expect(0, "");
        }
    }
    // Only what is needed is filled.
    let built = folder.c_program("p", &source.replace("ALIGNMENT", "4096"));
    assert!(!built.text.contains(" 4096 bytes of code"), "{}", built.text);
    folder.c_program("p", &source.replace("ALIGNMENT", "8192")).expect(0, " 8192 bytes of code");
    let ended = folder.c_program("p", &source.replace("ALIGNMENT", "2097152"));
    ended.expect(2, "aligned to 2097152 bytes; allowed is up to 1048576").expect(2, "p.o: section");
}

const LOCATED: &str = "#include \"takt.h\"
    TAKT_PROGRAM(\"p\", 1, 0, 0, 0);
    TAKT_INPUT(DINT, a, 0);
    TAKT_INPUT(DINT, b, 4);
    TAKT_OUTPUT(DINT, x, 0);
    TAKT_OUTPUT(DINT, y, 4);
    TAKT_MARKER(DINT, m, 8);
    static void run(const takt_job *job) { (void)job; m = a; x = b; y = m; }
    TAKT_CYCLIC(run, .period = TAKT_MS(1));";

#[test]
fn position_independent_code_finds_its_inputs_and_outputs() {
    let folder = Folder::new();
    let paths = paths(&folder);
    folder.write("t.csv", "a,b,x,y\n1,2,2,1\n3,4,4,3\n");
    for flags in [&["-fPIC"], &["-fpic"], &["-fpie"], &["-fno-pic"], &["-O0"]] {
        folder.c_program_with("p", LOCATED, flags).expect(0, "");
        for path in &paths {
            let words = ["build", "p.o", "takt.o", "-o", "q.plc"];
            folder.takt_plc_with(path, &words).expect(0, "");
            folder.takt_plc(&["test", "q.plc", "t.csv"]).expect(0, "");
        }
    }
}

#[test]
fn an_offset_into_the_table_of_addresses_is_refused() {
    let source = LOCATED.replace(
        "TAKT_MARKER(DINT, m, 8);",
        "extern volatile int m; __asm__(\".set m, takt_marker + 8\");",
    );
    let folder = Folder::new();
    folder.c_program_with("p", &source, &["-fPIC"]).expect(2, "`takt_marker` plus an offset");
    folder.c_program_with("p", &source, &["-fno-pic"]).expect(0, "");
}
