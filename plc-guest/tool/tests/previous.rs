//! A new version that takes the places of the running one: what `takt plc diff` says of it.

mod common;

use common::Folder;

fn source(globals: &str, block: &str, variables: &str) -> String {
    format!(
        "TYPE Pair : STRUCT a : INT; b : REAL; END_STRUCT END_TYPE\nVAR_GLOBAL {globals} END_VAR\n\
         FUNCTION_BLOCK Count\nVAR_INPUT x : DINT; END_VAR\n{block}\nsum := sum + x;\nEND_FUNCTION_BLOCK\n\
         PROGRAM Main\nVAR {variables} END_VAR\ncount(x := 1);\nhistory[1] := history[2];\nEND_PROGRAM\n\
         CONFIGURATION Plant\nTASK often (INTERVAL := T#10ms, PRIORITY := 1);\nPROGRAM one WITH often : Main;\n\
         END_CONFIGURATION\n"
    )
}

const OLD: [&str; 3] = [
    "first : INT; couple : Pair; last : LREAL;",
    "VAR sum : DINT; END_VAR",
    "count : Count; history : ARRAY[1..50] OF REAL; toggle : BOOL;",
];

/// What `diff` says of a change to this version.
fn change([globals, block, variables]: [&str; 3], previous: bool) -> String {
    let folder = Folder::new();
    folder.write("old.st", &source(OLD[0], OLD[1], OLD[2]));
    folder.takt_plc(&["build", "old.st", "-o", "old.plc"]).expect(0, "old.plc");
    folder.write("new.st", &source(globals, block, variables));
    let mut words = vec!["build", "new.st", "-o", "new.plc"];
    if previous {
        words.extend(["--previous", "old.plc"]);
    }
    folder.takt_plc(&words).expect(0, "new.plc");
    folder.takt_plc(&["diff", "old.plc", "new.plc"]).text
}

#[test]
fn a_new_variable_moves_nothing_wherever_it_is_declared() {
    let new = [
        "first : INT; fresh : LREAL; couple : Pair; last : LREAL;",
        "VAR level : LREAL; sum : DINT; name : BOOL; END_VAR",
        "gain : LREAL; count : Count; history : ARRAY[1..50] OF REAL; toggle : BOOL;",
    ];
    let without = change(new, false);
    assert!(without.contains("moved"), "{without}");
    let with = change(new, true);
    assert!(!with.contains("moved") && !with.contains("anew"), "{with}");
    for name in ["fresh", "one.gain", "one.count.level", "one.count.name"] {
        assert!(
            with.lines().any(|line| line.contains("new ") && line.contains(name)),
            "{name}: {with}"
        );
    }
}

#[test]
fn order_and_removal_move_nothing() {
    let new = [
        "last : LREAL; couple : Pair;",
        "VAR sum : DINT; END_VAR",
        "toggle : BOOL; history : ARRAY[1..50] OF REAL; count : Count;",
    ];
    let with = change(new, true);
    assert!(!with.contains("moved"), "{with}");
    assert!(with.contains("dropped      first"), "{with}");
}

#[test]
fn what_goes_or_moves_leaves_nothing_that_forbids_the_next_change() {
    let version = |number: u32, globals: &str, previous: Option<u32>, folder: &Folder| {
        folder.write(&format!("{number}.st"), &source(globals, OLD[1], OLD[2]));
        let (from, to) = (format!("{number}.st"), format!("{number}.plc"));
        let mut words = vec!["build", &from, "-o", &to];
        let before = previous.map(|previous| format!("{previous}.plc"));
        words.extend(before.iter().flat_map(|before| ["--previous", before]));
        folder.takt_plc(&words).expect(0, &to);
    };
    let folder = Folder::new();
    version(1, "first : INT; wide : ARRAY[1..20] OF REAL; last : LREAL;", None, &folder);
    version(2, "first : INT; last : LREAL;", Some(1), &folder);
    version(3, "first : INT; last : LREAL; fresh : DINT;", Some(2), &folder);
    for (old, new) in [(1, 2), (2, 3)] {
        let files = [format!("{old}.plc"), format!("{new}.plc")];
        let told = folder.takt_plc(&["diff", &files[0], &files[1]]).expect(0, "").text;
        assert!(!told.contains("moved") && !told.contains("last "), "{told}");
    }
}

#[test]
fn what_outgrows_its_room_moves_alone() {
    let new = [OLD[0], "VAR sum : DINT; row : ARRAY[1..20] OF LREAL; END_VAR", OLD[2]];
    let with = change(new, true);
    assert!(with.contains("moved"), "{with}");
    assert!(!with.contains("last ") && !with.contains("history"), "{with}");
}

