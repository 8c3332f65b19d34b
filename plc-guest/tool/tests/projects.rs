//! From an empty folder to a tested image, with the documented commands only. Needs cargo, gcc and make.

mod common;

use common::Folder;

#[test]
fn a_rust_project_is_made_built_inspected_and_tested() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "rust"]).expect(0, "tank");
    let target = ["--target", "x86_64-unknown-linux-gnu"];
    let words = ["build", "--release", "--offline", "--manifest-path", "tank/Cargo.toml"];
    folder.run("cargo", &[&words[..], &target].concat()).expect(0, "Finished");
    let library = "tank/target/x86_64-unknown-linux-gnu/release/libtank.a";
    folder.takt_plc(&["build", library, "-o", "tank.plc"]).expect(0, "2 tasks, 6 points");
    let shown = folder.takt_plc(&["inspect", "tank.plc"]).expect(0, "tank 0.1.0");
    let shown = shown.expect(0, "every 10 ms, priority 0, budget 500 us");
    shown.expect(0, "%IX4.0").expect(0, "retain forceable");
    let table = "tank/tests/tank.csv";
    folder.takt_plc(&["test", "tank.plc", table]).expect(0, "11 cycles, 110 ms");
    // All of its state is points, so it is changed while it runs.
    folder.takt_plc(&["diff", "tank.plc", "tank.plc"]).expect(0, "0 bytes in 0 steps");
}

#[test]
fn a_rust_program_without_unsafe_code_reaches_only_what_it_declares() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "safe", "--lang", "rust"]).expect(0, "");
    let source = "#![no_std]\n#![forbid(unsafe_code)]\nuse takt_sdk::{Cyclic, Job};\n\
        takt_sdk::program!(\"safe\", 1, 0, 0);\n\
        takt_sdk::input!(X: i32, \"x\", 4);\ntakt_sdk::marker!(pub M: i32, \"m\", 0);\n\
        takt_sdk::input_bit!(ON, \"on\", 8, 2);\ntakt_sdk::output_bit!(LAMP, \"lamp\", 4, 1);\n\
        takt_sdk::output!(Y: i32, \"y\", 0);\ntakt_sdk::point!(P: i32 = 1, \"p\");\n\
        takt_sdk::queue!(JOBS, \"jobs\", bytes = 4, depth = 2);\n\
        takt_sdk::task!(\"run\", run, Cyclic::DEFAULT);\n\
        fn run(_: &Job) {\n    LAMP.set(ON.get());\n    M.set(X.get());\n    Y.set(M.get() + P.get());\n}\n";
    folder.write("safe/src/lib.rs", source);
    let words = ["build", "--release", "--offline", "--manifest-path", "safe/Cargo.toml"];
    folder.run("cargo", &words).expect(0, "Finished");
    folder.takt_plc(&["build", "safe/target/release/libsafe.a", "-o", "p.plc"]).expect(0, "");
    folder.write("t.csv", "x,on,y,lamp\n3,1,4,1\n,0,4,0\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "all as expected");
    for (at, unsafe_code) in [
        ("takt_sdk::Input::<i32>::at(1 << 40)", "E0133"),
        ("takt_sdk::OutputBit::at(1 << 40, 0)", "E0133"),
        ("unsafe { takt_sdk::Input::<i32>::at(1 << 40) }", "usage of an `unsafe` block"),
    ] {
        folder.write("safe/src/lib.rs", &source.replace("X.get()", &format!("{at}.get().into()")));
        folder.run("cargo", &words).expect(101, unsafe_code);
    }
    // Nor does a macro lend its own.
    let lent = "takt_sdk::Input::<i32>::at(1 << 40).get() as usize";
    folder.write("safe/src/lib.rs", &source.replace("\"x\", 4", &format!("\"x\", {lent}")));
    folder.run("cargo", &words).expect(101, "E0133");
}

