//! Keys, signatures and tables.

mod common;

use common::Folder;

const SOURCE: &str = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 2, 3, 9);\n\
    TAKT_INPUT(INT, x, 0); TAKT_INPUT_BIT(on, 2, 7); TAKT_OUTPUT(REAL, y, 0); TAKT_OUTPUT(UDINT, rises, 4);\n\
    TAKT_OUTPUT(UDINT, jobs, 8);\n\
    static void run(const takt_job *job) { y = on() ? x * 0.1f : 0; jobs = (uint32_t)job->cycle; }\n\
    TAKT_CYCLIC(run, .period = TAKT_MS(2));\n\
    static void edge(const takt_job *job) { rises = (uint32_t)job->cycle + 1; }\n\
    TAKT_EVENT(edge, \"rise:on\", .period = TAKT_MS(4), .priority = 1);\n\
    TAKT_WRITES(run, y); TAKT_WRITES(run, jobs); TAKT_WRITES(edge, rises);\n";

fn built() -> Folder {
    let folder = Folder::new();
    folder.c_program("p", SOURCE).expect(0, "");
    folder
}

#[test]
fn an_image_is_signed_by_a_key_and_no_other() {
    let folder = built();
    folder.takt_plc(&["verify", "p.plc"]).expect(0, "whole, not signed");
    folder.takt_plc(&["keygen", "a"]).expect(0, "public key a.pub");
    folder.takt_plc(&["keygen", "b"]).expect(0, "");
    folder.takt_plc(&["keygen", "a"]).expect(2, "cannot make a.key");
    folder.write("half.pub", "");
    folder.takt_plc(&["keygen", "half"]).expect(2, "cannot make half.pub");
    assert!(!folder.path().join("half.key").exists());
    // As if the disk were full.
    let words = "trap '' XFSZ; ulimit -f 0; exec \"$TAKT\" plc keygen full";
    folder.run("sh", &["-c", words]).expect(2, "cannot make full.key");
    assert!(!folder.path().join("full.key").exists());
    folder.takt_plc(&["verify", "p.plc", "--key", "a.pub"]).expect(1, "is not signed");
    folder.takt_plc(&["sign", "p.plc", "--key", "a.key"]).expect(0, "signed by");
    folder
        .takt_plc(&["verify", "p.plc", "--key", "b.pub", "--key", "a.pub"])
        .expect(0, "signed by");
    folder.takt_plc(&["verify", "p.plc", "--key", "b.pub"]).expect(1, "none of the keys");
    folder
        .takt_plc(&["sign", "p.plc", "--key", "p.plc"])
        .expect(2, "allowed: a file with `takt private key`");
    // A public key signs nothing, and a private one checks nothing.
    folder
        .takt_plc(&["sign", "p.plc", "--key", "b.pub"])
        .expect(2, "b.pub: found a takt public key");
    folder.takt_plc(&["verify", "p.plc", "--key", "a.pub"]).expect(0, "signed by");
    folder
        .takt_plc(&["verify", "p.plc", "--key", "a.key"])
        .expect(2, "a.key: found a takt private key");
    // A sign is no digit.
    folder.write("sign.pub", &format!("takt public key {}", "+f".repeat(32)));
    folder.takt_plc(&["verify", "p.plc", "--key", "sign.pub"]).expect(2, "64 hexadecimal digits");
    let mut bytes = folder.read("p.plc");
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(folder.path().join("q.plc"), bytes).unwrap();
    for command in ["verify", "inspect", "test"] {
        folder.takt_plc(&[command, "q.plc"]).expect(2, "q.plc: at byte");
    }
    folder.takt_plc(&["sign", "q.plc", "--key", "a.key"]).expect(2, "q.plc: at byte");
}

#[test]
fn a_private_key_is_readable_by_its_owner_only() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    folder.takt_plc(&["keygen", "k"]).expect(0, "");
    let mode = std::fs::metadata(folder.path().join("k.key")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o600);
}