#[test]
fn messages_inputs_and_outputs_lie_as_their_types_say() {
    let version = |fields: &str, inner: &str| {
        format!(
            "TYPE Inner : STRUCT {inner} END_STRUCT END_TYPE\n\
             TYPE Message : STRUCT {fields} rows : ARRAY[0..1] OF Inner; END_STRUCT END_TYPE\n\
             TYPE Own : STRUCT {fields} END_STRUCT END_TYPE\n\
             VAR_GLOBAL sent : Message; next : LINT; mine : Own; END_VAR\n\
             PROGRAM Main\nVAR x AT %ID0 : DINT; END_VAR\nsent.one := x; mine.one := x; next := mine.one;\n\
             CHANNEL_WRITE('out', sent);\nEND_PROGRAM\n\
             CONFIGURATION Plant\nTASK often (INTERVAL := T#10ms, PRIORITY := 1);\n\
             PROGRAM one WITH often : Main;\nEND_CONFIGURATION\n"
        )
    };
    let folder = Folder::new();
    folder.write("old.st", &version("one : DINT; two : DINT;", "a : INT; b : INT;"));
    folder.takt_plc(&["build", "old.st", "-o", "old.plc"]).expect(0, "old.plc");
    folder.write(
        "new.st",
        &version("two : DINT; one : DINT; three : DINT;", "c : DINT; b : INT; a : INT;"),
    );
    folder.takt_plc(&["build", "new.st", "-o", "alone.plc"]).expect(0, "alone.plc");
    let previous = ["build", "new.st", "-o", "new.plc", "--previous", "old.plc"];
    folder.takt_plc(&previous).expect(0, "new.plc");
    let fields = |image: &str, name: &str| -> Vec<(String, u32)> {
        let bytes = folder.read(image);
        let image = takt_program::Image::parse(&bytes).expect("an image");
        let ty = image.types().find(|ty| ty.name == name).expect("the type");
        image.fields(&ty).map(|field| (field.name.to_owned(), field.offset)).collect()
    };
    for name in ["Message", "Inner"] {
        assert_eq!(fields("new.plc", name), fields("alone.plc", name), "{name}");
    }
    assert_ne!(
        fields("new.plc", "Own"),
        fields("alone.plc", "Own"),
        "the places of the old version"
    );
    folder.takt_plc(&["inspect", "new.plc"]).expect(0, "port 0: out out, 28 bytes");
}

#[test]
fn the_same_source_gives_the_same_layout_and_a_file_that_is_no_image_is_refused() {
    let with = change(OLD, true);
    assert!(!with.contains("moved") && !with.contains("new  "), "{with}");
    let folder = Folder::new();
    folder.write("main.st", &source(OLD[0], OLD[1], OLD[2]));
    folder.write("old.plc", "no image");
    folder.takt_plc(&["build", "main.st", "--previous", "old.plc"]).expect(2, "old.plc: ");
    folder.write("a.o", "!<arch>\n");
    let words = ["build", "a.o", "-o", "a.plc", "--previous", "old.plc"];
    folder.takt_plc(&words).expect(2, "for Structured Text");
}

#[test]
fn the_memory_of_an_edge_stays_beside_a_variable_of_nearly_its_name() {
    let source = |fresh: &str| {
        format!(
            "FUNCTION_BLOCK Counter\nVAR_INPUT ready : BOOL; more : DINT; start : BOOL R_EDGE; END_VAR\n\
             VAR start_last : BOOL; {fresh} END_VAR\nVAR_OUTPUT n : DINT; END_VAR\n\
             IF ready AND start AND NOT start_last THEN n := n + more; END_IF;\nstart_last := ready;\n\
             END_FUNCTION_BLOCK\n\
             PROGRAM Main\nVAR count : Counter; lamp AT %QX0.0 : BOOL; END_VAR\n\
             count(ready := TRUE, more := 1, start := lamp);\nlamp := count.n > 0;\nEND_PROGRAM\n\
             CONFIGURATION c\nTASK t (INTERVAL := T#1ms, PRIORITY := 1);\n\
             PROGRAM one WITH t : Main;\nEND_CONFIGURATION\n"
        )
    };
    let folder = Folder::new();
    folder.write("old.st", &source(""));
    folder.takt_plc(&["build", "old.st", "-o", "old.plc"]).expect(0, "old.plc");
    for (name, fresh) in [("same", ""), ("more", "fresh : LREAL;")] {
        let (from, to) = (format!("{name}.st"), format!("{name}.plc"));
        folder.write(&from, &source(fresh));
        let words = ["build", &from, "-o", &to, "--previous", "old.plc"];
        folder.takt_plc(&words).expect(0, &to);
        let told = folder.takt_plc(&["diff", "old.plc", &to]).expect(0, "").text;
        let touched = |line: &&str| line.contains("one.count.");
        let touched: Vec<&str> = told.lines().filter(touched).collect();
        assert!(touched.iter().all(|line| line.contains("new ")), "{told}");
        assert_eq!(touched.len(), usize::from(!fresh.is_empty()), "{told}");
    }
}