#[test]
fn a_rust_project_is_built_where_cargo_is_told_another_target_folder() {
    let folder = Folder::new();
    // As in the repository itself.
    std::fs::create_dir(folder.path().join(".cargo")).unwrap();
    folder.write(".cargo/config.toml", "[build]\ntarget = \"x86_64-unknown-linux-gnu\"\n");
    folder.takt_plc(&["new", "tank-2", "--lang", "rust"]).expect(0, "tank-2");
    folder.run("make", &["-C", "tank-2", "test"]).expect(0, "11 cycles, 110 ms");
}

#[test]
fn a_panic_in_rust_is_told_with_message_and_line() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "panics", "--lang", "rust"]).expect(0, "");
    let source = r#"#![no_std]
use takt_sdk::{Cyclic, Job};
takt_sdk::program!("panics", 1, 0, 0);
takt_sdk::input!(INDEX: u32, "index", 0);
takt_sdk::point!(ROW: [i32; 3] = [5, 6, 7], "row");
takt_sdk::output!(FOUND: i32, "found", 0);
takt_sdk::queue!(JOBS, "jobs", bytes = 4, depth = 2);
takt_sdk::flags!(A, "a");
takt_sdk::mailbox!(LAST, "last", bytes = 4);
takt_sdk::semaphore!(LOCK, "lock", ceiling = 0);
takt_sdk::init!(start);
takt_sdk::task!("run", run, Cyclic::DEFAULT);
fn start(_: &Job) {
    takt_sdk::call::log("hello");
}
fn run(_: &Job) {
    let value = ROW.get()[INDEX.get() as usize];
    JOBS.send(&value.to_le_bytes()).unwrap();
    let mut bytes = [0; 4];
    assert_eq!(JOBS.receive(&mut bytes, 0), Ok(4));
    LAST.write(&bytes).unwrap();
    assert_eq!(LAST.read(&mut bytes), Ok((4, true)));
    A.set(6).unwrap();
    assert_eq!(A.wait_any(3, 10), Ok(2));
    let locked = LOCK.with(0, || i32::from_le_bytes(bytes)).unwrap();
    FOUND.set(locked);
}
"#;
    folder.write("panics/src/lib.rs", source);
    let words = ["build", "--release", "--offline", "--manifest-path", "panics/Cargo.toml"];
    folder.run("cargo", &words).expect(0, "Finished");
    let library = "panics/target/release/libpanics.a";
    folder.takt_plc(&["build", library, "-o", "p.plc"]).expect(0, "");
    folder.write("good.csv", "index,found,row[2]\n0,5,7\n2,7,\n");
    folder.takt_plc(&["test", "p.plc", "good.csv"]).expect(0, "[0 ns init] hello");
    folder.write("bad.csv", "index\n3\n");
    let ended = folder.takt_plc(&["test", "p.plc", "bad.csv"]).expect(3, "the program gave up");
    ended.expect(3, "src/lib.rs:17: index out of bounds: the len is 3 but the index is 3");
}

#[test]
fn a_c_project_is_made_built_inspected_and_tested() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "c"]).expect(0, "tank");
    folder.run("make", &["-C", "tank", "test"]).expect(0, "11 cycles, 110 ms");
    folder.takt_plc(&["inspect", "tank/tank.plc", "--json"]).expect(0, "\"period_ns\": 10000000");
    let image = "tank/tank.plc";
    folder.takt_plc(&["diff", image, image]).expect(0, "0 bytes in 0 steps");
    folder.takt_plc(&["new", "tank", "--lang", "c"]).expect(2, "tank is there already");
    folder.takt_plc(&["new", "Tank 2", "--lang", "c"]).expect(2, "small letters");
}

