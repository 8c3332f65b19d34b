//! Messages as text, and text as messages.

use super::*;

fn shape(layout: Option<&str>, hex: bool, json: bool) -> Shape {
    let layout = layout.map(|text| Layout::from_argument(text).unwrap());
    Shape { raw: false, hex, layout, json }
}

fn shown(shape: &Shape, valid: Option<bool>, bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let message = Message { port: "p", code: 0, age_ns: 5, valid, bytes };
    shape.show(&message, &mut out).unwrap();
    out
}

fn taken(shape: &Shape, data: Option<&str>, count: Option<u64>, input: &[u8]) -> Vec<Vec<u8>> {
    let mut messages = Vec::new();
    let each = |bytes: &[u8]| {
        messages.push(bytes.to_owned());
        Ok(())
    };
    shape.take(data, count, input, each).unwrap();
    messages
}

#[test]
fn a_message_is_shown_in_each_shape() {
    let bytes = [1, 0, 0xff];
    assert_eq!(shown(&shape(None, false, false), None, &bytes), bytes);
    assert_eq!(shown(&shape(None, true, false), None, &bytes), b"0100ff\n");
    assert_eq!(shown(&shape(Some("a:int,b:sint"), false, false), None, &bytes), b"a=1 b=-1\n");
    let json = br#"{"port":"p","code":0,"age_ns":5,"valid":true,"bytes":"0100ff"}"#;
    assert_eq!(shown(&shape(None, false, true), Some(true), &bytes).trim_ascii(), json);
    let json = br#"{"port":"p","code":0,"age_ns":5,"fields":{"a":1,"b":-1}}"#;
    let layout = shape(Some("a:int,b:sint"), false, true);
    assert_eq!(shown(&layout, None, &bytes).trim_ascii(), json);
}

#[test]
fn what_is_shown_can_be_taken_again() {
    let bytes = vec![1, 0, 0xff];
    for shape in [
        shape(None, false, false),
        shape(None, true, false),
        shape(None, false, true),
        shape(Some("a:int,b:sint"), false, false),
        shape(Some("a:int,b:sint"), false, true),
    ] {
        let out = shown(&shape, Some(false), &bytes);
        assert_eq!(taken(&shape, None, None, &out), std::slice::from_ref(&bytes), "{shape:?}");
    }
}

#[test]
fn messages_come_from_the_argument_or_the_lines_of_the_input() {
    let raw = shape(None, false, false);
    assert_eq!(taken(&raw, Some("a b"), Some(2), b"x"), [b"a b", b"a b"]);
    assert_eq!(taken(&raw, None, None, b"a\nb\n"), [b"a\nb\n"]);
    assert_eq!(taken(&raw, None, None, &vec![0; 70_000])[0].len(), 65_537);
    let hex = shape(None, true, false);
    assert_eq!(taken(&hex, None, None, b"01\n0 2\n03"), [[1], [2], [3]]);
    assert_eq!(taken(&hex, None, Some(2), b"01\n02\n03"), [[1], [2]]);
}

#[test]
fn a_message_that_cannot_be_understood_is_a_usage_error() {
    for (shape, data) in [
        (shape(None, true, false), &b"0"[..]),
        (shape(None, true, false), b"0g"),
        (shape(None, true, false), b"\xff"),
        (shape(None, false, true), b"{"),
        (shape(None, false, true), b"[]"),
        (shape(None, false, true), b"{\"bytes\":1}"),
        (shape(None, false, true), b"{\"fields\":{}}"),
        (shape(Some("a:int"), false, true), b"{\"fields\":{}}"),
    ] {
        let error = shape.parse(data).unwrap_err();
        assert_eq!(error.status(), crate::failure::USAGE, "{error}");
    }
}

#[test]
fn a_message_of_another_length_than_the_layout_is_not_shown() {
    let message = Message { port: "p", code: 0, age_ns: 0, valid: None, bytes: &[1] };
    let error = shape(Some("a:int"), false, false).show(&message, &mut Vec::new()).unwrap_err();
    assert_eq!(error.to_string(), "p: the message has 1 bytes, the layout 2; it is 01");
    assert_eq!(error.status(), 70);
}
