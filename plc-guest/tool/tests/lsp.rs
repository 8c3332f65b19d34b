//! `takt plc lsp` as an editor uses it: a whole session with the program, message by message.
//!
//! The client waits only for what it expects. The long timeout ends a test that would hang.

mod common;

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use common::Folder;
use serde_json::{Value, json};

struct Client {
    server: Child,
    input: Option<ChildStdin>,
    messages: Receiver<Value>,
    requests: i64,
    folder: Folder,
}

impl Client {
    fn start(folder: Folder) -> Self {
        let mut server = Command::new(env!("CARGO_BIN_EXE_takt-plc"))
            .args(["lsp", "--stdio"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut output = BufReader::new(server.stdout.take().unwrap());
        let (sender, messages) = channel();
        std::thread::spawn(move || {
            while let Some(message) = read(&mut output) {
                if sender.send(message).is_err() {
                    return;
                }
            }
        });
        let input = server.stdin.take();
        Self { server, input, messages, requests: 0, folder }
    }

    fn send(&mut self, mut message: Value) {
        message["jsonrpc"] = json!("2.0");
        let text = message.to_string();
        let input = self.input.as_mut().unwrap();
        write!(input, "Content-Length: {}\r\n\r\n{text}", text.len()).unwrap();
        input.flush().unwrap();
    }

    fn tell(&mut self, method: &str, params: Value) {
        self.send(json!({ "method": method, "params": params }));
    }

    fn next(&self) -> Value {
        self.messages.recv_timeout(Duration::from_secs(120)).expect("the server says something")
    }

    /// The answer to a request. What the server says before is left out.
    fn ask_all(&mut self, method: &str, params: Value) -> Value {
        self.requests += 1;
        self.send(json!({ "id": self.requests, "method": method, "params": params }));
        loop {
            let message = self.next();
            if message["id"] == json!(self.requests) && message.get("method").is_none() {
                return message;
            }
        }
    }

    fn ask(&mut self, method: &str, params: Value) -> Value {
        let answer = self.ask_all(method, params);
        assert!(answer.get("error").is_none(), "{method}: {answer}");
        answer["result"].clone()
    }

    fn uri(&self, file: &str) -> String {
        format!("file://{}/{file}", self.folder.path().display())
    }

    fn open(&mut self, file: &str, text: &str) {
        let document =
            json!({ "uri": self.uri(file), "languageId": "st", "version": 1, "text": text });
        self.tell("textDocument/didOpen", json!({ "textDocument": document }));
    }

    /// A question about the first place of `word` in the text.
    fn at(&mut self, method: &str, file: &str, text: &str, word: &str) -> Value {
        let params = self.place(file, text, word);
        self.ask(method, params)
    }

    fn place(&self, file: &str, text: &str, word: &str) -> Value {
        let before = &text[..text.find(word).expect("the word is there")];
        let line = before.matches('\n').count();
        let start = before.rfind('\n').map_or(0, |at| at + 1);
        let character = before[start..].encode_utf16().count();
        json!({
            "textDocument": { "uri": self.uri(file) },
            "position": { "line": line, "character": character },
        })
    }

    /// The messages about a file that the server tells of next: their codes and first places.
    fn diagnostics(&self, file: &str) -> Vec<(String, u64, u64)> {
        loop {
            let message = self.next();
            let params = &message["params"];
            if message["method"] == "textDocument/publishDiagnostics"
                && params["uri"] == json!(self.uri(file))
            {
                let all = params["diagnostics"].as_array().unwrap().iter();
                return all
                    .map(|one| {
                        let start = &one["range"]["start"];
                        let number = |name: &str| start[name].as_u64().unwrap();
                        let code = one["code"].as_str().unwrap_or_default().to_owned();
                        (code, number("line"), number("character"))
                    })
                    .collect();
            }
        }
    }

    fn initialize(&mut self) {
        let root = format!("file://{}", self.folder.path().display());
        let answer = self.ask(
            "initialize",
            json!({
                "processId": null,
                "capabilities": { "workspace": { "workspaceEdit": { "documentChanges": true } } },
                "workspaceFolders": [{ "uri": root, "name": "plant" }],
            }),
        );
        assert_eq!(answer["capabilities"]["positionEncoding"], "utf-16");
        self.tell("initialized", json!({}));
    }

    fn end(mut self) -> i32 {
        drop(self.input.take());
        self.server.wait().unwrap().code().expect("it ended by itself")
    }
}

fn read(output: &mut impl BufRead) -> Option<Value> {
    let mut length = 0;
    loop {
        let mut line = String::new();
        if output.read_line(&mut line).ok()? == 0 {
            return None;
        }
        match line.trim_end() {
            "" => break,
            line => {
                if let Some(value) = line.strip_prefix("Content-Length: ") {
                    length = value.parse().ok()?;
                }
            }
        }
    }
    let mut bytes = vec![0; length];
    output.read_exact(&mut bytes).ok()?;
    serde_json::from_slice(&bytes).ok()
}

const TYPES: &str = "TYPE\n    (* Füllstand 😀 *) Tank : STRUCT\n        level : REAL; // In metres.\n    \
                     END_STRUCT;\n    Mode : (Idle, Filling);\nEND_TYPE\n";

const MAIN: &str = "PROGRAM Main\n    VAR\n        tank : Tank;\n        mode : Mode;\n    END_VAR\n    \
                    (* 😀 *) tank.levl := 1.0;\n    mode := Filling;\nEND_PROGRAM\n\
                    CONFIGURATION Plant\n    TASK often (INTERVAL := T#10ms, PRIORITY := 1);\n    \
                    PROGRAM one WITH often : Main;\nEND_CONFIGURATION\n";

#[test]
fn an_editor_goes_through_a_whole_session() {
    let folder = Folder::new();
    folder.write("types.st", TYPES);
    // On the disk there is something else than in the editor.
    folder.write("main.st", "PROGRAM Main END_PROGRAM");
    let mut client = Client::start(folder);
    client.initialize();

    // An error appears, counted in UTF-16 units, and an edit mends it.
    client.open("main.st", MAIN);
    assert_eq!(client.diagnostics("main.st"), [("unknown-name".to_owned(), 5, 18)]);
    let range =
        json!({ "start": { "line": 5, "character": 18 }, "end": { "line": 5, "character": 22 } });
    client.tell(
        "textDocument/didChange",
        json!({
            "textDocument": { "uri": client.uri("main.st"), "version": 2 },
            "contentChanges": [{ "range": range, "text": "level" }],
        }),
    );
    assert_eq!(client.diagnostics("main.st"), []);
    let main = MAIN.replace("levl", "level");

    // What a name is, and where it is declared.
    let hover = client.at("textDocument/hover", "main.st", &main, "level");
    let text = hover["contents"]["value"].as_str().unwrap();
    assert!(text.contains("Tank.level : REAL") && text.contains("In metres."), "{text}");
    let place = client.at("textDocument/definition", "main.st", &main, "level");
    assert_eq!(place["uri"], json!(client.uri("types.st")));
    assert_eq!(place["range"]["start"], json!({ "line": 2, "character": 8 }));
    let place = client.at("textDocument/definition", "main.st", &main, "Tank;");
    assert_eq!(place["range"]["start"], json!({ "line": 1, "character": 23 }));

    // Members behind a dot that was just typed.
    client.tell(
        "textDocument/didChange",
        json!({
            "textDocument": { "uri": client.uri("main.st"), "version": 3 },
            "contentChanges": [{ "text": main.replace("tank.level", "tank.") }],
        }),
    );
    let offered = client.at("textDocument/completion", "main.st", &main, "level");
    let labels: Vec<&str> = offered["items"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|one| one["label"].as_str())
        .collect();
    assert_eq!(labels, ["level"]);
    assert_eq!(offered["items"][0]["detail"], "REAL");
    client.tell(
        "textDocument/didChange",
        json!({
            "textDocument": { "uri": client.uri("main.st"), "version": 4 },
            "contentChanges": [{ "text": main }],
        }),
    );

    // A new name in both files; one of them is not open.
    let mut place = client.place("main.st", &main, "level");
    place["newName"] = json!("height");
    let edit = client.ask("textDocument/rename", place.clone());
    let changes = edit["documentChanges"].as_array().unwrap();
    assert_eq!(changes.len(), 2, "{edit}");
    assert_eq!(changes[0]["textDocument"], json!({ "uri": client.uri("main.st"), "version": 4 }));
    assert_eq!(
        changes[1]["textDocument"],
        json!({ "uri": client.uri("types.st"), "version": null })
    );
    assert_eq!(changes[1]["edits"][0]["newText"], "height");
    place["newName"] = json!("END_IF");
    let refused = client.ask_all("textDocument/rename", place);
    assert!(
        refused["error"]["message"].as_str().unwrap().contains("cannot be a name"),
        "{refused}"
    );

    // Layout, outline, uses.
    let untidy = main.replace("    mode := Filling;", "mode:=Filling;");
    client.tell(
        "textDocument/didChange",
        json!({
            "textDocument": { "uri": client.uri("main.st"), "version": 5 },
            "contentChanges": [{ "text": untidy }],
        }),
    );
    let options = json!({ "tabSize": 4, "insertSpaces": true });
    let uri = client.uri("main.st");
    let edits = client.ask(
        "textDocument/formatting",
        json!({ "textDocument": { "uri": uri }, "options": options }),
    );
    assert_eq!(edits[0]["newText"], "    mode := Filling;\n");
    assert_eq!(edits[0]["range"]["start"], json!({ "line": 6, "character": 0 }));
    assert_eq!(edits.as_array().unwrap().len(), 1);
    let outline =
        client.ask("textDocument/documentSymbol", json!({ "textDocument": { "uri": uri } }));
    assert_eq!(outline[0]["name"], "Main");
    assert_eq!(outline[0]["children"][0]["name"], "tank");
    assert_eq!(outline[1]["name"], "Plant");
    let mut place = client.place("main.st", &main, "tank :");
    place["context"] = json!({ "includeDeclaration": false });
    let uses = client.ask("textDocument/references", place);
    assert_eq!(uses.as_array().unwrap().len(), 1);

    // Closed, the file is what is on the disk.
    client.tell("textDocument/didClose", json!({ "textDocument": { "uri": uri } }));
    let outline =
        client.ask("textDocument/documentSymbol", json!({ "textDocument": { "uri": uri } }));
    assert_eq!(outline.as_array().unwrap().len(), 1);

    assert_eq!(client.ask("shutdown", Value::Null), Value::Null);
    client.tell("exit", Value::Null);
    assert_eq!(client.end(), 0);
}

#[test]
fn a_project_file_says_what_belongs_together() {
    let folder = Folder::new();
    for name in ["plant", "plant/tests", "lib"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
    }
    folder.write("plant/takt-plc.toml", "name = \"plant\"\nlibraries = [\"../lib\"]\n");
    let function = "FUNCTION Twice : INT VAR_INPUT x : INT; END_VAR Twice := x * 2; END_FUNCTION\n";
    folder.write("lib/twice.st", function);
    // Of no project, and it would be a second Twice.
    folder.write("other.st", function);
    let test = "TEST 'two'\nASSERT(Twice(x := 1) = Two);\nEND_TEST\n";
    folder.write("plant/tests/two.st", test);
    let main = "PROGRAM Main VAR x : INT; END_VAR x := Twice(x); END_PROGRAM\n";
    let mut client = Client::start(folder);
    client.initialize();
    client.open("plant/main.st", main);
    assert_eq!(client.diagnostics("plant/main.st"), []);
    assert_eq!(client.diagnostics("plant/tests/two.st"), [("unknown-name".to_owned(), 1, 23)]);
    let place = client.at("textDocument/definition", "plant/main.st", main, "Twice");
    assert_eq!(place["uri"], json!(client.uri("lib/twice.st")));
    let mut place = client.place("plant/main.st", main, "Twice");
    place["newName"] = json!("Double");
    let refused = client.ask_all("textDocument/rename", place);
    assert!(refused["error"]["message"].as_str().unwrap().contains("in a library"), "{refused}");
    // A change of the library that is not saved reaches the project.
    client.open("lib/twice.st", &function.replace("Twice", "Triple"));
    assert_eq!(client.diagnostics("plant/main.st"), [("unknown-name".to_owned(), 0, 39)]);
    // So does one of the project file.
    std::fs::write(client.folder.path().join("plant/takt-plc.toml"), "name = \"plant\"\nx = 1\n")
        .unwrap();
    client.tell("workspace/didChangeWatchedFiles", json!({ "changes": [] }));
    // At its place, and to the user.
    let file = client.uri("plant/takt-plc.toml");
    let (mut at_its_place, mut to_the_user) = (false, false);
    while !(at_its_place && to_the_user) {
        let message = client.next();
        if message["params"]["uri"] == json!(file) {
            let one = &message["params"]["diagnostics"][0];
            assert_eq!(one["code"], "project-file", "{message}");
            assert_eq!(one["range"]["start"], json!({ "line": 1, "character": 0 }), "{message}");
            assert_eq!(one["range"]["end"], json!({ "line": 1, "character": 1 }), "{message}");
            at_its_place = true;
        }
        if message["method"] == "window/showMessage" {
            assert!(
                message["params"]["message"].as_str().unwrap().contains("unknown key"),
                "{message}"
            );
            to_the_user = true;
        }
    }
    // Which files have uses is not known now.
    let mut place = client.place("plant/main.st", main, "Main");
    place["newName"] = json!("Other");
    let refused = client.ask_all("textDocument/rename", place);
    let message = refused["error"]["message"].as_str().unwrap();
    assert!(message.starts_with("not all uses can be seen: "), "{refused}");
}

#[test]
fn what_only_compiling_finds_is_shown_too() {
    let mut client = Client::start(Folder::new());
    client.initialize();
    let large = "FUNCTION Large : INT\n\
                 VAR a : ARRAY[1..800000] OF INT; i : INT; END_VAR\n\
                 a[i + 1] := i; Large := a[i + 2];\nEND_FUNCTION\n\
                 PROGRAM Main\nVAR x AT %QW0 : INT; END_VAR\nx := Large();\nEND_PROGRAM\n\
                 CONFIGURATION c\nTASK t (INTERVAL := T#1ms, PRIORITY := 1);\n\
                 PROGRAM p WITH t : Main;\nEND_CONFIGURATION\n";
    client.open("main.st", large);
    let found = client.diagnostics("main.st");
    assert!(found.contains(&("stack-too-large".to_owned(), 9, 5)), "{found:?}");
    client.tell(
        "textDocument/didChange",
        json!({
            "textDocument": { "uri": client.uri("main.st"), "version": 2 },
            "contentChanges": [{ "text": large.replace("800000", "8") }],
        }),
    );
    let found = client.diagnostics("main.st");
    assert!(!found.iter().any(|(code, ..)| code == "stack-too-large"), "{found:?}");
    assert_eq!(client.ask("shutdown", Value::Null), Value::Null);
    client.tell("exit", Value::Null);
    assert_eq!(client.end(), 0);
}

#[test]
fn a_session_without_shutdown_ends_with_an_error() {
    let mut client = Client::start(Folder::new());
    client.initialize();
    client.tell("exit", Value::Null);
    assert_eq!(client.end(), 1);
    let mut client = Client::start(Folder::new());
    client.initialize();
    assert_eq!(client.end(), 1);
}

#[test]
fn what_is_no_message_ends_the_session_with_the_reason() {
    Folder::new().takt_plc(&["lsp", "--port"]).expect(2, "--port");
    let mut client = Client::start(Folder::new());
    write!(client.input.as_mut().unwrap(), "GET / HTTP/1.1\r\n\r\n").unwrap();
    assert_eq!(client.end(), 2);
}
