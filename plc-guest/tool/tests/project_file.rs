//! Commands without arguments in the folder of a project file, and inputs that are no sources.

mod common;

use common::Folder;

#[test]
fn a_new_project_is_checked_formatted_tested_and_built_without_arguments() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "st"]).expect(0, "");
    let inside = |words: &[&str]| folder.takt_plc_in("tank", words);
    let checked = inside(&["check"]).expect(0, "");
    assert_eq!(checked.text, "", "a new project has no warning");
    inside(&["fmt", "--check"]).expect(0, "");
    let ended = inside(&["test", "--junit", "report.xml"]);
    let ended = ended.expect(0, "tank: 3 tests, all as expected");
    let ended = ended.expect(0, "ok     tests/pi_test.st:3: the integral part grows with time");
    ended.expect(0, "ok     tests/tank.csv");
    let xml = String::from_utf8(folder.read("tank/report.xml")).unwrap();
    assert!(xml.contains("<testcase name=\"tests/tank.csv\" classname=\"tank\""), "{xml}");
    inside(&["build"]).expect(0, "tank.plc: tank 0.1.0");
    // A table that is not met is a failure of the project's tests.
    let table = String::from_utf8(folder.read("tank/tests/tank.csv")).unwrap();
    folder.write("tank/tests/tank.csv", &table.replace("0.1055", "0.1155"));
    let ended = inside(&["test"]).expect(1, "FAILED tests/tank.csv");
    ended.expect(1, "3 tests, 1 failed, 0 broken");
}

#[test]
fn libraries_are_folders_of_which_only_what_is_used_counts() {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.path().join("lib")).unwrap();
    std::fs::create_dir_all(folder.path().join("plant")).unwrap();
    folder.write(
        "lib/maths.st",
        "FUNCTION twice : INT\nVAR_INPUT x : INT; END_VAR\nVAR unused : INT; END_VAR\ntwice := 2 * x;\nEND_FUNCTION\n\
         FUNCTION broken : INT\nbroken := none;\nEND_FUNCTION\n",
    );
    folder.write(
        "plant/main.st",
        "PROGRAM Main\nVAR q AT %QW0 : INT; END_VAR\nq := twice(4);\nEND_PROGRAM\nCONFIGURATION c\n\
         TASK t (INTERVAL := T#1ms, PRIORITY := 1);\nPROGRAM p WITH t : Main;\nEND_CONFIGURATION\n",
    );
    folder.write(
        "plant/takt-plc.toml",
        "name = \"plant\"\nversion = \"2.0.1\"\ncategory = 7\nlibraries = [\"../lib\"]\n",
    );
    let built = folder.takt_plc(&["build", "plant"]).expect(0, "plant.plc: plant 2.0.1");
    assert!(!built.text.contains("unused"), "{}", built.text);
    folder.takt_plc(&["inspect", "plant.plc"]).expect(0, "category 7");
    folder.write("t.csv", "Main.q\n8\n");
    folder.takt_plc(&["test", "plant.plc", "t.csv"]).expect(0, "all as expected");
}

#[test]
fn a_mistake_in_the_project_file_is_told_with_line_and_column() {
    let folder = Folder::new();
    folder.write("takt-plc.toml", "name = \"plant\"\nsorces = [\"src\"]\n");
    for command in ["build", "check", "test", "fmt"] {
        let ended = folder.takt_plc(&[command]);
        let ended = ended.expect(2, "error[project-file]: takt-plc.toml:2:1: unknown key `sorces`");
        ended.expect(2, "  hint: did you mean `sources`?");
    }
    let ended = folder.takt_plc(&["check", "--message-format", "json"]);
    let ended = ended.expect(2, "\"code\":\"project-file\",\"message\":\"unknown key `sorces`\"");
    ended.expect(2, "\"place\":{\"file\":\"takt-plc.toml\",\"line\":2,\"column\":1,");
}