#[test]
fn a_header_that_has_changed_makes_the_program_anew() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "p", "--lang", "c"]).expect(0, "");
    let source = "#include \"takt.h\"\n#include \"level.h\"\nTAKT_PROGRAM(\"p\", 0, 1, 0, 0);\n\
        TAKT_OUTPUT(DINT, level, 0);\nstatic void run(const takt_job *job) { (void)job; level = LEVEL; }\n\
        TAKT_CYCLIC(run, .period = TAKT_MS(10));\n";
    folder.write("p/tank.c", source);
    for level in ["1", "2"] {
        folder.write("p/level.h", &format!("#define LEVEL {level}\n"));
        folder.write("p/tests/tank.csv", &format!("level\n{level}\n"));
        folder.run("make", &["-C", "p", "test"]).expect(0, "1 cycles");
    }
    // One that is gone is in the way of nothing.
    folder.write("p/tank.c", &source.replace("#include \"level.h\"", "#define LEVEL 2"));
    std::fs::remove_file(folder.path().join("p/level.h")).unwrap();
    folder.run("make", &["-C", "p", "test"]).expect(0, "1 cycles");
}

#[test]
fn function_blocks_are_used_in_c() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "filter", "--lang", "c"]).expect(0, "");
    let source = r#"#include "takt.h"
#include "blocks.h"
TAKT_PROGRAM("filter", 0, 1, 0, 0);
TAKT_INPUT(LREAL, measured, 0);
TAKT_OUTPUT(LREAL, valve, 0);
static struct takt_pid level = {.tuning = {.proportional = 4.0, .high = 10.0}};
static void control(const takt_job *job) {
    valve = takt_pid_update(&level, 1.5, measured, job->period_ns);
}
TAKT_CYCLIC(control, .period = TAKT_MS(10));
"#;
    folder.write("filter/tank.c", source);
    folder.write("filter/tests/tank.csv", "measured,valve\n1,2\n0.5,4\n");
    folder.run("make", &["-C", "filter", "test"]).expect(0, "2 cycles, 20 ms");
}

#[test]
fn the_exact_functions_of_math_h_are_used_in_c() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "roots", "--lang", "c"]).expect(0, "");
    let source = r#"#include "takt.h"
#include <math.h>
TAKT_PROGRAM("roots", 0, 1, 0, 0);
TAKT_INPUT(LREAL, x, 0);
TAKT_INPUT(LREAL, y, 8);
TAKT_OUTPUT(LREAL, root, 0);
TAKT_OUTPUT(LREAL, whole, 8);
TAKT_OUTPUT(LREAL, up, 16);
TAKT_OUTPUT(LREAL, cut, 24);
TAKT_OUTPUT(LREAL, nearest, 32);
TAKT_OUTPUT(LREAL, rest, 40);
TAKT_OUTPUT(REAL, small, 48);
static void control(const takt_job *job) {
    (void)job;
    root = sqrt(fabs(x));
    whole = floor(x);
    up = ceil(x);
    cut = trunc(x);
    nearest = round(x);
    rest = fmod(x, y);
    small = fmodf((float)x, 0.5f) + fmaxf(fminf(sqrtf(4.0f), 3.0f), 1.0f);
}
TAKT_CYCLIC(control, .period = TAKT_MS(10));
"#;
    folder.write("roots/tank.c", source);
    let table = "x,y,root,whole,up,cut,nearest,rest,small\n\
                 6.25,4,2.5,6,7,6,6,2.25,2.25\n\
                 -2.25,-1,1.5,-3,-2,-2,-2,-0.25,1.75\n\
                 0.49999999999999994,1e-300,,0,1,0,0,,\n\
                 -2.5,1,,-3,-2,-2,-3,-0.5,2\n\
                 4503599627370497,10,67108864,4503599627370497,4503599627370497,4503599627370497,4503599627370497,7,2\n\
                 1e300,7,1e150,1e300,1e300,1e300,1e300,1,\n\
                 1e-310,3e-320,,0,1,0,0,,2\n";
    folder.write("roots/tests/tank.csv", table);
    folder.run("make", &["-C", "roots", "test"]).expect(0, "7 cycles");
    // A library's goes before; what is in none is told with its line.
    folder.write(
        "roots/tank.c",
        &source
            .replace("control(const", "other(const")
            .replace("CYCLIC(control", "CYCLIC(other")
            .replace(
                "#include <math.h>",
                "#include <math.h>\ndouble floor(double v) { return v; }",
            ),
    );
    folder.write("roots/tests/tank.csv", "x,whole\n1.5,1.5\n");
    folder.run("make", &["-C", "roots", "test"]).expect(0, "1 cycles");
    folder.write(
        "roots/tank.c",
        &source
            .replace("floor(x)", "nowhere(x)")
            .replace("static void", "double nowhere(double v);\nstatic void"),
    );
    folder.run("make", &["-C", "roots"]).expect(2, "nowhere (tank.c:17)");
}

