//! What is refused: wrong images, above all, since they come from elsewhere.

use std::path::Path;

use takt_plan::Replacement;

use super::Case;
use super::images::{PRIVATE, builder, image, public, signed};

fn with_image(name: &str, bytes: &[u8], keys: &str) -> Case {
    Case::new(name).file("a.plc", bytes).program("a.plc", keys)
}

#[test]
fn what_is_no_image_is_refused_at_its_line() {
    let place = "case.toml:12:9:";
    with_image("none", b"not an image", "").refused(&[place, "is no program image"]);
    with_image("empty", b"", "").refused(&[place, "is no program image"]);
    let case = Case::new("absent").program("b.plc", "");
    case.refused(&[place, "b.plc cannot be read: No such file"]);
    let case = Case::new("folder").program(".", "");
    case.refused(&[place, "it is not a regular file"]);
    let endless = Case::new("endless").program("/dev/zero", "");
    endless.refused(&[place, "it is not a regular file"]);
}

/// No byte of an image may be another, and none may be missing.
#[test]
fn an_image_with_any_byte_changed_or_missing_is_refused() {
    let good = image("a");
    for at in (0..good.len()).step_by(61).chain(0..300) {
        let mut bad = good.clone();
        bad[at] ^= 1;
        with_image("changed", &bad, "").refused(&["is no program image"]);
    }
    for length in (0..good.len()).step_by(127) {
        with_image("cut", &good[..length], "").refused(&["is no program image"]);
    }
    let mut long = good;
    long.extend([0; 4096]);
    with_image("long", &long, "").refused(&["is no program image"]);
}

#[test]
fn a_signature_is_of_one_of_the_keys() {
    let keys = |private: &[u8; 32]| format!("keys = [\"{}\"]", public(private));
    let other = keys(&[9; 32]);
    with_image("unsigned", &image("a"), &other).refused(&["the image is not signed", "the keys"]);
    let another = format!("signed with another key, {}", public(&PRIVATE));
    with_image("other-key", &signed("a"), &other).refused(&[&another]);
    let mut forged = signed("a");
    forged[170] ^= 1;
    with_image("forged", &forged, &keys(&PRIVATE)).refused(&["signature"]);
    // Not only where keys are named: a signature that is wrong is damage.
    with_image("damaged", &forged, "").refused(&["signature"]);
}

#[test]
fn keys_have_one_form() {
    for text in ["", "12", &"g".repeat(64), &"ä".repeat(32), &"0".repeat(65)] {
        let keys = format!("keys = [\"{text}\"]");
        with_image("key", &image("a"), &keys).refused(&["is no public key", "64 hexadecimal"]);
    }
    with_image("no-keys", &image("a"), "keys = []").refused(&["0 keys"]);
    let many = format!("keys = [{}]", format!("\"{}\", ", "0".repeat(64)).repeat(17));
    with_image("many-keys", &image("a"), &many).refused(&["17 keys"]);
}

#[test]
fn sizes_are_pages_and_enough() {
    let refused = |key: &str, words: &[&str]| with_image("size", &image("a"), key).refused(words);
    refused("bank = \"4KiB\"", &["a `bank` of 4KiB for an image of ", "at least "]);
    refused("bank = \"65KiB\"", &["a `bank` of 65KiB", "a multiple of 4KiB"]);
    refused("bank = \"1GiB\"", &["a `bank` of 1GiB", "at most 192MiB"]);
    refused("state = \"0KiB\"", &["a `state` of 0 bytes for a state of 100 bytes"]);
}

#[test]
fn names_are_words_and_different() {
    let image_of = |name: &str| with_image("name", &image(name), "");
    image_of("Tank_1").refused(&["the program in it is named \"Tank_1\"", "the key `name`"]);
    let given = |keys: &str| with_image("given-name", &image("Tank_1"), keys);
    assert_eq!(given("name = \"tank\"").good().partitions()[0].programs()[0].name, "tank");
    given("name = \"Tank\"").refused(&["case.toml:13:8:", "not a word of the allowed form"]);
    let twice = Case::new("twice").file("a.plc", &image("a"));
    twice.program("a.plc", "").program("a.plc", "").refused(&["a second program", "the other one"]);
}

#[test]
fn actions_are_those_that_can_follow() {
    let refused = |key: &str, words: &[&str]| with_image("action", &image("a"), key).refused(words);
    refused("on_fault = \"log\"", &["there is no action \"log\" for `on_fault`", "\"stop\", "]);
    refused("on_overrun = \"ignore\"", &["no action \"ignore\"", "\"skip\", \"log\""]);
    refused("on_deadline = \"\"", &["no action \"\""]);
}

#[test]
fn programs_have_a_guest_and_no_tasks_of_the_file() {
    let task = "[[partition.task]]\nname = \"t\"\nperiod = \"1ms\"\nbudget = \"1us\"\npriority = 1";
    with_image("tasks", &image("a"), "")
        .with(task)
        .refused(&["tasks of the file beside its programs"]);
    let mut many = Case::new("many").file("a.plc", &image("a"));
    for n in 0..17 {
        many = many.program("a.plc", &format!("name = \"p{n}\""));
    }
    many.refused(&["this is program 17 of 17", "at most 16"]);
    let key = with_image("key-of-none", &image("a"), "priority = 1");
    key.refused(&["unknown key `priority`"]);
}

#[test]
fn a_large_image_of_another_kind_is_not_read_to_its_end() {
    let case = Case::new("sparse").program("big", "");
    let big = std::fs::File::create(case.folder.join("big")).unwrap();
    big.set_len(1 << 40).unwrap();
    case.refused(&["is no program image"]);
}

#[test]
fn a_program_with_no_state_is_taken() {
    let mut none = builder("a");
    none.state_bytes = 0;
    let case = with_image("stateless", &none.build().unwrap(), "");
    assert_eq!(case.good().partitions()[0].programs()[0].place.state_bytes, 0);
}

#[test]
fn another_image_is_checked_as_if_it_were_in_its_place() {
    let case = with_image("replaced", &image("a"), "");
    let path = case.good().partitions()[0].programs()[0].path.clone();
    let with = |path: &Path, bytes: &[u8]| {
        let file = case.folder.join("case.toml");
        takt_plan::load_with(&file, None, Replacement { path, bytes })
    };
    let file = with(&path, &image("b")).unwrap();
    let program = &file.partitions()[0].programs()[0];
    assert_eq!((program.name.as_str(), program.bytes()), ("b", &image("b")[..]));
    let error = with(&path, &image("b")[1..]).unwrap_err().to_string();
    assert!(error.contains("case.toml:12:9:") && error.contains("is no program image"), "{error}");
    // What is in no program's place changes nothing, and the file stays as it is.
    assert_eq!(with(&case.folder, b"").unwrap().partitions()[0].programs()[0].name, "a");
    assert_eq!(case.good().partitions()[0].programs()[0].name, "a");
}
