//! What of a program outlives its stop, and the file for that.

use takt_plan::RetainFile;
use takt_program::build::{Kind, Type, Variable};
use takt_program::{Area, Elementary, Flags};
use takt_scheduler::time::Nanos;

use super::Case;
use super::images::{builder, image};

/// An image with this many RETAIN arrays of so many bytes, and a gap behind each.
fn retaining(name: &str, arrays: u32, bytes: u32) -> Vec<u8> {
    let mut image = builder(name);
    let byte = image.elementary(Elementary::Byte);
    let kind = Kind::Array { element: byte, lower: 1, upper: bytes.into() };
    let ty = image.ty(Type::new(bytes, kind));
    image.state_bytes = arrays * (bytes + 1);
    for number in 0..arrays {
        let at = number * (bytes + 1);
        let name = format!("kept{number}");
        image.variable(Variable::new(&name, ty, Area::State, at).with(Flags::RETAIN));
    }
    image.build().unwrap()
}

fn case(name: &str, image: &[u8], keys: &str) -> Case {
    Case::new(name).file("a.plc", image).program("a.plc", keys)
}

#[test]
fn a_block_lies_behind_the_state_of_what_retains_something() {
    let place = |image: &[u8], keys: &str| {
        let file = case("block", image, keys).good();
        let program = &file.partitions()[0].programs()[0];
        assert_eq!(program.place.retained, program.place.state + program.place.state_bytes);
        program.place.retained_bytes
    };
    assert_eq!(place(&image("a"), ""), 0);
    assert_eq!(place(&image("a"), "retain = \"f\""), 4096, "for a later version");
    assert_eq!(place(&retaining("a", 1, 3000), ""), 4096);
    assert_eq!(place(&retaining("a", 2, 2000), ""), 8192, "a quarter more");
}

#[test]
fn the_file_is_beside_the_partition_file() {
    let retain = |keys: &str| {
        let case = case("file", &image("a"), keys);
        let folder = case.folder.clone();
        (case.good().partitions()[0].programs()[0].retain.clone(), folder)
    };
    assert_eq!(retain("").0, None);
    let (found, folder) = retain("retain = \"kept/tank\"");
    let expected = RetainFile { path: folder.join("kept/tank"), every: Nanos::from_millis(1000) };
    assert_eq!(found, Some(expected));
    let (found, _) = retain("retain = \"tank\"\nretain_every = \"100ms\"");
    assert_eq!(found.unwrap().every, Nanos::from_millis(100));
}

#[test]
fn check_tells_how_much_is_retained_and_where() {
    let shown =
        |image: &[u8], keys: &str| takt_plan::check::report(&case("shown", image, keys).good());
    let two = shown(&retaining("a", 2, 2000), "");
    let line = "    retained variables: 2 (0 PERSISTENT), 4000 bytes; in no file: they outlive starts of the PLC";
    assert!(two.contains(line), "{two}");
    let written = shown(&retaining("a", 1, 16), "retain = \"tank\"\nretain_every = \"100ms\"");
    assert!(
        written.contains("retained variables: 1 (0 PERSISTENT), 16 bytes; written to /"),
        "{written}"
    );
    assert!(written.contains("/tank at most each 100ms\n"), "{written}");
    assert!(!shown(&image("a"), "retain = \"tank\"").contains("retained"));
}

#[test]
fn wrong_keys_are_refused() {
    let refused = |keys: &str, words: &[&str]| case("keys", &image("a"), keys).refused(words);
    refused("retain_every = \"1s\"", &["`retain_every` without `retain`", "names the file"]);
    refused("retain = \"f\"\nretain_every = \"99ms\"", &["a `retain_every` of 99ms", "100ms"]);
    refused("retain = \"f\"\nretain_every = \"3601s\"", &["a `retain_every` of 3601"]);
    refused("retain = \"\"", &["cannot be that of a file"]);
    Case::new("twice")
        .file("a.plc", &image("a"))
        .file("b.plc", &image("b"))
        .program("a.plc", "retain = \"f\"")
        .program("b.plc", "retain = \"./f\"")
        .refused(&["/f.a is also a retain file of program \"a\"", "a path of its own"]);
}

#[test]
fn more_than_a_sample_has_room_for_is_refused() {
    let refused = |image: &[u8], words: &[&str]| case("much", image, "").refused(words);
    refused(&retaining("a", 1, 32769), &["32769 bytes are RETAIN", "at most 32KiB in a partition"]);
    refused(&retaining("a", 513, 1), &["513 bytes in 513 separate pieces", "32KiB in 512 pieces"]);
    case("enough", &retaining("a", 1, 32768), "").good();
    // Of all programs of a partition together.
    let half = |name| retaining(name, 1, 20_000);
    let both = Case::new("together").file("a.plc", &half("a")).file("b.plc", &half("b"));
    both.program("a.plc", "").program("b.plc", "").refused(&["40000 bytes are RETAIN"]);
}