#[test]
fn the_other_functions_of_math_h_are_linked_where_they_are_used() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "waves", "--lang", "c"]).expect(0, "");
    let source = r#"#include "takt.h"
#include <math.h>
TAKT_PROGRAM("waves", 0, 1, 0, 0);
TAKT_INPUT(LREAL, x, 0);
TAKT_OUTPUT(LREAL, sine, 0);
TAKT_OUTPUT(LREAL, power, 8);
TAKT_OUTPUT(LREAL, grown, 16);
TAKT_OUTPUT(LREAL, logarithm, 24);
TAKT_OUTPUT(LREAL, angle, 32);
TAKT_OUTPUT(REAL, small, 40);
static void control(const takt_job *job) {
    (void)job;
    sine = sin(x);
    power = pow(x, 1.5);
    grown = exp(x);
    logarithm = log(x);
    angle = atan2(x, 2.0);
    small = cosf((float)x) + sqrtf(4.0f);
}
TAKT_CYCLIC(control, .period = TAKT_MS(10));
"#;
    folder.write("waves/tank.c", source);
    let table = "x,sine,power,grown,logarithm,angle,small\n\
                 1,0.8414709848078965,1,2.718281828459045,0,0.4636476090008061,2.5403023\n\
                 1e6,-0.3499935021712930,1e9,,13.815510557964274,1.5707943267948966,\n\
                 2,0.9092974268256817,2.8284271247461903,7.38905609893065,0.6931471805599453,0.7853981633974483,1.5838532\n";
    folder.write("waves/tests/tank.csv", table);
    folder.run("make", &["-C", "waves", "test"]).expect(0, "3 cycles");
    // The program's own function goes before; only what is used is linked.
    let own = source
        .replace("#include <math.h>", "#include <math.h>\ndouble sin(double v) { return v; }");
    folder.write("waves/tank.c", &own);
    folder.write("waves/tests/tank.csv", "x,sine,angle\n2,2,0.7853981633974483\n");
    folder.run("make", &["-C", "waves", "test"]).expect(0, "1 cycles");
}

#[test]
fn function_blocks_are_used_in_rust() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "filter", "--lang", "rust"]).expect(0, "");
    let source = r#"#![no_std]
use core::time::Duration;
use takt_blocks::{Pid, Statistics, Tuning};
use takt_sdk::{Cyclic, Job};
takt_sdk::program!("filter", 0, 1, 0);
takt_sdk::input!(MEASURED: f64, "measured", 0);
takt_sdk::output!(VALVE: f64, "valve", 0);
takt_sdk::task!("control", control, Cyclic::DEFAULT);
fn control(job: &Job) {
    let mut level = Pid::new(Tuning { proportional: 4.0, high: 10.0, ..Tuning::default() });
    let mut spread = Statistics::<4>::new();
    spread.update(MEASURED.get());
    let elapsed = Duration::from_nanos(job.period_ns);
    VALVE.set(level.update(1.5, MEASURED.get(), elapsed) + spread.standard_deviation());
}
"#;
    folder.write("filter/src/lib.rs", source);
    folder.write("filter/tests/tank.csv", "measured,valve\n1,2\n0.5,4\n");
    folder.run("make", &["-C", "filter", "test"]).expect(0, "2 cycles");
}

/// The library of Rust names functions for unwinding, and calls those for numbers of 128 bits.
#[test]
fn what_the_library_of_rust_needs_is_there_and_numbers_are_logged() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "numbers", "--lang", "rust"]).expect(0, "");
    let source = r#"#![no_std]
