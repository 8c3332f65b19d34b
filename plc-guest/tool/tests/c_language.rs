//! What takt.h refuses when it is compiled, and what it says while a program runs.

mod common;

use std::path::Path;

use common::{Ended, Folder};

const HEAD: &str = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\n";
const RUN: &str = "static void run(const takt_job *job) { (void)job; }\n\
                   TAKT_CYCLIC(run, .period = TAKT_MS(1));\n";

fn compile(folder: &Folder, source: &str, flags: &[&str]) -> Ended {
    let sdk = Path::new(env!("CARGO_MANIFEST_DIR")).join("../sdk/c");
    let include = format!("-I{}", sdk.display());
    folder.write("x.c", source);
    let mut words = vec!["-std=c11", "-ffreestanding", "-Wall", "-Wextra", "-Werror", &include];
    words.extend(flags);
    words.extend(["-c", "x.c", "-o", "x.o"]);
    folder.run("gcc", &words)
}

#[test]
fn a_point_has_the_type_of_its_variable() {
    let folder = Folder::new();
    let wrong = [
        ("double v;", "REAL"),
        ("int8_t v;", "DINT"),
        ("float v;", "DINT"),
        ("uint32_t v;", "DINT"),
        ("float v[3][2];", "REAL"),
        ("double v[4];", "REAL"),
        ("struct { float a; int16_t b; } v;", "REAL"),
        ("int v;", "BOOL"),
        ("float *v;", "REAL"),
        ("uint8_t v;", "SINT"),
    ];
    for (variable, ty) in wrong {
        let source = format!("{HEAD}{variable} TAKT_POINT({ty}, v, 0);\n{RUN}");
        compile(&folder, &source, &[])
            .expect(1, &format!("the variable `v` is neither a takt_{ty} nor an array"));
    }
    let right = [
        ("double v;", "LREAL"),
        ("static volatile float v;", "REAL"),
        ("volatile float v[3];", "REAL"),
        ("const float v = 2;", "REAL"),
        ("const int v[2] = { 1, 2 };", "DINT"),
        ("bool v[3];", "BOOL"),
        ("int64_t v;", "TIME"),
    ];
    for (variable, ty) in right {
        let source = format!("{HEAD}{variable} TAKT_POINT({ty}, v, 0);\n{RUN}");
        compile(&folder, &source, &[]).expect(0, "");
    }
    for bit in ["0, 8", "65536, 0", "-1, 0"] {
        let source = format!("{HEAD}TAKT_OUTPUT_BIT(lamp, {bit});\n{RUN}");
        compile(&folder, &source, &[]).expect(1, "TAKT_OUTPUT_BIT: `lamp`");
        let source = source.replace("OUTPUT", "INPUT");
        compile(&folder, &source, &[]).expect(1, "TAKT_INPUT_BIT: `lamp`");
    }
}