/// What a path leads to is written, and stays what it is.
#[test]
fn links_permissions_and_pipes_stay_as_they_are() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let folder = built();
    let path = |name: &str| folder.path().join(name);
    folder.takt_plc(&["keygen", "a"]).expect(0, "");
    std::fs::set_permissions(path("p.plc"), PermissionsExt::from_mode(0o640)).unwrap();
    symlink("p.plc", path("current.plc")).unwrap();
    folder.takt_plc(&["sign", "current.plc", "--key", "a.key"]).expect(0, "signed by");
    assert!(path("current.plc").is_symlink());
    folder.takt_plc(&["verify", "p.plc", "--key", "a.pub"]).expect(0, "signed by");
    let mode = std::fs::metadata(path("p.plc")).unwrap().permissions().mode();
    assert_eq!(mode & 0o7777, 0o640);
    // To a file that is not there yet, from another folder.
    std::fs::create_dir(path("links")).unwrap();
    symlink("../new.plc", path("links/new.plc")).unwrap();
    let build = |output: &str| folder.takt_plc(&["build", "p.o", "takt.o", "-o", output]);
    build("links/new.plc").expect(0, "");
    folder.takt_plc(&["verify", "new.plc"]).expect(0, "whole");
    symlink("round", path("round")).unwrap();
    build("round").expect(2, "cannot write round: ");

    symlink("/dev/null", path("null")).unwrap();
    build("null").expect(0, "");
    assert_eq!(std::fs::read_link(path("null")).unwrap(), std::path::Path::new("/dev/null"));
    let words = "mkfifo pipe; timeout 60 cat pipe >out.plc 2>&1 & \"$TAKT\" plc build p.o takt.o -o pipe; test -p pipe || exit 9; wait";
    folder.run("sh", &["-c", words]).expect(0, "");
    folder.takt_plc(&["verify", "out.plc"]).expect(0, "whole");
}

