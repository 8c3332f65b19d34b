//! What a change of a running program would do, as engineers are told.

mod common;

use common::{Folder, status_of};

/// A program in Structured Text with these declarations, in this version.
fn program(folder: &Folder, name: &str, variables: &str, body: &str) {
    program_with(folder, name, "", variables, body);
}

/// The same, with these types.
fn program_with(folder: &Folder, name: &str, types: &str, variables: &str, body: &str) {
    let source = format!(
        "{types}PROGRAM Main\nVAR\n  q AT %QW0 : INT;\n{variables}\nEND_VAR\n{body}\nEND_PROGRAM\n\
         CONFIGURATION c\nTASK t (INTERVAL := T#10ms, PRIORITY := 1);\n\
         PROGRAM main WITH t : Main;\nEND_CONFIGURATION\n"
    );
    std::fs::create_dir(folder.path().join(name)).unwrap();
    let file = format!("{name}/p.st");
    folder.write(&file, &source);
    folder.takt_plc(&["build", &file, "-o", &format!("{name}.plc")]).expect(0, "");
}

#[test]
fn a_change_tells_what_becomes_of_each_variable() {
    let folder = Folder::new();
    let old = "  n : INT := 3; gone : DINT; text : STRING[10]; history : ARRAY[1..4] OF REAL;";
    let new = "  fresh : BOOL; n : DINT := 3; text : STRING[20]; history : ARRAY[1..6] OF REAL;";
    program(&folder, "old", old, "n := n + 1; q := n; gone := n; text := 'a'; history[1] := 1.0;");
    program(
        &folder,
        "new",
        new,
        "n := n + 1; q := DINT_TO_INT(n); fresh := TRUE; text := 'a'; history[1] := 1.0;",
    );
    let ended = folder.takt_plc(&["diff", "old.plc", "new.plc"]);
    for line in [
        "new          main.fresh                       BOOL",
        "converted    main.n                           INT -> DINT",
        "dropped      main.gone                        DINT",
        "converted    main.text                        STRING[10] -> STRING[20]",
        "moved        main.history[1..4]               REAL",
        "new          main.history[5..6]               REAL",
        "name         the image's is new, and old in the running version",
        "commit       ",
    ] {
        assert!(ended.text.contains(line), "{line}\n{}", ended.text);
    }
    ended.expect(0, "of at most 8000 ns by the model");
    let json = folder.takt_plc(&["diff", "old.plc", "new.plc", "--json"]).expect(0, "");
    let value: serde_json::Value = serde_json::from_str(&json.text).unwrap();
    assert_eq!(value["possible"], true);
    assert_eq!(value["commit"]["converted_values"], 1);
    for (words, says) in [
        (&["new.plc"][..], "one image takes --running"),
        (&["old.plc", "new.plc", "--running", "a.toml", "--program", "p"], "the new image alone"),
        (&["new.plc", "--running", "a.toml", "--program", "p"], "a.toml"),
        (&["new.plc", "--running", "a.toml"], "--program"),
    ] {
        folder.takt_plc(&[&["diff"], words].concat()).expect(2, says);
    }
    // The same program stays as it is.
    folder.takt_plc(&["diff", "old.plc", "old.plc"]).expect(0, "0 bytes in 0 steps");
}

#[test]
fn a_change_of_more_than_fits_between_two_cycles_names_the_key_that_it_takes() {
    let folder = Folder::new();
    let block = "  meters : ARRAY[1..300] OF Meter; last : INT;";
    let program = |name: &str, fields: &str| {
        let ty = format!("TYPE Meter : STRUCT {fields} END_STRUCT; END_TYPE\n");
        program_with(
            &folder,
            name,
            &ty,
            block,
            "last := last + 1; q := last; meters[1].n := last;",
        );
    };
    program("old", "n : INT; sum : LREAL;");
    program("new", "more : LREAL; sum : LREAL; n : INT;");
    let ended = folder.takt_plc(&["diff", "old.plc", "new.plc"]).expect(0, "");
    for line in [
        "large        the change takes more than 256 steps",
        "second state ",
        "before a commit that moves nothing; takes the key `second_state` of the partition file",
    ] {
        assert!(ended.text.contains(line), "{line}\n{}", ended.text);
    }
    assert!(!ended.text.contains("roll-back"), "{}", ended.text);
    let json = folder.takt_plc(&["diff", "old.plc", "new.plc", "--json"]).expect(0, "");
    let value: serde_json::Value = serde_json::from_str(&json.text).unwrap();
    assert_eq!((&value["possible"], &value["commit"]), (&true.into(), &serde_json::Value::Null));
    assert_eq!(value["large"]["reason"], "the change takes more than 256 steps");
    assert!(value["large"]["steps"].as_u64().unwrap() >= 600, "{value:#}");
}