#[test]
fn what_is_no_source_is_refused_with_a_reason() {
    let folder = Folder::new();
    folder.takt_plc(&["build"]).expect(2, "found no takt-plc.toml in this folder");
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    folder.takt_plc(&["build", "empty"]).expect(2, "empty: no file in this folder ends with .st");
    std::fs::create_dir(folder.path().join("folder.st")).unwrap();
    folder.takt_plc(&["build", "folder.st"]).expect(2, "no file in this folder ends with .st");
    std::fs::copy(env!("CARGO_BIN_EXE_takt-plc"), folder.path().join("binary.st")).unwrap();
    let ended = folder.takt_plc(&["build", "binary.st"]);
    assert!(
        ended.text.contains("not UTF-8") || ended.text.contains("more than 8388608 bytes"),
        "{}",
        ended.text
    );
    ended.expect(2, "binary.st:");
    folder.write("zeros.st", "PROGRAM \0 Main\nEND_PROGRAM\n");
    folder.takt_plc(&["build", "zeros.st"]).expect(2, "zeros.st:1:9: byte 8 is not UTF-8 text");
    folder.write("long.st", &"x := 1; ".repeat(10 << 17));
    folder.takt_plc(&["build", "long.st"]).expect(2, "long.st: more than 8388608 bytes");
    // As long as a file may be, in one line: one message, and the line is cut.
    folder.write("line.st", &"x := 1; ".repeat((8 << 20) / 8));
    let ended = folder.takt_plc(&["build", "line.st"]);
    assert!(ended.text.len() < 10_000, "{} bytes", ended.text.len());
    ended.expect(2, "line.st:1:1: `x` cannot stand here");
}

/// Each thing with the words that say what it is.
#[test]
fn build_says_what_it_was_given_instead_of_a_source() {
    let folder = Folder::new();
    std::fs::copy(env!("CARGO_BIN_EXE_takt-plc"), folder.path().join("tool")).unwrap();
    let program = "PROGRAM Main\nEND_PROGRAM\n\
                   CONFIGURATION c\nTASK t (INTERVAL := T#1ms, PRIORITY := 1);\nPROGRAM p WITH t : Main;\n\
                   END_CONFIGURATION\n";
    folder.write("main.st", program);
    folder.takt_plc(&["build", "main.st"]).expect(0, "");
    folder.write("main.txt", program);
    folder.write("empty", "");
    folder.write("garbage", "\u{1}\0\u{2}");
    for (path, says) in [
        ("tool", "error[no-source]: tool: found an ELF program"),
        ("main.plc", "error[no-source]: main.plc: found a program image of Takt"),
        ("main.txt", "error[no-source]: main.txt: found text in a file whose name does not end"),
        ("empty", "error[no-source]: empty: found an empty file"),
        ("garbage", "error[no-source]: garbage: found a binary file of another kind"),
        ("/dev/null", "error[no-source]: /dev/null: found a device, socket or pipe"),
        ("none.o", "error[cannot-read]: none.o: cannot be read: "),
    ] {
        let alone = folder.takt_plc(&["build", path]).expect(2, says);
        alone.expect(2, "allowed: Structured Text (.st)");
        folder.takt_plc(&["build", path, "-o", "x.plc"]).expect(2, says);
        folder.takt_plc(&["build", "main.st", path]).expect(2, says);
    }
    let ended = folder.takt_plc(&["build", "--message-format", "json", "main.plc", "empty"]);
    let ended = ended.expect(2, "\"code\":\"no-source\"");
    ended.expect(2, "\"place\":{\"file\":\"main.plc\"}").expect(2, "takt plc: 2 errors");
}

#[test]
fn what_cannot_be_built_is_told_with_code_and_place() {
    let folder = Folder::new();
    folder.write("main.st", "FUNCTION f : INT\nf := 1;\nEND_FUNCTION\nPROGRAM Main\nEND_PROGRAM\n");
    // It may be a library.
    folder.takt_plc(&["check", "main.st"]).expect(0, "");
    let ended = folder.takt_plc(&["build", "main.st"]);
    ended.expect(2, "error[no-task]: main.st:4:9: nothing runs a program");
    let ended = folder.takt_plc(&["build", "--message-format", "json", "main.st"]);
    ended.expect(2, "\"code\":\"no-task\"");
    let ended = folder.takt_plc(&["check", "--message-format", "json"]);
    ended.expect(2, "\"message\":\"found no takt-plc.toml in this folder\"");
}