#[test]
fn tables_set_inputs_and_compare_outputs() {
    let folder = built();
    folder.write("t.csv", "# comment\nx,on,y +-0.001,rises,#why\n-7,TRUE,-0.7,1,first\n,1,-0.7,1,\n,0,0,1,\n8,1,.8,2,\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "4 cycles, 8 ms");
    folder.write("t.csv", "x,on,y\n1,1,0.1\n1,1,0.3\n");
    let ended = folder.takt_plc(&["test", "p.plc", "t.csv"]);
    ended.expect(1, "1 values are not as expected").expect(1, "line 3: y is 0.1");
    folder.write("t.csv", "x,on,y\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(2, "t.csv has no row");
    // Empty lines where no row can be meant, and a row of empty cells.
    folder.write("t.csv", "\n\njobs,#\n0\n,\n2\n\n# the end\n\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "3 cycles, 6 ms");
    folder.write("t.csv", "x,on,y +-inf\n1,1,0.1\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(2, "found `inf` after +-");
}

#[test]
fn an_event_within_the_least_time_is_served_later() {
    let folder = built();
    // Rises in the first row and in the third, 4 ms later; again in the fourth row's 2 ms: served one row later.
    folder.write("t.csv", "on,rises\n1,1\n0,1\n1,2\n0,2\n1,3\n0,3\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "");
    folder.write("t.csv", "on,rises,jobs\n1,1,0\n0,1,0\n1,1,1\n0,1,1\n0,2,2\n");
    folder.takt_plc(&["test", "p.plc", "t.csv", "--step", "1000"]).expect(0, "5 ms");
}

#[test]
fn a_task_that_writes_the_output_of_another_is_told() {
    let folder = Folder::new();
    let source = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\n\
        TAKT_INPUT(UINT, who, 0); TAKT_OUTPUT_BIT(lamp, 0, 0); TAKT_OUTPUT_BIT(horn, 0, 1);\n\
        static void a(const takt_job *j) { lamp(j->cycle & 1); if (who == 1) horn(true); }\n\
        static void b(const takt_job *j) { (void)j; horn(who == 2); }\n\
        TAKT_CYCLIC(a, .period = TAKT_MS(1)); TAKT_CYCLIC(b, .period = TAKT_MS(1), .priority = 1);\n\
        TAKT_WRITES(a, lamp); TAKT_WRITES(b, horn);\n";
    folder.c_program("p", source).expect(0, "");
    folder.write("good.csv", "who,lamp,horn\n2,0,1\n0,1,0\n");
    folder.takt_plc(&["test", "p.plc", "good.csv"]).expect(0, "2 cycles");
    folder.write("bad.csv", "who\n0\n1\n");
    let ended = folder.takt_plc(&["test", "p.plc", "bad.csv"]);
    ended.expect(
        3,
        "task a, job 1, at 1 ms: it changed the output `horn`, which another task writes",
    );
}

#[test]
fn parts_of_inputs_are_set_and_the_initialisation_finds_the_inputs() {
    let folder = Folder::new();
    let source = "PROGRAM Main\nVAR\n row AT %IW0 : ARRAY[1..2] OF INT; q AT %QW0 : INT; END_VAR\n\
        q := row[1] + 10 * row[2];\nEND_PROGRAM\nCONFIGURATION c\n\
        TASK t (INTERVAL := T#10ms, PRIORITY := 1);\nPROGRAM main WITH t : Main;\nEND_CONFIGURATION\n";
    folder.write("p.st", source);
    folder.takt_plc(&["build", "p.st", "-o", "p.plc"]).expect(0, "");
    folder.write("t.csv", "main.row[1],main.row[2],main.q\n1,2,21\n,3,31\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "all as expected");

    let source = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\n\
        TAKT_INPUT(INT, x, 0); TAKT_OUTPUT(INT, y, 0); int16_t first = 5; TAKT_POINT(INT, first, 0);\n\
        int16_t seen; TAKT_POINT(INT, seen, 0);\n\
        static void begin(const takt_job *job) { (void)job; seen = first; first = x; }\nTAKT_INIT(begin);\n\
        static void run(const takt_job *job) { (void)job; y = first; }\n\
        TAKT_CYCLIC(run, .period = TAKT_MS(1));\n";
    folder.c_program("p", source).expect(0, "");
    // A variable is set behind the initialisation, which gives it its value.
    folder.write("t.csv", "x,y,seen\n7,7,5\n8,7,5\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "all as expected");
    folder.write("t.csv", "x,set first,y,seen\n7,9,9,5\n");
    folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(0, "all as expected");
}

#[test]
fn a_row_can_be_longer_than_a_period() {
    let folder = built();
    folder.write("t.csv", "jobs\n4\n9\n");
    folder.takt_plc(&["test", "p.plc", "t.csv", "--step", "10000"]).expect(0, "2 cycles, 20 ms");
    folder.takt_plc(&["test", "p.plc", "--cycles", "100"]).expect(0, "100 cycles, 200 ms");
    folder.takt_plc(&["test", "p.plc", "--cycles", "0"]).expect(2, "--cycles");
}

#[test]
fn cycles_without_a_table_take_no_memory() {
    let folder = Folder::new();
    let source = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\nvolatile int zero;\n\
        static void run(const takt_job *job) { zero = (int)job->cycle / zero; }\n\
        TAKT_CYCLIC(run, .period = TAKT_MS(1));\n";
    folder.c_program("p", source).expect(0, "");
    let most = u64::MAX.to_string();
    folder.takt_plc(&["test", "p.plc", "--cycles", &most]).expect(3, "division by zero");
}

#[test]
fn tables_that_are_wrong_are_told_with_line_and_column() {
    let folder = built();
    for (table, says) in [
        ("", "line 1, column 1: the table is empty"),
        ("x,no\n", "t.csv, line 1, column 3: the program has no point `no`"),
        ("x\n40000\n", "line 2, column 1: found `40000`; INT is -32768 to 32767"),
        ("on\n2\n", "line 2, column 1: found `2`; a BOOL is 0, 1"),
        ("x,y\n1,1,1\n", "line 2, column 5: the row has more cells"),
        ("y +-z\n", "line 1, column 1: found `z` after +-"),
        ("x +-1\n", "line 1, column 1: a value that is set has no tolerance"),
        ("y[1]\n", "`y[1]` has no part `[1]`"),
        ("y\n0\n\n0\n", "line 3, column 1: found an empty line, which is no row"),
        ("x,y\n\n \n# why\n1,0.1\n", "line 2, column 1: found an empty line"),
    ] {
        folder.write("t.csv", table);
        folder.takt_plc(&["test", "p.plc", "t.csv"]).expect(2, says);
    }
}
