//! A faulty or malicious client gets errors, and the server goes on.

use std::io::Cursor;

use lsp_server::{Message, Notification, Request, Response};
use proptest::prelude::*;
use serde_json::{Value, json};
use takt_lsp::server::{Server, Step};
use takt_lsp::{End, run, transport};

const METHODS: [&str; 8] = [
    "textDocument/hover",
    "textDocument/definition",
    "textDocument/references",
    "textDocument/completion",
    "textDocument/prepareRename",
    "textDocument/rename",
    "textDocument/formatting",
    "textDocument/documentSymbol",
];

const TEXT: &str =
    "PROGRAM Main\r\nVAR x : INT; (* ü😀 *) t : TON; END_VAR\r\nx := 1; // 😀\nEND_PROGRAM";

fn request(server: &mut Server, method: &str, params: Value) -> Response {
    let request = Request { id: 1.into(), method: method.to_owned(), params };
    assert_eq!(server.take(request.into()), Step::Next);
    let sent = server.sent();
    match &sent[..] {
        [Message::Response(response)] => response.clone(),
        other => panic!("{method} is answered by {other:?}"),
    }
}

fn tell(server: &mut Server, method: &str, params: Value) -> Vec<Message> {
    let one = Notification { method: method.to_owned(), params };
    assert_eq!(server.take(one.into()), Step::Next);
    server.sent()
}

fn running() -> Server {
    let mut server = Server::new();
    let answer = request(&mut server, "initialize", json!({ "capabilities": {} }));
    assert!(answer.response_result.is_ok());
    tell(&mut server, "initialized", json!({}));
    server
}

fn with_text() -> Server {
    let mut server = running();
    let document = json!({ "uri": "untitled:a", "languageId": "st", "version": 1, "text": TEXT });
    assert!(
        tell(&mut server, "textDocument/didOpen", json!({ "textDocument": document })).is_empty()
    );
    server
}

fn code(response: &Response) -> i32 {
    response.response_result.as_ref().expect_err("it is refused").code
}

#[test]
fn requests_out_of_order_are_refused() {
    let mut server = Server::new();
    assert_eq!(code(&request(&mut server, "textDocument/hover", Value::Null)), -32002);
    assert_eq!(code(&request(&mut server, "initialize", json!({ "capabilities": 5 }))), -32602);
    let mut server = running();
    assert_eq!(code(&request(&mut server, "initialize", json!({ "capabilities": {} }))), -32600);
    assert_eq!(code(&request(&mut server, "textDocument/unheardOf", Value::Null)), -32601);
    assert!(request(&mut server, "shutdown", Value::Null).response_result.is_ok());
    assert_eq!(code(&request(&mut server, "textDocument/hover", Value::Null)), -32600);
    let exit = Notification { method: "exit".to_owned(), params: Value::Null };
    assert_eq!(server.take(exit.into()), Step::Exit(End::Asked));
}

#[test]
fn wrong_parameters_are_refused() {
    let mut server = with_text();
    for method in METHODS {
        for params in
            [Value::Null, json!([]), json!({}), json!({ "textDocument": 1, "position": -1 })]
        {
            assert_eq!(code(&request(&mut server, method, params)), -32602, "{method}");
        }
        let elsewhere = json!({
            "textDocument": { "uri": "file:///not/there.st" }, "position": { "line": 0, "character": 0 },
            "newName": "y", "context": { "includeDeclaration": true },
            "options": { "tabSize": 4, "insertSpaces": true },
        });
        assert_eq!(code(&request(&mut server, method, elsewhere)), -32602, "{method}");
    }
    for method in ["textDocument/didOpen", "textDocument/didChange", "textDocument/didClose"] {
        let shown = tell(&mut server, method, json!({ "textDocument": [] }));
        assert_eq!(shown.len(), 1, "{method}: the user is told");
    }
    let change = json!({
        "textDocument": { "uri": "untitled:b", "version": 1 }, "contentChanges": [{ "text": "" }],
    });
    assert_eq!(tell(&mut server, "textDocument/didChange", change).len(), 1);
    // The text is as it was.
    let symbols = json!({ "textDocument": { "uri": "untitled:a" } });
    assert!(request(&mut server, "textDocument/documentSymbol", symbols).response_result.is_ok());
}