#[test]
fn what_a_roll_back_does_not_bring_back_is_told() {
    let folder = Folder::new();
    let program = |name: &str, names: &str, more: &str| {
        let types = format!(
            "TYPE Phase : ({names}); END_TYPE\n\
             TYPE Batch : STRUCT phase : Phase; count : INT; END_STRUCT; END_TYPE\n"
        );
        let variables = format!("  batch : Batch; n : {more}; other : DINT; r : REF_TO DINT;");
        let body = "batch.phase := Phase#Fill; batch.count := batch.count + 1; n := n + 1; \
             r := REF(other); q := batch.count; other := r^;";
        program_with(&folder, name, &types, &variables, body);
    };
    program("old", "Fill, Heat", "INT");
    program("new", "Fill, Heat, Drain", "DINT");
    let ended = folder.takt_plc(&["diff", "old.plc", "new.plc"]).expect(0, "commit ");
    for line in [
        "roll-back    main.batch.phase                 Phase: gets its value of the commit again",
        "roll-back    main.n                           INT: gets its value of the commit again",
        "reference    one to what is dropped, converted or starts anew becomes NULL, and stays NULL after a roll-back; one to what a \
         roll-back does not bring back becomes NULL at the roll-back",
    ] {
        assert!(ended.text.contains(line), "{line}\n{}", ended.text);
    }
    assert!(!ended.text.contains("roll-back    main.batch.count"), "{}", ended.text);
    let json = folder.takt_plc(&["diff", "old.plc", "new.plc", "--json"]).expect(0, "");
    let value: serde_json::Value = serde_json::from_str(&json.text).unwrap();
    assert_eq!(value["left_behind"][0]["name"], "main.batch.phase", "{value:#}");
    let ended = folder.takt_plc(&["diff", "old.plc", "old.plc"]).expect(0, "0 bytes in 0 steps");
    assert!(!ended.text.contains("again") && !ended.text.contains("NULL"), "{}", ended.text);
}

#[test]
fn what_the_partition_file_does_not_allow_is_told_for_the_version_that_runs() {
    let folder = Folder::new();
    let program = |name: &str, fields: &str, meters: u32| {
        let ty = format!("TYPE Meter : STRUCT {fields} END_STRUCT; END_TYPE\n");
        let block = format!("  meters : ARRAY[1..{meters}] OF Meter; last : INT;");
        let body = "last := last + 1; q := last; meters[1].n := last;";
        program_with(&folder, name, &ty, &block, body);
    };
    program("tank", "n : INT; sum : LREAL;", 300);
    program("large", "more : LREAL; sum : LREAL; n : INT;", 300);
    program("long", "n : INT; sum : LREAL;", 30_000);
    let image = folder.read("tank.plc");
    let hash = takt_protocol::hex(&takt_program::Image::verify(&image).unwrap().hash());
    folder.write(
        "plant.toml",
        "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"10ms\"\ncontrol = \"s\"\n\
         [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"16MiB\"\n\
         [[partition.program]]\nimage = \"tank.plc\"\n[[schedule]]\nname = \"normal\"\n\
         [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n",
    );
    for (new, says) in [
        (
            "large",
            "256 steps. With the key `second_state` of the partition file the change can be made",
        ),
        ("long", "bytes of state; the key `state` of the partition file gives it"),
    ] {
        let new = format!("{new}.plc");
        folder.takt_plc(&["diff", "tank.plc", &new]).expect(0, "");
        let words = ["diff", &new, "--running", "plant.toml", "--program", "tank"];
        folder.with_takt(&status_of("tank", &hash), &words).expect(1, says);
    }
    let words = ["diff", "tank.plc", "--running", "plant.toml", "--program", "tank"];
    folder.with_takt(&status_of("tank", &hash), &words).expect(0, "0 bytes in 0 steps");
}

#[test]
fn a_change_that_needs_a_restart_is_told_with_its_reason() {
    let folder = Folder::new();
    program(&folder, "old", "  n : INT;", "n := n + 1; q := n;");
    let c = "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 2, 0, 0, 5);\nstatic int hidden[16];\n\
        static void run(const takt_job *job) { hidden[job->cycle % 16]++; }\n\
        TAKT_CYCLIC(run, .period = TAKT_MS(2));\n";
    folder.c_program("new", c).expect(0, "");
    folder
        .takt_plc(&["diff", "old.plc", "new.plc"])
        .expect(1, "refused      the category is 5, and 0 in the running version")
        .expect(1, "the size of the outputs is 0, and 2 in the running version")
        .expect(1, "the name of task 0 is run, and ")
        .expect(1, "version 2.0.0 has 64 bytes of state at offset 0 that no variable names")
        .expect(1, "the change needs a restart of the partition");
    folder.takt_plc(&["diff", "old.plc", "old/p.st"]).expect(2, "old/p.st: at byte");
}

