//! `takt plc fmt` as a user calls it.

use std::fs;
use std::os::unix::fs::PermissionsExt;

mod common;
use common::Folder;

const UGLY: &str = "program p\nvar i:int;end_var\ni:=1;\nend_program";
const NEAT: &str = "PROGRAM p\n    VAR\n        i : int;\n    END_VAR\n    i := 1;\nEND_PROGRAM\n";
const WRONG: &str = "PROGRAM p\ni := ;\nEND_PROGRAM\n";

fn text(folder: &Folder, name: &str) -> String {
    String::from_utf8(folder.read(name)).unwrap()
}

#[test]
fn files_are_formatted_in_place_and_then_left() {
    let folder = Folder::new();
    let ugly = folder.write("ugly.st", UGLY);
    folder.write("neat.st", NEAT);
    fs::set_permissions(&ugly, fs::Permissions::from_mode(0o640)).unwrap();
    let ended = folder.takt_plc(&["fmt", "."]).expect(0, "./ugly.st\n");
    assert!(!ended.text.contains("neat.st"), "{}", ended.text);
    assert_eq!(text(&folder, "ugly.st"), NEAT);
    assert_eq!(fs::metadata(&ugly).unwrap().permissions().mode() & 0o7777, 0o640);
    assert_eq!(folder.takt_plc(&["fmt", "--check", "."]).expect(0, "").text, "");
}

#[test]
fn with_check_nothing_is_written() {
    let folder = Folder::new();
    folder.write("ugly.st", UGLY);
    folder.write("neat.st", NEAT);
    let ended = folder.takt_plc(&["fmt", "--check", "ugly.st", "neat.st"]);
    ended.expect(1, "ugly.st\ntakt plc: 1 files are not formatted");
    assert_eq!(text(&folder, "ugly.st"), UGLY);
}

#[test]
fn what_does_not_parse_is_shown_and_left_while_others_are_formatted() {
    let folder = Folder::new();
    folder.write("a.st", WRONG);
    folder.write("b.st", UGLY);
    let ended = folder.takt_plc(&["fmt", "a.st", "b.st"]).expect(2, "error[syntax]: a.st:2:6: ");
    ended.expect(2, "1 files were left as they are");
    assert_eq!(text(&folder, "a.st"), WRONG);
    assert_eq!(text(&folder, "b.st"), NEAT);
    folder.takt_plc(&["fmt", "--check", "a.st"]).expect(2, "error[syntax]");
}

#[test]
fn links_stay_links_and_what_is_read_only_stays_as_it_is() {
    let folder = Folder::new();
    let target = folder.write("target", UGLY);
    std::os::unix::fs::symlink(&target, folder.path().join("link.st")).unwrap();
    folder.takt_plc(&["fmt", "link.st"]).expect(0, "link.st");
    assert!(fs::symlink_metadata(folder.path().join("link.st")).unwrap().is_symlink());
    assert_eq!(text(&folder, "target"), NEAT);
    let locked = folder.write("locked.st", UGLY);
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o444)).unwrap();
    folder.takt_plc(&["fmt", "locked.st"]).expect(2, "locked.st is read-only");
    assert_eq!(text(&folder, "locked.st"), UGLY);
}

#[test]
fn a_project_leaves_its_libraries_as_they_are() {
    let folder = Folder::new();
    for name in ["plant", "plant/parts", "lib"] {
        fs::create_dir(folder.path().join(name)).unwrap();
    }
    folder.write("plant/takt-plc.toml", "name = \"a\"\nlibraries = [\"../lib\", \"parts\"]\n");
    let libraries = ["lib/a.st", "plant/parts/b.st"];
    for library in libraries {
        folder.write(library, UGLY);
    }
    folder.write("plant/main.st", UGLY);
    let ended = folder.takt_plc(&["fmt", "plant"]).expect(0, "plant/main.st\n");
    assert_eq!(ended.text.lines().count(), 1, "{}", ended.text);
    for library in libraries {
        assert_eq!(text(&folder, library), UGLY);
    }
    folder.takt_plc(&["fmt", "--check", "plant"]).expect(0, "");
    folder.takt_plc(&["fmt", "lib"]).expect(0, "lib/a.st");
}

#[test]
fn what_is_no_source_is_refused_by_name() {
    let folder = Folder::new();
    fs::create_dir(folder.path().join("empty")).unwrap();
    fs::write(folder.path().join("binary.st"), [0x7F, 0xFF, 0]).unwrap();
    for (path, message) in [
        ("empty", "no file in this folder ends with .st"),
        ("nothing.st", "cannot read nothing.st"),
        ("binary.st", "byte 1 is not UTF-8 text"),
        ("/dev/zero", "neither a file nor a folder"),
    ] {
        folder.takt_plc(&["fmt", path]).expect(2, message);
    }
}

#[test]
fn a_new_project_is_formatted() {
    let folder = Folder::new();
    folder.takt_plc(&["new", "tank", "--lang", "st"]).expect(0, "");
    folder.takt_plc(&["fmt", "--check", "tank"]).expect(0, "");
}
