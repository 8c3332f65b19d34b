//! Which texts are one project, and that an editor shows no message that no project has.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

use lsp_server::{Message, Notification, Request};
use serde_json::{Value, json};
use takt_lsp::server::{Server, Step};

/// An editor with a folder of projects, and what it shows.
struct Editor {
    server: Server,
    folder: tempfile::TempDir,
    /// The codes of all messages, by file.
    shown: BTreeMap<String, Vec<String>>,
    /// What was told to the user.
    told: Vec<String>,
}

impl Editor {
    /// It opens one of the folders.
    fn new(files: &[(&str, &str)], opened: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (shown, told) = (BTreeMap::new(), Vec::new());
        let mut editor = Self { server: Server::new(), folder, shown, told };
        for (name, text) in files {
            editor.write(name, text);
        }
        let folders = json!([{ "uri": editor.uri(opened), "name": "opened" }]);
        let params = json!({ "capabilities": {}, "workspaceFolders": folders });
        editor.ask("initialize", params).unwrap();
        editor.tell("initialized", json!({}));
        editor
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        let path = self.path(name);
        fs::create_dir_all(path.parent().unwrap_or(Path::new("/"))).unwrap();
        fs::write(path, text).unwrap();
    }

    fn uri(&self, name: &str) -> String {
        format!("file://{}", self.path(name).display())
    }

    fn tell(&mut self, method: &str, params: Value) {
        let one = Notification { method: method.to_owned(), params };
        assert_eq!(self.server.take(one.into()), Step::Next);
        for message in self.server.rest() {
            let Message::Notification(Notification { method, params }) = message else { continue };
            if method == "window/showMessage" {
                self.told.push(params["message"].to_string());
                continue;
            }
            let codes = params["diagnostics"].as_array().unwrap().iter();
            let codes: Vec<String> =
                codes.map(|one| one["code"].as_str().unwrap().into()).collect();
            let root = format!("file://{}/", self.folder.path().display());
            let file = params["uri"].as_str().unwrap().replace(&root, "");
            self.shown.remove(&file);
            if !codes.is_empty() {
                self.shown.insert(file, codes);
            }
        }
    }

    /// The error is its text.
    fn ask(&mut self, method: &str, params: Value) -> Result<Value, String> {
        let request = Request { id: 1.into(), method: method.to_owned(), params };
        assert_eq!(self.server.take(request.into()), Step::Next);
        let sent = self.server.sent();
        let [Message::Response(response)] = &sent[..] else { panic!("{method}: {sent:?}") };
        response.response_result.clone().map_err(|error| error.message)
    }

    fn open(&mut self, name: &str, text: &str) {
        let document =
            json!({ "uri": self.uri(name), "languageId": "st", "version": 1, "text": text });
        self.tell("textDocument/didOpen", json!({ "textDocument": document }));
    }

    fn close(&mut self, name: &str) {
        let document = json!({ "uri": self.uri(name) });
        self.tell("textDocument/didClose", json!({ "textDocument": document }));
    }

    /// Files on the disk have changed.
    fn look(&mut self) {
        self.tell("workspace/didChangeWatchedFiles", json!({ "changes": [] }));
    }

    fn rename(&mut self, name: &str, at: (u32, u32), new: &str) -> Result<Value, String> {
        let mut params = json!({
            "textDocument": { "uri": self.uri(name) },
            "position": { "line": at.0, "character": at.1 },
        });
        let prepared = self.ask("textDocument/prepareRename", params.clone());
        params["newName"] = new.into();
        let renamed = self.ask("textDocument/rename", params);
        assert_eq!(prepared.is_ok(), renamed.is_ok(), "{prepared:?} {renamed:?}");
        renamed
    }

    #[track_caller]
    fn shows(&self, expected: &[(&str, &[&str])]) {
        let found: Vec<(&str, Vec<&str>)> = self
            .shown
            .iter()
            .map(|(file, codes)| (&**file, codes.iter().map(String::as_str).collect()))
            .collect();
        let expected: Vec<(&str, Vec<&str>)> =
            expected.iter().map(|(file, codes)| (*file, codes.to_vec())).collect();
        assert_eq!(found, expected, "{:?}", self.told);
    }
}

const TANK: &str = "name = \"tank\"\nlibraries = [\"../lib\"]\n";
const MAIN: &str = "PROGRAM Main VAR x : INT; END_VAR x := Twice(x); END_PROGRAM\n";
const TWICE: &str =
    "FUNCTION Twice : INT VAR_INPUT x : INT; END_VAR Twice := x * 2; END_FUNCTION\n";

#[test]
fn messages_about_a_library_that_was_open_go_with_it() {
    let files = [("tank/takt-plc.toml", TANK), ("tank/main.st", MAIN), ("lib/twice.st", TWICE)];
    let mut editor = Editor::new(&files, "tank");
    editor.open("lib/twice.st", &TWICE.replace("x * 2", "y * 2"));
    editor.shows(&[("lib/twice.st", &["unknown-name"])]);
    // Not saved.
    editor.close("lib/twice.st");
    editor.shows(&[]);

    // On the disk it is wrong too, which both projects tell: the messages stay when one of them goes.
    editor.write("lib/twice.st", &TWICE.replace("x * 2", "y * 2"));
    editor.look();
    editor.shows(&[("lib/twice.st", &["unknown-name"])]);
    editor.open("lib/other.st", "");
    editor.shows(&[("lib/twice.st", &["unknown-name"])]);
    editor.close("lib/other.st");
    editor.shows(&[("lib/twice.st", &["unknown-name"])]);
}