use takt_sdk::{Cyclic, Error, Job};
takt_sdk::program!("numbers", 0, 1, 0);
mod io {
    takt_sdk::input!(pub STEP: f64, "step", 1);
    takt_sdk::output!(pub SAW: f64, "saw", 0);
}
takt_sdk::point!(MATRIX: [[f32; 2]; 3] = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], "matrix", RETAIN);
takt_sdk::queue!(ORDERS, "orders", bytes = 8, depth = 2);
takt_sdk::mailbox!(LAST, "last", bytes = 8);
takt_sdk::flags!(SEEN, "seen");
takt_sdk::task!("control", control, Cyclic::DEFAULT);
fn control(job: &Job) {
    io::SAW.set((io::SAW.get() + io::STEP.get()) % 0.5);
    if job.is_first() {
        takt_sdk::log!("{} {:.3} {:?}", u128::MAX, 2.0_f64 / 3.0, job.interval());
        // A buffer has room for the longest message.
        let mut small = [0; 7];
        assert_eq!(ORDERS.receive(&mut small, 0), Err(Error::TooLong));
        assert_eq!(ORDERS.receive(&mut [0; 8], 0), Err(Error::Empty));
        assert_eq!(ORDERS.receive(&mut [0; 8], 3_600_000_000_001), Err(Error::NotAllowed));
        assert_eq!(LAST.read(&mut small), Err(Error::TooLong));
        assert_eq!(SEEN.wait_any(0, 0), Err(Error::NotAllowed));
        assert_eq!(SEEN.wait_any(1, 0), Err(Error::Empty));
        (0..40).for_each(|line| takt_sdk::log!("line {line}"));
    }
}
"#;
    folder.write("numbers/src/lib.rs", source);
    folder.write("t.csv", "step,saw +-1e-9,matrix[5]\n0.4,0.4,6\n0.4,0.3,6\n");
    for profile in ["release", "dev"] {
        let words =
            ["build", "--profile", profile, "--offline", "--manifest-path", "numbers/Cargo.toml"];
        folder.run("cargo", &words).expect(0, "Finished");
        let place = if profile == "dev" { "debug" } else { profile };
        let library = format!("numbers/target/{place}/libnumbers.a");
        folder.takt_plc(&["build", &library, "-o", "n.plc"]).expect(0, "");
        folder.takt_plc(&["inspect", "n.plc"]).expect(0, "ARRAY[0..5] OF REAL");
        let ended = folder.takt_plc(&["test", "n.plc", "t.csv"]).expect(0, "all as expected");
        let ended = ended.expect(0, "340282366920938463463374607431768211455 0.667 0ns");
        // 32 lines at once are what the kernel lets a program log.
        let ended = ended.expect(0, "line 30");
        assert!(!ended.text.contains("line 31"), "{}", ended.text);
    }
}

#[test]
fn the_rust_project_is_tested_by_make() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "two-tanks", "--lang", "rust"]).expect(0, "");
    folder.run("make", &["-C", "two-tanks", "test"]).expect(0, "two-tanks: 11 cycles, 110 ms");
}

#[test]
fn rust_and_c_make_the_same_control_program() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "a", "--lang", "rust"]).expect(0, "");
    folder.takt_plc(&["new", "b", "--lang", "c"]).expect(0, "");
    assert_eq!(folder.read("a/tests/tank.csv"), folder.read("b/tests/tank.csv"));
}