#[test]
fn a_text_that_was_lost_is_not_edited_at_places_that_are_not_known() {
    let mut server = with_text();
    let insert = |text: &str| {
        let start = json!({ "line": 0, "character": 0 });
        json!({ "range": { "start": start, "end": start }, "text": text })
    };
    let mut version = 1;
    let mut change = |server: &mut Server, changes: Vec<Value>| {
        version += 1;
        let document = json!({ "uri": "untitled:a", "version": version });
        let params = json!({ "textDocument": document, "contentChanges": changes });
        tell(server, "textDocument/didChange", params).len()
    };
    let at = |line: u32| {
        json!({
            "textDocument": { "uri": "untitled:a" },
            "position": { "line": line, "character": 4 },
            "newName": "y", "context": { "includeDeclaration": true },
            "options": { "tabSize": 4, "insertSpaces": true },
        })
    };
    let much = " ".repeat(17 << 20);
    // What follows the change with which it is lost is not done either.
    let lost = vec![insert(&much), insert(&much), insert("// one\n")];
    assert_eq!(change(&mut server, lost), 1, "the user is told");
    let shown = serde_json::to_string(&server.rest()).unwrap();
    assert!(shown.contains("publishDiagnostics") && shown.contains("open it again"), "{shown}");
    // It becomes small again, which nothing here can know.
    let (start, end) = (json!({ "line": 0, "character": 0 }), json!({ "line": 1, "character": 0 }));
    let removal = json!({ "range": { "start": start, "end": end }, "text": "" });
    assert_eq!(change(&mut server, vec![removal]), 0, "the user was told");
    for method in METHODS {
        assert_eq!(code(&request(&mut server, method, at(1))), -32803, "{method}");
    }
    // The whole text ends that, and so does opening it.
    assert_eq!(change(&mut server, vec![json!({ "text": TEXT }), insert("\n")]), 0);
    let renamed = |server: &mut Server, line: u32| {
        let edit = request(server, "textDocument/rename", at(line)).response_result;
        let edit = edit.expect("it is renamed");
        let edits = edit["changes"]["untitled:a"].as_array().expect("edits").clone();
        edits.iter().map(|edit| edit["range"]["start"]["line"].as_u64()).collect::<Vec<_>>()
    };
    assert_eq!(renamed(&mut server, 2), [Some(2), Some(3)]);
    assert_eq!(change(&mut server, vec![insert(&much), insert(&much)]), 1);
    let document = json!({ "uri": "untitled:a", "languageId": "st", "version": 9, "text": TEXT });
    tell(&mut server, "textDocument/didOpen", json!({ "textDocument": document }));
    assert_eq!(renamed(&mut server, 1), [Some(1), Some(2)]);
}

#[test]
fn nothing_is_renamed_while_a_text_of_the_project_is_lost() {
    let mut server = running();
    let open = |server: &mut Server, name: &str, text: &str| {
        let uri = format!("file:///not/there/{name}.st");
        let document = json!({ "uri": uri, "languageId": "st", "version": 1, "text": text });
        tell(server, "textDocument/didOpen", json!({ "textDocument": document }));
    };
    open(&mut server, "a", "FUNCTION_BLOCK Mixer\nEND_FUNCTION_BLOCK\n");
    let user = "PROGRAM Main\nVAR m : Mixer; END_VAR\nm();\nEND_PROGRAM\n";
    open(&mut server, "b", user);
    let rename = json!({
        "textDocument": { "uri": "file:///not/there/a.st" },
        "position": { "line": 0, "character": 16 }, "newName": "Blender",
    });
    let edit = request(&mut server, "textDocument/rename", rename.clone()).response_result;
    assert_eq!(edit.expect("it is renamed")["changes"].as_object().expect("edits").len(), 2);
    let start = json!({ "line": 4, "character": 0 });
    let much = json!({ "range": { "start": start, "end": start }, "text": " ".repeat(17 << 20) });
    let params = json!({
        "textDocument": { "uri": "file:///not/there/b.st", "version": 2 },
        "contentChanges": [much, much],
    });
    tell(&mut server, "textDocument/didChange", params);
    let refused = request(&mut server, "textDocument/rename", rename.clone());
    assert_eq!(code(&refused), -32803);
    open(&mut server, "b", user);
    assert!(request(&mut server, "textDocument/rename", rename).response_result.is_ok());
}