#[test]
fn messages_about_a_library_stay_while_one_of_its_projects_has_them() {
    let user = |name: &str| TANK.replace("tank", name);
    let (a, b, twice) = (user("a"), user("b"), TWICE.replace("x * 2", "Once(x)"));
    let files = [
        ("a/takt-plc.toml", &*a),
        ("a/main.st", MAIN),
        ("b/takt-plc.toml", &b),
        ("b/main.st", MAIN),
        ("lib/twice.st", &twice),
    ];
    let mut editor = Editor::new(&files, "a");
    let wrong = [("lib/twice.st", &["unknown-name"][..])];
    editor.shows(&wrong);
    editor.open("b/main.st", MAIN);
    editor.shows(&wrong);
    // Nothing is wrong for this project any more.
    editor.open("b/once.st", &TWICE.replace("Twice", "Once"));
    editor.shows(&wrong);
    editor.close("b/once.st");
    editor.shows(&wrong);
}

#[test]
fn messages_go_when_a_project_file_says_what_belongs_together() {
    let mut editor = Editor::new(&[("src/twice.st", TWICE), ("old/twice.st", TWICE)], "");
    assert!(
        editor.shown.values().flatten().any(|code| code == "duplicate-name"),
        "{:?}",
        editor.shown
    );
    editor.write("takt-plc.toml", "name = \"tank\"\nsources = [\"src\"]\n");
    editor.look();
    editor.shows(&[]);
    // And come again without it.
    fs::remove_file(editor.path("takt-plc.toml")).unwrap();
    editor.look();
    assert!(!editor.shown.is_empty());
}

#[test]
fn the_sources_are_known_though_the_project_file_has_a_mistake() {
    let files = [("tank/takt-plc.toml", TANK), ("tank/main.st", MAIN), ("lib/twice.st", TWICE)];
    let mut editor = Editor::new(&files, "tank");
    editor.open("tank/main.st", MAIN);
    editor.shows(&[]);
    editor.write("tank/takt-plc.toml", &format!("{TANK}versoin = \"1.0.0\"\n"));
    editor.look();
    editor.shows(&[("tank/takt-plc.toml", &["project-file"])]);
    let place = json!({ "line": 0, "character": 8 });
    let document = json!({ "uri": editor.uri("tank/main.st") });
    let params = json!({ "textDocument": document, "position": place, "newName": "Other" });
    let refused = editor.ask("textDocument/rename", params).unwrap_err();
    assert!(refused.starts_with("not all uses can be seen: "), "{refused}");
}

#[test]
fn a_text_that_the_project_file_leaves_out_is_no_part_of_the_project() {
    let files = [
        ("takt-plc.toml", "name = \"tank\"\nsources = [\"src\"]\n"),
        ("src/main.st", MAIN),
        ("src/twice.st", TWICE),
        ("old/twice_2023.st", TWICE),
    ];
    let mut editor = Editor::new(&files, "");
    editor.open("src/main.st", MAIN);
    editor.open("old/twice_2023.st", TWICE);
    editor.shows(&[]);
    // Nor does it hide what the build finds.
    editor.open("old/thrice.st", &TWICE.replace("Twice", "Thrice"));
    editor.open("src/more.st", &MAIN.replace("Main", "More").replace("Twice", "Thrice"));
    // A source that is not saved yet is a part.
    editor.shows(&[("src/more.st", &["unknown-name"])]);
    editor.open("src/thrice.st", &TWICE.replace("Twice", "Thrice"));
    editor.shows(&[]);
}

#[test]
fn a_name_of_a_library_that_another_project_uses_stays() {
    let files = [("tank/takt-plc.toml", TANK), ("tank/main.st", MAIN), ("lib/twice.st", TWICE)];
    let mut editor = Editor::new(&files, "tank");
    editor.open("lib/twice.st", TWICE);
    let refused = editor.rename("lib/twice.st", (0, 9), "Double").unwrap_err();
    let says = format!(
        "not all uses can be seen: {} is also a source of the project {}, which is open",
        editor.path("lib/twice.st").display(),
        editor.path("tank").display()
    );
    assert_eq!(refused, says);
    // Which texts it has is not known any more.
    editor.write("tank/takt-plc.toml", &TANK.replace("libraries", "libaries"));
    editor.look();
    let refused = editor.rename("lib/twice.st", (0, 9), "Double").unwrap_err();
    let project = editor.path("tank");
    let says = format!("not all uses can be seen: the project {} is open: ", project.display());
    assert!(refused.starts_with(&says), "{refused}");
    editor.write("tank/takt-plc.toml", TANK);
    editor.look();
    // The project's own names are its own.
    editor.open("tank/main.st", MAIN);
    editor.rename("tank/main.st", (0, 8), "Other").unwrap();
    // No other project has it open.
    let mut editor = Editor::new(&[("lib/twice.st", TWICE)], "lib");
    editor.rename("lib/twice.st", (0, 9), "Double").unwrap();
}

#[test]
fn a_library_beside_a_folder_that_a_link_leads_to_is_found() {
    let files = [
        ("data/tank/takt-plc.toml", TANK),
        ("data/tank/main.st", MAIN),
        ("data/lib/twice.st", TWICE),
    ];
    let mut editor = Editor::new(&files, "tank");
    symlink(editor.path("data/tank"), editor.path("tank")).unwrap();
    editor.look();
    editor.open("tank/main.st", MAIN);
    editor.shows(&[]);
    editor.open("data/lib/twice.st", &TWICE.replace("Twice", "Triple"));
    editor.shows(&[("tank/main.st", &["unknown-name"])]);
}