#[test]
fn an_array_of_one_is_an_array() {
    let folder = Folder::new();
    let source = format!("{HEAD}float one[1]; TAKT_POINT(REAL, one, TAKT_FORCEABLE);\n{RUN}");
    folder.c_program("p", &source).expect(0, "");
    folder.write("t.csv", "set one[0],one[0]\n3,3\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "");
}

#[test]
fn a_constant_is_neither_retained_nor_forced() {
    let folder = Folder::new();
    for flag in ["TAKT_RETAIN", "TAKT_PERSISTENT", "TAKT_FORCEABLE"] {
        let source = format!("{HEAD}const float f = 2; TAKT_POINT(REAL, f, {flag});\n{RUN}");
        folder.c_program("p", &source).expect(2, "point `f`: it is constant");
    }
}

#[test]
fn a_task_that_needs_more_stack_than_it_has_faults() {
    let flags = include_str!("../../sdk/c/takt.mk").replace("\\\n", " ");
    let flags = flags.lines().find_map(|line| line.strip_prefix("FREESTANDING = ")).unwrap();
    let flags = flags.split_whitespace().filter(|flag| !flag.contains('$'));
    let flags: Vec<_> = flags.chain(["-w"]).collect();
    let source = "#include \"takt.h\"
        TAKT_PROGRAM(\"p\", 1, 0, 0, 0);
        TAKT_OUTPUT(LINT, x, 0);
        TAKT_WRITES(second, x);
        static int64_t *theirs;
        static void first(const takt_job *job) {
            volatile int64_t kept[64];
            (void)job;
            kept[3] = 77;
            theirs = (int64_t *)kept;
        }
        TAKT_CYCLIC(first, .period = TAKT_MS(10));
        __attribute__((noinline)) static void large(char n) {
            volatile char room[(1 << 20) + 8192];
            for (int i = 0; i < 8100; i++) room[i] = n;
        }
        static void second(const takt_job *job) {
            (void)job;
            large(3);
            x = theirs[3];
        }
        TAKT_CYCLIC(second, .period = TAKT_MS(10));";
    let folder = Folder::new();
    folder.c_program_with("p", source, &flags).expect(0, "");
    folder.takt_plc(&["test", "p.plc"]).expect(3, "stack overflow").expect(3, "task second");
}

#[test]
fn a_program_that_gives_up_says_where() {
    let source = "#include \"takt.h\"
        TAKT_PROGRAM(\"p\", 1, 0, 0, 0);
        TAKT_INPUT(DINT, what, 0); static char *volatile none;
        static void boom(void) { takt_fail(\"no pressure\"); } /* line 4 */
        static void run(const takt_job *job) {
            (void)job;
            if (what == 1) boom();
            if (what == 2) takt_fail(\"too hot\"); /* line 8 */
            if (what == 3) takt_stop(5);
            if (what == 4) takt_log(none);
        }
        TAKT_CYCLIC(run, .period = TAKT_MS(1));";
    let folder = Folder::new();
    for level in ["-O0", "-O1", "-O2", "-Os"] {
        folder.c_program_with("p", source, &[level]).expect(0, "");
        for (what, place) in [("1", "p.c:4"), ("2", "p.c:8")] {
            folder.write("t.csv", &format!("what\n{what}\n"));
            let ended = folder.takt_plc(&["test", "p.plc", "t.csv"]);
            ended.expect(3, place).expect(3, "the program gave up");
        }
        // Not where takt.h reads the text.
        folder.write("t.csv", "what\n4\n");
        let ended = folder.takt_plc(&["test", "p.plc", "t.csv"]);
        ended.expect(3, "p.c:10: null reference (0x0)");
        folder.write("t.csv", "what\n3\n");
        folder
            .takt_plc(&["test", "p.plc", "t.csv"])
            .expect(3, "p.c:9: it stopped the program with code 5");
    }
}

#[test]
fn numbers_are_logged() {
    let table = [
        ("\"plain\"", "plain"),
        ("\"%d %d\", 0, -5", "0 -5"),
        ("\"%d\", (-2147483647 - 1)", "-2147483648"),
        ("\"%u\", 4294967295u", "4294967295"),
        ("\"%lld\", (-9223372036854775807ll - 1)", "-9223372036854775808"),
        ("\"%llu %ld\", 18446744073709551615ull, -3l", "18446744073709551615 -3"),
        ("\"%x %llx\", 0xbeefu, 0x123456789abcdefull", "beef 123456789abcdef"),
        ("\"[%5d|%-5d|%05d|%2d]\", 42, 42, -42, 12345", "[   42|42   |-0042|12345]"),
        ("\"%f %f\", 0.0, -2.5", "0.000000 -2.500000"),
        ("\"%.1f %.2f %.0f %.0f %.0f\", 0.25, 1.999, 0.5, 1.5, 2.5", "0.2 2.00 0 2 2"),
        ("\"%f\", 1e-9", "0.000000"),
        ("\"%.9f\", 0.123456789", "0.123456789"),
        ("\"%8.2f|%-8.2f|%08.2f\", 3.14159, 3.14159, -3.14159", "    3.14|3.14    |-0003.14"),
        ("\"%.3f\", 123456789012.5", "123456789012.500"),
        ("\"%.2f\", 1e18", "1.00e+18"),
        ("\"%.2f\", -2.5e300", "-2.50e+300"),
        ("\"%f %f %f\", 1.0 / zero, -1.0 / zero, 0.0 / zero", "inf -inf nan"),
        ("\"%s|%8s|%-4s|%c\", \"a\", \"right\", \"l\", 'x'", "a|   right|l   |x"),
        ("\"100%%\"", "100%"),
        // Behind what is not known no value is told as that of another conversion.
        ("\"[%d %+d|%s]\", 1, 2, \"a\"", "[1 %+d|%s]"),
        ("\"[%d %zu|%f]\", 1, sizeof(int), 2.0", "[1 %zu|%f]"),
    ];
    let mut body = String::new();
    for (number, (arguments, _)) in table.iter().enumerate() {
        body.push_str(&format!("case {number}: takt_logf({arguments}); break;\n"));
    }
    // The line of this one is longer than a log line.
    body.push_str("case 100: takt_logf(\"%60d%60d%d\", 1, 2, 3); break;\n");
    // What is no conversion is logged as it is; compilers warn of it.
    body.push_str("case 101: takt_logf(text, 1); break;\n");
    let source = format!(
        "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0); TAKT_INPUT(DINT, what, 0);\n\
         static volatile double zero; static int *volatile none; static const char *volatile text = \"%q %\";\n\
         static void run(const takt_job *job) {{ (void)job; switch (what) {{\n{body}}}\n\
         *none = 1; }}\nTAKT_CYCLIC(run, .period = TAKT_MS(1));\n"
    );
    let folder = Folder::new();
    folder
        .c_program_with("p", &source, &["-Wno-format-nonliteral", "-Wno-format-security"])
        .expect(0, "");
    let says = |what: usize, line: &str| {
        folder.write("t.csv", &format!("what\n{what}\n"));
        let line = format!("last log line: {line}\n");
        folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(3, &line);
    };
    for (number, (_, line)) in table.iter().enumerate() {
        says(number, line);
    }
    says(100, &format!("{:>60}{:>60}", 1, 2));
    says(101, "%q %");
}

#[test]
fn a_time_may_have_a_fraction() {
    let folder = Folder::new();
    let times = [
        ("TAKT_MS(10)", 10_000_000_u64),
        ("TAKT_MS(2.5)", 2_500_000),
        ("TAKT_MS(0.5)", 500_000),
        ("TAKT_MS(0.1f)", 100_000),
        ("TAKT_US(0.3)", 300),
        ("TAKT_US(1 + 0.0016)", 1002),
        ("TAKT_MS(4.0L)", 4_000_000),
        // More nanoseconds than a double can count, and more than an int can.
        ("TAKT_US(9007199254740993)", 9_007_199_254_740_993_000),
        ("TAKT_US(4294967295u)", 4_294_967_295_000),
        ("2 * TAKT_MS(1 + 1)", 4_000_000),
    ];
    let statics: String = times
        .iter()
        .enumerate()
        .map(|(i, (time, _))| format!("static const uint64_t at_{i} = {time};\n"))
        .collect();
    let checks: String = times
        .iter()
        .enumerate()
        .map(|(i, (time, ns))| {
            format!("_Static_assert({time} == {ns}u, \"{time}\"); if (at_{i} != {ns}u) takt_fail(\"{time}\");\n")
        })
        .collect();
    // The value is made once.
    let checks =
        format!("{checks} int n = 3; if (TAKT_MS(n++) != 3000000 || n != 4) takt_fail(\"n\");\n");
    let source = format!(
        "{HEAD}{statics}static void run(const takt_job *job) {{ (void)job;\n{checks} }}\n\
         TAKT_CYCLIC(run, .period = TAKT_MS(2.5), .budget = TAKT_MS(0.5));\n"
    );
    folder.c_program("p", &source).expect(0, "");
    folder.takt_plc(&["test", "p.plc"]).expect(0, "1 cycles, 2500 us");
    folder.takt_plc(&["inspect", "p.plc"]).expect(0, "budget 500 us");
}

#[test]
fn avx_is_refused_before_the_program_runs() {
    let folder = Folder::new();
    let source = format!("{HEAD}{RUN}");
    for flag in ["-mavx", "-mfma", "-march=haswell"] {
        let ended = compile(&folder, &source, &[flag]);
        ended.expect(1, "takt.h:").expect(1, "makes instructions of AVX");
    }
    for flag in ["-msse4.2", "-mbmi2", "-march=nehalem"] {
        compile(&folder, &source, &[flag]).expect(0, "");
    }
}

#[test]
fn registers_that_the_kernel_does_not_keep_are_refused_in_object_files() {
    let with = |attribute: &str, body: &str| {
        format!(
            "{HEAD}float a[16], b[16]; TAKT_POINT(REAL, a, 0);\n\
             __attribute__((noinline, optimize(\"O3\"), target(\"{attribute}\"))) static void work(void) {{ {body} }}\n\
             static void run(const takt_job *job) {{ (void)job; work(); }}\n\
             TAKT_CYCLIC(run, .period = TAKT_MS(1));\n"
        )
    };
    let sum = "for (int i = 0; i < 16; i++) a[i] += b[i];";
    let noted = ["-Wa,-mx86-used-note=yes"];
    let folder = Folder::new();
    let refused = |source: &str, what: &str| {
        let ended = folder.c_program_with("p", source, &noted);
        ended.expect(2, ".o: its assembler has noted that it uses ").expect(2, what);
    };
    refused(&with("avx2", sum), "YMM registers (AVX)");
    let masked = "__asm__(\"kxorw %k1, %k1, %k1\");";
    refused(&with("avx512f", masked), "mask registers (AVX-512)");
    refused(&with("default", "__asm__(\"xgetbv\" : : : \"eax\", \"ecx\", \"edx\");"), "XGETBV");
    folder.c_program_with("p", &with("sse4.2", sum), &noted).expect(0, "");
    // Of a library only what is linked counts.
    folder.write(
        "wide.c",
        "float c[8];\nvoid wide(void) { for (int i = 0; i < 8; i++) c[i] += 1; }\n",
    );
    let flags =
        ["-O3", "-mavx2", "-ffreestanding", "-fno-pie", noted[0], "-c", "wide.c", "-o", "wide.o"];
    folder.run("gcc", &flags).expect(0, "");
    folder.run("ar", &["rcs", "libwide.a", "wide.o"]).expect(0, "");
    compile(&folder, &format!("{HEAD}{RUN}"), &[]).expect(0, "");
    folder.takt_plc(&["build", "x.o", "libwide.a", "-o", "p.plc"]).expect(0, "");
    let calls = RUN.replace("(void)job;", "(void)job; wide();");
    compile(&folder, &format!("{HEAD}void wide(void);\n{calls}"), &[]).expect(0, "");
    let ended = folder.takt_plc(&["build", "x.o", "libwide.a", "-o", "p.plc"]);
    ended.expect(2, "libwide.a: its assembler has noted that it uses YMM");
}

#[test]
fn a_text_is_a_point() {
    let folder = Folder::new();
    let points = "char state[17] = \"idle\"; TAKT_STRING(state, TAKT_FORCEABLE);\n\
                  static volatile char name[1]; TAKT_STRING(name, 0);\n\
                  TAKT_INPUT_STRING(order, 4, 3);\nTAKT_OUTPUT_STRING(shown, 10, 2);\n";
    let run = "static void run(const takt_job *job) { (void)job; shown[0] = state[0]; takt_log((const char *)shown);\n\
               takt_logf(\"%d %d\", (int)sizeof(order), order[0]); name[0] = 0; }\n\
               TAKT_CYCLIC(run, .period = TAKT_MS(1));\n";
    folder.c_program("p", &format!("{HEAD}{points}{run}")).expect(0, "");
    let shown = folder.takt_plc(&["inspect", "p.plc"]);
    let shown = shown.expect(0, "STRING[16]").expect(0, "STRING[0]").expect(0, "STRING[4]");
    shown.expect(0, "%IB3").expect(0, "STRING[10]").expect(0, "%QB2");
    let ended = folder.takt_plc(&["test", "p.plc", "--cycles", "1"]);
    ended.expect(0, "run] i\n").expect(0, "run] 5 0");
    for wrong in ["char *v;", "signed char v[3];", "char v[2][3];"] {
        let source = format!("{HEAD}{wrong} TAKT_STRING(v, 0);\n{RUN}");
        compile(&folder, &source, &[]).expect(1, "TAKT_STRING: the variable `v` is no array");
    }
}