#[test]
fn a_header_takes_no_room_for_what_it_promises() {
    let serve = |bytes: &[u8]| {
        let mut out = Vec::new();
        let end = run(Cursor::new(bytes.to_vec()), &mut out);
        (end.map_err(|error| error.to_string()), String::from_utf8(out).expect("it is text"))
    };
    for header in ["99999999999999999999", "18446744073709551615", "33554433", "-1", "x", ""] {
        let (end, out) = serve(format!("Content-Length: {header}\r\n\r\n").as_bytes());
        assert!(end.expect_err(header).contains("allowed are at most"), "{header}");
        assert_eq!(out, "");
    }
    // Promised and not sent.
    let (end, _) = serve(b"Content-Length: 33554432\r\n\r\n{}");
    assert_eq!(end, Ok(End::Abrupt));
    let (end, _) = serve(&vec![b'x'; 1 << 20]);
    assert!(end.expect_err("a line without an end").contains("without its end"));
    let (end, _) = serve("a: b\r\n".repeat(100).as_bytes());
    assert!(end.expect_err("too many lines").contains("more than 16 lines"));
    // Text that is no message is answered, and the next message is read.
    let texts = ["{\"a\":", "{\"id\":7}", "{\"id\":9,\"method\":\"x\",\"params\":null}"];
    let framed = texts.map(|text| format!("Content-Length: {}\r\n\r\n{text}", text.len()));
    let (end, out) = serve(framed.concat().as_bytes());
    assert_eq!(end, Ok(End::Abrupt));
    for expected in ["-32700", "\"id\":7", "-32600", "\"id\":9", "-32002"] {
        assert!(out.contains(expected), "{out}");
    }
    let deep = "[".repeat(1 << 20);
    let (end, out) = serve(format!("Content-Length: {}\r\n\r\n{deep}", deep.len()).as_bytes());
    assert_eq!(end, Ok(End::Abrupt));
    assert!(out.contains("-32700"), "{out}");
}

/// Any number that a position can have, most often one near the text.
fn coordinate() -> impl Strategy<Value = u32> {
    prop_oneof![6 => 0..40_u32, 1 => any::<u32>()]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_end_in_an_error_or_an_answer(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let mut out = Vec::new();
        let _ = run(Cursor::new(bytes.clone()), &mut out);
        let mut message = format!("Content-Length: {}\r\n\r\n", bytes.len()).into_bytes();
        message.extend(bytes);
        let read = transport::read(&mut Cursor::new(message));
        prop_assert!(matches!(read, Ok(Some(_))), "{read:?}");
    }

    #[test]
    fn any_position_is_answered(line in coordinate(), character in coordinate(), method in 0..METHODS.len()) {
        let mut server = with_text();
        let params = json!({
            "textDocument": { "uri": "untitled:a" },
            "position": { "line": line, "character": character },
            "newName": "y", "context": { "includeDeclaration": true },
            "options": { "tabSize": 4, "insertSpaces": true },
        });
        request(&mut server, METHODS[method], params);
    }

    #[test]
    fn any_change_is_taken(
        changes in prop::collection::vec((coordinate(), coordinate(), coordinate(), coordinate(), "[ -~ü😀\r\n]{0,9}"), 1..6),
    ) {
        let mut server = with_text();
        let changes: Vec<Value> = changes.iter().map(|(a, b, c, d, text)| json!({
            "range": {
                "start": { "line": a, "character": b }, "end": { "line": c, "character": d },
            },
            "text": text,
        })).collect();
        let params = json!({
            "textDocument": { "uri": "untitled:a", "version": 2 }, "contentChanges": changes,
        });
        prop_assert!(tell(&mut server, "textDocument/didChange", params).is_empty());
        let published = server.rest();
        prop_assert_eq!(published.len(), 1);
    }
}