#[test]
fn projects_whose_flags_ask_for_avx_are_told_so() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "wide", "--lang", "rust"]).expect(0, "");
    std::fs::create_dir(folder.path().join("wide/.cargo")).unwrap();
    folder.write(
        "wide/.cargo/config.toml",
        "[build]\nrustflags = [\"-C\", \"target-cpu=haswell\"]\n",
    );
    let ended = folder.run("sh", &["-c", "cd wide && env -u RUSTFLAGS cargo build --offline"]);
    ended.expect(101, "this build makes instructions of AVX, which the PLC's kernel does not give");
    folder.takt_plc(&["new", "c", "--lang", "c"]).expect(0, "");
    // The flags of takt.mk come last, so such a flag of the user's has no effect.
    folder.run("make", &["-C", "c", "CFLAGS=-O3 -march=haswell", "test"]).expect(0, "11 cycles");
    let attribute = "__attribute__((target(\"avx2\"), optimize(\"O3\"))) void wide(float *a) {
        for (int i = 0; i < 16; i++) a[i] += 1;
    }
    float b[16];
    static void more(const takt_job *job) { (void)job; wide(b); }
    TAKT_CYCLIC(more, .period = TAKT_MS(10), .priority = 9)";
    let source = String::from_utf8(folder.read("c/tank.c")).unwrap();
    folder.write("c/tank.c", &format!("{source}\n{attribute};\n"));
    folder
        .run("make", &["-C", "c"])
        .expect(2, "build/tank.o: its assembler has noted that it uses YMM");
}

#[test]
fn points_of_rust_are_truths_times_texts_and_markers() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "types", "--lang", "rust"]).expect(0, "");
    let source = r#"#![no_std]
use core::fmt::Write;
use takt_sdk::{Cyclic, Job, Text, Time};
takt_sdk::program!("types", 1, 0, 0);
takt_sdk::input!(ON: bool, "on", 1);
takt_sdk::input!(DELAY: Time, "delay", 3);
takt_sdk::input!(ORDER: [u8; 5], "order", 16);
takt_sdk::output!(LAMPS: [bool; 3], "lamps", 0);
takt_sdk::output!(LEFT: Time, "left", 8);
takt_sdk::output!(STATE: Text<16>, "state", 16);
takt_sdk::marker!(COUNT: i32, "count", 4);
takt_sdk::point!(NAMES: [Text<7>; 2] = [Text::new("north"), Text::new("south")], "names", RETAIN);
takt_sdk::point!(READY: bool = true, "ready", FORCEABLE);
takt_sdk::task!("run", run, Cyclic::DEFAULT);
fn run(job: &Job) {
    LAMPS.set([ON.get(), !ON.get(), READY.get()]);
    COUNT.set(COUNT.get() + 1);
    let left = DELAY.get().duration().saturating_sub(job.interval());
    LEFT.set(left.into());
    let mut state = Text::EMPTY;
    let _ = write!(state, "{} {}", NAMES.get()[1].as_str().unwrap_or("?"), COUNT.get());
    STATE.set(state);
    takt_sdk::log!("{}, order {}", STATE.get().as_str().unwrap_or("?"), ORDER.get()[4]);
}
"#;
    folder.write("types/src/lib.rs", source);
    let words = ["build", "--release", "--offline", "--manifest-path", "types/Cargo.toml"];
    folder.run("cargo", &words).expect(0, "Finished");
    folder.takt_plc(&["build", "types/target/release/libtypes.a", "-o", "t.plc"]).expect(0, "");
    let shown = folder.takt_plc(&["inspect", "t.plc"]);
    let shown = shown.expect(0, "%IB1 ").expect(0, "ARRAY[0..2] OF BOOL").expect(0, "TIME");
    shown.expect(0, "STRING[16]").expect(0, "ARRAY[0..1] OF STRING[7]").expect(0, "%MB4");
    let table = "on,delay,set order[4],lamps[0],lamps[1],lamps[2],left,count,set ready\n\
                 1,T#1s,7,1,0,1,T#1s,1,\n\
                 0,T#5ms,,0,1,0,T#0s,2,0\n";
    folder.write("t.csv", table);
    let ended = folder.takt_plc(&["test", "t.plc", "t.csv"]);
    ended.expect(0, "south 1, order 7").expect(0, "south 2, order 7");
    let long = source.replace("\"south\"", "\"southeast\"");
    folder.write("types/src/lib.rs", &long);
    folder.run("cargo", &words).expect(101, "the text is longer than its STRING");
}
