//! What is on the outputs when takt dies.

use takt_tests::{File, Host, long, plc_image};

/// A parallel port, and what is to be on it when nobody drives it.
const DEVICES: &str = r#"
[[partition.port_io]]
ports = "0x378-0x37a"

[[partition.safe_value]]
port = "0x378"
width = 1
value = "0xa5"
"#;

#[test]
fn outputs_are_safe_after_takt_was_killed_or_has_panicked() {
    let image = plc_image("outputs");
    let file = File::new("1ms")
        .plc("drive", Some(image.clone()), DEVICES)
        .schedule("normal")
        .window("drive", 0, 200)
        .save("killed");
    let kills = if long() { "20" } else { "4" };
    let outcome = Host::new()
        .with("--device", "parallel=/dev/null")
        .with_file(&file)
        .with_file(&image)
        .run("kill-takt", &[&file.to_string_lossy(), kills, "20261121"]);
    assert_eq!(outcome.status, 0, "{}", outcome.output);
    assert!(!outcome.output.contains("wrong: "), "{}", outcome.output);
    outcome.assert_shows(&format!("killed {kills} times"));
}
