//! `takt plc import`.

mod common;

use common::Folder;

const PROJECT: &str = "<project><types><pous>\
    <pou name=\"Good\" pouType=\"program\"><body><ST>;</ST></body></pou>\
    <pou name=\"Drawn\" pouType=\"program\"><body><LD/></body></pou>\
    </pous></types></project>";

#[test]
fn what_is_structured_text_is_written_and_the_rest_is_named() {
    let folder = Folder::new();
    folder.write("plant.xml", PROJECT);
    let ended = folder.takt_plc(&["import", "plant.xml", "plant"]);
    ended
        .expect(1, "plant.xml:1:129: program Drawn: its body is LD")
        .expect(1, "1 parts were refused");
    assert_eq!(folder.read("plant/Good.st"), b"PROGRAM Good\n;\nEND_PROGRAM\n");
    assert!(!folder.path().join("plant/Drawn.st").exists());
}

#[test]
fn what_is_refused_beyond_a_thousand_parts_is_counted() {
    let folder = Folder::new();
    let drawn = "<pou name=\"Drawn\" pouType=\"program\"><body><LD/></body></pou>".repeat(1003);
    folder.write("plant.xml", &format!("<project><types><pous>{drawn}</pous></types></project>"));
    let ended = folder.takt_plc(&["import", "plant.xml", "plant"]);
    ended.expect(1, "plant.xml: 3 parts more were refused").expect(1, "1003 parts were refused");
}

#[test]
fn nothing_that_is_there_is_written_over() {
    let folder = Folder::new();
    folder.write("plant.xml", PROJECT);
    std::fs::create_dir(folder.path().join("plant")).unwrap();
    folder.takt_plc(&["import", "plant.xml", "plant"]).expect(2, "cannot make plant");
    assert!(!folder.path().join("plant/Good.st").exists());
}

#[test]
fn what_cannot_be_written_as_a_whole_leaves_no_folder() {
    let folder = Folder::new();
    folder.write("plant.xml", PROJECT);
    // As if the disk were full.
    let full = |words: &str| {
        let words = format!("trap '' XFSZ; ulimit -f 0; exec \"$TAKT\" plc {words}");
        folder.run("sh", &["-c", &words])
    };
    full("import plant.xml plant").expect(2, "cannot write plant/");
    assert!(!folder.path().join("plant").exists());
    full("new around/tank --lang st").expect(2, "cannot write around/tank/");
    assert!(!folder.path().join("around/tank").exists());
    // So the next try finds nothing in its way.
    folder.takt_plc(&["import", "plant.xml", "plant"]).expect(1, "plant/Good.st");
    folder.takt_plc(&["new", "around/tank", "--lang", "st"]).expect(0, "");
}

#[test]
fn what_is_no_project_makes_no_folder() {
    let folder = Folder::new();
    folder.write("plant.xml", "<svg/>");
    folder.takt_plc(&["import", "plant.xml", "plant"]).expect(2, "not a PLCopen <project>");
    folder.takt_plc(&["import", "none.xml", "plant"]).expect(2, "cannot read none.xml");
    folder.write("plant.xml", "<project/>");
    folder.takt_plc(&["import", "plant.xml", "plant"]).expect(2, "found no types, units");
    assert!(!folder.path().join("plant").exists());
}
