//! Changes beside a Linux that compiles.

use std::fs;

use takt_program::Elementary::{Udint, Ulint};
use takt_program::signature;
use takt_tests::{File, Host, Value, long, parse, plc_image, save_bytes, target};

use super::{PRIVATE, Tank, hex};

/// Two versions in turns. From one to the other fields move, come and go, and one becomes wider.
fn versions() -> [Tank; 2] {
    let narrow = [("fresh", Ulint, 7), ("count", Udint, 0), ("sum", Ulint, 0)];
    // A count that has become wider cannot become narrow again, so both have the wide one.
    let wide = narrow.map(|(name, _, initial)| (name, Ulint, initial));
    let other = [("sum", Ulint, 0), ("more", Ulint, 9), ("count", Ulint, 0), ("fresh", Ulint, 7)];
    [Tank::new(1, &wide), Tank::new(2, &other)]
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn changes_beside_a_linux_that_compiles_take_10_us_and_move_no_release() {
    let (times, longest) = if long() { (200, "200s") } else { (4, "20s") };
    let folder = target("tests/change-often");
    let out = target("tests/change-often.out");
    for folder in [&folder, &out] {
        let _ = fs::remove_dir_all(folder);
        fs::create_dir_all(folder).unwrap();
    }
    let order = |name: &str, rest: &str| {
        let program = r#""partition":"plc","program":"tank""#;
        format!(r#"{{"version":2,"request":"{name}",{program}{rest}}}"#)
    };
    for (place, version) in versions().iter().enumerate() {
        let data = hex(&version.image());
        let request = order("load", &format!(r#","part":0,"parts":1,"data":"{data}""#));
        fs::write(folder.join(format!("load-{place}")), request).unwrap();
    }
    fs::write(folder.join("commit"), order("commit", "")).unwrap();
    let folder = fs::canonicalize(folder).unwrap();
    let first = Tank::new(0, &[("count", Udint, 0), ("sum", Ulint, 0)]);
    let image = save_bytes("change-often.plc", &first.image());
    let kernel = fs::canonicalize(plc_image("kernel")).unwrap();
    let key = hex(&signature::public(&PRIVATE));
    let table = format!(
        "memory = \"16MiB\"\nimage = {kernel:?}\nrelease_guard = \"10us\"\n[[partition.program]]\nimage = {image:?}\n\
         name = \"tank\"\nkeys = [{key:?}]"
    );
    let file = File::new("1ms")
        .plc_with("plc", &table)
        .compiling_linux("")
        .schedule("normal")
        .window("plc", 0, 300)
        .save("change-often");
    let host = Host::new().with("--memory", "576").with("--program", env!("CARGO_BIN_EXE_talk"));
    let linux = [target("guest/vmlinuz"), target("tests/load-initrd.img")];
    let host = [&file, &folder, &image, &kernel, &linux[0], &linux[1]]
        .into_iter()
        .fold(host, |host, path| host.with_file(path));
    let arguments = [file.to_str().unwrap(), folder.to_str().unwrap(), &times.to_string(), longest];
    let outcome = host.given_up_after(3_000).run("change-often", &arguments);
    assert_eq!(outcome.status, 0, "{}", outcome.output);

    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    let load: Vec<u64> = read("load").lines().map(|line| line.parse().unwrap()).collect();
    println!("compiled before and after the changes: {load:?}");
    assert!(load.len() == 2 && load[0] < load[1], "Linux did not compile: {load:?}");

    let answers: Vec<Value> = read("answers").lines().map(parse).collect();
    let of = |kind: &str| -> Vec<&Value> {
        answers.iter().filter(|answer| answer["answer"] == *kind).collect()
    };
    assert!(of("error").is_empty(), "{answers:#?}");
    let changes: Vec<&Value> = of("versions").iter().map(|answer| &answer["versions"][0]).collect();
    assert_eq!(changes.len(), times);
    for (place, change) in (1..).zip(&changes) {
        assert_eq!((&change["phase"], &change["reason"]), (&"held".into(), &Value::Null));
        let version = versions()[place % 2].patch;
        assert_eq!(change["running"]["version"], format!("1.0.{version}"), "{change:#}");
        let took = change["took_ns"].as_u64().unwrap();
        assert!((1..=10_000).contains(&took), "{change:#}");
    }
    let took: Vec<u64> = changes.iter().filter_map(|change| change["took_ns"].as_u64()).collect();
    println!("changes took {:?} to {:?} ns", took.iter().min(), took.iter().max());

    // Each job ran, and each found the values that the one before it left: else it had faulted.
    let status = &of("status")[0]["status"]["partitions"][0]["programs"][0];
    assert_eq!(status["state"], "running", "{status:#}");
    for key in ["missed", "overruns", "skipped"] {
        assert_eq!(status["tasks"][0][key], 0, "{status:#}");
    }
    outcome.assert_kept_its_time("plc", 1_000);
    let latest = outcome.number("plc", "release_latency_ns.max");
    println!("the latest release: {latest} ns");
    assert!(latest <= 10, "{}", outcome.output);
}
