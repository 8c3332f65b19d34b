//! A change that is cut off at any instant: the next start begins with the old or the new version, whole.

use std::fs;

use takt_program::Elementary::{Udint, Ulint};
use takt_program::{Image, signature};
use takt_tests::{File, Host, long, plc_image, root, save_bytes};

use super::{PRIVATE, Tank, hex};

#[ignore = "takes long: scripts/test --all"]
#[test]
fn after_a_kill_at_any_instant_of_a_change_the_old_or_the_new_version_starts_whole() {
    let kills = if long() { "200" } else { "6" };
    let old = Tank::new(0, &[("count", Udint, 0), ("sum", Ulint, 0)]).image();
    let fields = [("fresh", Ulint, 7), ("count", Ulint, 0), ("sum", Ulint, 0)];
    let new = Tank::new(1, &fields).image();
    let hashes = [&old, &new].map(|bytes| hex(&Image::parse(bytes).unwrap().hash()));
    let names = ["change-killed.plc", "change-killed-old.plc", "change-killed-new.plc"];
    let [image, old, new] = [(0, &old), (1, &old), (2, &new)]
        .map(|(name, bytes): (usize, &Vec<u8>)| save_bytes(names[name], bytes));
    let kernel = fs::canonicalize(plc_image("kernel")).unwrap();
    let key = hex(&signature::public(&PRIVATE));
    let table = format!(
        "memory = \"16MiB\"\nimage = {kernel:?}\n[[partition.program]]\nimage = {image:?}\nname = \"tank\"\nkeys = [{key:?}]"
    );
    let file = File::new("1ms")
        .lines("control = \"/tmp/takt.sock\"")
        .plc_with("plc", &table)
        .schedule("normal")
        .window("plc", 0, 300)
        .save("change-killed");
    let tool = root().join("target/x86_64-unknown-linux-gnu/release/takt-plc");
    let host = Host::new()
        .with("--program", env!("CARGO_BIN_EXE_talk"))
        .with("--program", tool.to_str().unwrap());
    let host = [&file, &image, &old, &new, &kernel].into_iter().fold(host, |h, p| h.with_file(p));
    let paths = [&file, &image, &old, &new].map(|path| path.to_str().unwrap());
    let arguments = [&paths[..], &[&hashes[0], &hashes[1], kills]].concat();
    let outcome = host.given_up_after(3_000).run("change-killed", &arguments);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("wrong: "), "{}", outcome.output);
    outcome.assert_shows(&format!("killed {kills} times: "));
    for none in [" 0 times the old", " 0 times the new"] {
        assert!(!outcome.output.contains(none), "{}", outcome.output);
    }
}