#[test]
fn a_program_of_a_library_that_a_configuration_runs_is_compiled() {
    let folder = Folder::new();
    std::fs::create_dir_all(folder.path().join("lib")).unwrap();
    folder.write(
        "lib/count.st",
        "VAR_GLOBAL\nq AT %QW0 : INT;\nEND_VAR\nPROGRAM Count\nq := q + 1;\nEND_PROGRAM\n",
    );
    folder.write(
        "main.st",
        "CONFIGURATION c\nTASK t (INTERVAL := T#1ms, PRIORITY := 1);\nPROGRAM p WITH t : Count;\nEND_CONFIGURATION\n",
    );
    folder.write("takt-plc.toml", "name = \"plant\"\nlibraries = [\"lib\"]\n");
    folder.takt_plc(&["build"]).expect(0, "plant.plc: plant 0.0.0");
    folder.write("t.csv", "q\n1\n2\n");
    folder.takt_plc(&["test", "plant.plc", "t.csv"]).expect(0, "all as expected");
    // What is wrong in such a program is told.
    folder.write("lib/count.st", "PROGRAM Count\nq := q + 1;\nEND_PROGRAM\n");
    folder.takt_plc(&["check"]).expect(2, "lib/count.st:2:1: there is no variable `q`");
}

#[test]
fn no_output_replaces_what_is_read() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "st"]).expect(0, "");
    let inside = |words: &[&str]| folder.takt_plc_in("tank", words);
    inside(&["build"]).expect(0, "tank.plc");
    for file in ["main.st", "./tests/../main.st", "takt-plc.toml"] {
        let before = folder.read(&format!("tank/{file}"));
        inside(&["build", "-o", file]).expect(2, "would be overwritten");
        inside(&["test", "--junit", file]).expect(2, "would be overwritten");
        assert!(before == folder.read(&format!("tank/{file}")), "{file}");
    }
    let table = "tests/tank.csv";
    inside(&["build", "main.st", "-o", "main.st"]).expect(2, "main.st would be overwritten");
    inside(&["test", "--junit", table]).expect(2, "tests/tank.csv would be overwritten");
    inside(&["test", "tank.plc", table, "--junit", table]).expect(2, "would be overwritten");
    inside(&["test", "tank.plc", "--junit", "tank.plc"]).expect(2, "would be overwritten");
    inside(&["build", "-o", "tests"]).expect(2, "cannot write tests: it is a folder");
    let of_running = |words: &[&str]| {
        let before = folder.read("tank/tank.plc");
        inside(words).expect(2, "tank.plc would be overwritten");
        assert!(before == folder.read("tank/tank.plc"));
    };
    of_running(&["build", "--previous", "tank.plc"]);
    let project = String::from_utf8(folder.read("tank/takt-plc.toml")).unwrap();
    folder.write("tank/takt-plc.toml", &format!("previous = \"tank.plc\"\n{project}"));
    of_running(&["build"]);
    inside(&["build", "-o", "next.plc"]).expect(0, "next.plc");
    of_running(&["build", "--previous", "next.plc"]);
    of_running(&["test", "--junit", "tank.plc"]);
    inside(&["test"]).expect(0, "tank: 3 tests, all as expected");
}

#[test]
fn the_tool_ends_without_a_word_when_nobody_reads() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "st"]).expect(0, "");
    folder.takt_plc(&["build", "tank"]).expect(0, "");
    let plant = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"10ms\"\n\
        [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"16MiB\"\n\
        [[partition.program]]\nimage = \"tank.plc\"\n[[schedule]]\nname = \"normal\"\n\
        [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"5ms\"\n";
    folder.write("plant.toml", plant);
    for words in [["inspect", "tank.plc"], ["points", "plant.toml"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_takt-plc"));
        command.args(words).current_dir(folder.path()).stdout(writer);
        let ended = command.stderr(std::process::Stdio::piped()).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&ended.stderr), "", "{words:?}");
        assert_eq!(ended.status.code(), Some(141), "{words:?}");
    }
}

#[test]
fn the_current_folder_has_a_name_in_messages() {
    let folder = Folder::new();
    folder.write("takt-plc.toml", "name = \"plant\"\n");
    folder.takt_plc(&["fmt"]).expect(2, "takt plc: .: no file in this folder ends with .st");
}
