//! Layouts, and the messages that follow from them.

use proptest::prelude::*;
use serde_json::json;

use super::*;

const ALL: &str = "b:bool, y:byte, w:word, d:dword, l:lword, si:sint, i:int, di:dint, li:lint, \
                   us:usint, ui:uint, ud:udint, ul:ulint, r:real, lr:lreal";

fn layout(text: &str) -> Layout {
    Layout::parse(text).unwrap()
}

#[test]
fn values_lie_little_endian_behind_each_other() {
    let layout = layout("flag:bool, n:INT[2], x:real");
    let bytes = layout.encode_text("flag=true n=1,-2 x=1.5").unwrap();
    assert_eq!(bytes, [1, 1, 0, 0xfe, 0xff, 0, 0, 0xc0, 0x3f]);
    assert_eq!(layout.decode(&bytes).unwrap().to_string(), "flag=true n=1,-2 x=1.5");
}

#[test]
fn every_type_keeps_its_limits_as_text_and_as_json() {
    let layout = layout(ALL);
    assert_eq!(layout.bytes(), 1 + 15 + 15 + 15 + 4 + 8);
    for line in [
        "b=false y=255 w=65535 d=4294967295 l=18446744073709551615 si=-128 i=-32768 di=-2147483648 \
         li=-9223372036854775808 us=255 ui=65535 ud=4294967295 ul=18446744073709551615 \
         r=340282350000000000000000000000000000000 lr=-0.1",
        "b=true y=0 w=0 d=0 l=0 si=127 i=32767 di=2147483647 li=9223372036854775807 us=0 ui=0 ud=0 \
         ul=0 r=-inf lr=NaN",
    ] {
        let bytes = layout.encode_text(line).unwrap();
        let values = layout.decode(&bytes).unwrap();
        assert_eq!(values.to_string(), line);
        let json = serde_json::to_value(&values).unwrap();
        assert_eq!(layout.encode_json(&json).unwrap(), bytes, "{json}");
    }
}

#[test]
fn json_has_the_fields_in_order_and_arrays_as_arrays() {
    let layout = layout("z:lreal, a:dint[2], one:byte[1]");
    let bytes = layout.encode_text("z=0.5 a=7,-8 one=9").unwrap();
    let json = serde_json::to_string(&layout.decode(&bytes).unwrap()).unwrap();
    assert_eq!(json, r#"{"z":0.5,"a":[7,-8],"one":[9]}"#);
}

#[test]
fn a_layout_that_is_wrong_says_why() {
    for (text, says) in [
        ("", "at least one value"),
        ("level", "name:type"),
        (":int", "a name is one word"),
        ("a b:int", "a name is one word"),
        ("a:float", "there is no type float; allowed are bool, byte"),
        ("a:int, a:int", "a is there twice"),
        ("a:int[0]", "an array has [1] to"),
        ("a:int[", "an array has"),
        ("a:int[-1]", "an array has"),
        ("a:int[99999999999999999999]", "an array has"),
        ("a:lreal[8193]", "65544 bytes: no message is longer than 65536"),
    ] {
        let error = Layout::parse(text).unwrap_err();
        assert!(error.contains(says), "{text}: {error}");
    }
    let error = Layout::from_argument("@/nowhere/at/all").unwrap_err();
    assert!(error.starts_with("/nowhere/at/all: "), "{error}");
}

#[test]
fn a_message_that_does_not_fit_says_why() {
    let layout = layout("n:sint, m:usint[2]");
    for (line, says) in [
        ("n=1", "m is missing"),
        ("n=1 m=1,2 o=3", "the layout has no o"),
        ("n=1 m=1", "m has 1 values, the layout 2"),
        ("n=128 m=1,2", "n: 128 is not a value of sint"),
        ("n=-129 m=1,2", "n: -129 is not a value of sint"),
        ("n=1 m=1,256", "m: 256 is not a value of byte or usint"),
        ("n=1 m=-1,2", "m: -1 is not"),
        ("n=1.5 m=1,2", "n: 1.5 is not"),
        ("n", "n is not of the form name=value"),
    ] {
        let error = layout.encode_text(line).unwrap_err();
        assert!(error.contains(says), "{line}: {error}");
    }
    for (json, says) in [
        (json!([1]), "fields is not an object"),
        (json!({"n": [1], "m": [1, 2]}), "n: [1] is not a value"),
        (json!({"n": 1, "m": 1}), "m has 1 values"),
        (json!({"n": null, "m": [1, 2]}), "n: null is not"),
    ] {
        let error = layout.encode_json(&json).unwrap_err();
        assert!(error.contains(says), "{json}: {error}");
    }
    let error = layout.decode(&[1, 2]).unwrap_err();
    assert_eq!(error, "the message has 2 bytes, the layout 3");
}

#[test]
fn a_number_that_is_too_large_is_no_infinity() {
    let layout = layout("r:real, l:lreal");
    for (line, says) in [
        ("r=1e39 l=0", "r: 1e39 is not a value of real"),
        ("r=-1e39 l=0", "r: -1e39 is not"),
        ("r=0 l=1e309", "l: 1e309 is not a value of lreal"),
    ] {
        let error = layout.encode_text(line).unwrap_err();
        assert!(error.contains(says), "{line}: {error}");
    }
    let error = layout.encode_json(&json!({"r": 1e39, "l": 0})).unwrap_err();
    assert!(error.contains("is not a value of real"), "{error}");
    let infinite = layout.encode_text("r=inf l=-Infinity").unwrap();
    assert_eq!(layout.decode(&infinite).unwrap().to_string(), "r=inf l=-inf");
}

proptest! {
    #[test]
    fn whatever_bytes_come_are_shown_and_read_back(
        bytes in prop::collection::vec(any::<u8>(), 58),
    ) {
        let layout = layout(ALL);
        let values = layout.decode(&bytes).unwrap();
        let json = serde_json::to_value(&values).unwrap();
        let again = layout.encode_json(&json).unwrap();
        // Each is the same value, if not the same bits: there are many ways to be true or no number.
        prop_assert_eq!(values.to_string(), layout.decode(&again).unwrap().to_string());
        prop_assert_eq!(layout.encode_text(&values.to_string()).unwrap(), again);
    }

    #[test]
    fn no_text_is_too_much_for_a_layout(text in "\\PC{0,40}") {
        let _ = Layout::parse(&text);
        let _ = layout("a:int, b:bool[3]").encode_text(&text);
    }
}