#[test]
fn the_number_of_an_object_is_a_constant_of_its_version() {
    let folder = Folder::new();
    let source = "#include \"takt.h\"
        TAKT_PROGRAM(\"p\", 1, 0, 0, 0);
        TAKT_QUEUE(first, 4, 4); TAKT_QUEUE(second, 4, 4); TAKT_SEMAPHORE(lock, 1); TAKT_FLAGS(f);
        static void run(const takt_job *job) {
            (void)job; takt_take(lock, 0); takt_flags_set(f, 1); takt_send(second, \"abc\", 4);
            char got[4]; if (takt_receive(first, got, 4, 0) >= 0) takt_fail(\"the wrong queue\");
            if (takt_receive(second, got, 4, 0) != 4) takt_fail(\"no message\");
            takt_give(lock);
        }
        TAKT_CYCLIC(run, .period = TAKT_MS(1), .priority = 1);";
    for flags in [&["-O0"][..], &["-O2"], &["-O2", "-fdata-sections"], &["-fPIE"]] {
        folder.c_program_with("p", source, flags).expect(0, "");
        folder.takt_plc(&["test", "p.plc"]).expect(0, "");
        let json = folder.takt_plc(&["inspect", "p.plc", "--json"]).expect(0, "");
        let value: serde_json::Value = serde_json::from_str(&json.text).unwrap();
        assert_eq!(value["state_bytes"], 0, "{flags:?}: {value}");
    }
    // As gcc places it by itself.
    let source = "#include \"takt.h\"
        TAKT_PROGRAM(\"p\", 1, 0, 0, 0);
        static volatile uint32_t q = 0; TAKT_DECLARE_(q, 10, \"q\", &q, \"\", .numbers = { 0 });
        static void run(const takt_job *job) { (void)job; takt_flags_set(q, 1); }
        TAKT_CYCLIC(run, .period = TAKT_MS(1));";
    folder.c_program("p", source).expect(2, "object `q`: its number lies in the state");
}

#[test]
fn a_program_with_initial_values_and_zeros_is_changed_while_it_runs() {
    let folder = Folder::new();
    let program = |name: &str, hidden: &str, body: &str| {
        let source = format!(
            "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\n{hidden}\n\
             float two = 2; TAKT_POINT(REAL, two, 0);\n\
             float zero; TAKT_POINT(REAL, zero, 0); int16_t row[40]; TAKT_POINT(INT, row, 0);\n\
             static void run(const takt_job *job) {{ (void)job; {body} }}\n\
             TAKT_CYCLIC(run, .period = TAKT_MS(1));"
        );
        folder.c_program(name, &source).expect(0, "");
    };
    program("old", "", "zero += two;");
    program("new", "", "zero -= two; row[1]++;");
    folder.takt_plc(&["diff", "old.plc", "new.plc"]).expect(0, "commit ");
    // Of either kind, also in what would be a gap of alignment.
    for (hidden, body, says) in [
        (
            "static volatile char n = 1;",
            "n++;",
            "1 bytes of state at offset 4 that no variable names",
        ),
        ("static volatile char n[80];", "n[job->cycle % 80]++;", "bytes of state at offset 1"),
    ] {
        program("new", hidden, body);
        folder.takt_plc(&["diff", "old.plc", "new.plc"]).expect(1, says);
    }
}

#[test]
fn a_static_that_no_two_variables_enclose_is_seen_however_small_it_is() {
    let folder = Folder::new();
    let c = |name: &str, variables: &str, body: &str| {
        let source = format!(
            "#include \"takt.h\"\nTAKT_PROGRAM(\"p\", 1, 0, 0, 0);\n{variables}\n\
             static void run(const takt_job *job) {{ (void)job; {body} }}\n\
             TAKT_CYCLIC(run, .period = TAKT_MS(1));"
        );
        // In this order, and the array where clang has it too.
        let flags = ["-fno-toplevel-reorder", "-malign-data=abi"];
        folder.c_program_with(name, &source, &flags).expect(0, "");
    };
    let two = "float two = 2; TAKT_POINT(REAL, two, 0);";
    let row = "int16_t row[40]; TAKT_POINT(INT, row, 0);";
    c("named", &format!("{two} {row}"), "row[1]++;");
    folder.takt_plc(&["diff", "named.plc", "named.plc"]).expect(0, "0 bytes in 0 steps");
    for (name, variables, body, says) in [
        (
            "alone",
            format!("{two} static volatile float sum;"),
            "sum += two;",
            "4 bytes of state at offset 64 that no variable names",
        ),
        (
            "first",
            format!("{two} volatile float sum; {row}"),
            "sum += two; row[1]++;",
            "16 bytes of state at offset 64",
        ),
        (
            "last",
            format!("{row} static volatile char n;"),
            "n++; row[1]++;",
            "1 bytes of state at offset 80",
        ),
        (
            "before",
            "static volatile float sum = 1; int16_t row[40] = { 1 }; TAKT_POINT(INT, row, 0);"
                .into(),
            "sum += row[1];",
            "16 bytes of state at offset 0",
        ),
    ] {
        c(name, &variables, body);
        let image = format!("{name}.plc");
        folder.takt_plc(&["diff", &image, &image]).expect(1, says);
    }
}
