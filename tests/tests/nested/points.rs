//! Values of programs, seen and forced from outside while they run.

mod many;

use std::fs;
use std::process::Command;

use takt_test_programs::{Entry, Program, cyclic, us};
use takt_tests::{Value, long, plc_image, root, save_bytes, target, timeout_s};

/// Two programs, of which the first publishes counters that agree after each job.
const FILE: &str = r#"
version = 1
[system]
name = "points"
major_frame = "1ms"

[[partition]]
name = "plc"
kind = "plc"
cpu = 0
memory = "32MiB"
image = "KERNEL"

[[partition.program]]
image = "FIRST"
name = "p"
allow_force = true

[[partition.program]]
image = "SECOND"
name = "q"

[[schedule]]
name = "normal"

[[schedule.window]]
partition = "plc"
offset = "0us"
duration = "300us"
"#;

/// What each client was told, and Takt's report.
struct Told {
    one: Vec<Value>,
    two: Vec<Value>,
    orders: Vec<Value>,
    report: Value,
}

fn run(time: &str, lines: usize) -> Told {
    let (file, out) = (target("tests/points.toml"), target("tests/points.out"));
    let _ = fs::remove_dir_all(&out);
    fs::create_dir_all(&out).unwrap();
    let first = Program::new("p").task(cyclic("main", us(1_000), 0, Entry::Publish), 2_000);
    // It spans windows now and then.
    let second = Program::new("q").task(cyclic("main", us(10_000), 9, Entry::Work), 200_000);
    let images = [
        ("KERNEL", fs::canonicalize(plc_image("kernel")).unwrap()),
        ("FIRST", save_bytes("points-p.plc", &first.image())),
        ("SECOND", save_bytes("points-q.plc", &second.image())),
    ];
    let text = images.iter().fold(FILE.to_owned(), |text, (name, path)| {
        text.replace(name, fs::canonicalize(path).unwrap().to_str().unwrap())
    });
    fs::write(&file, text).unwrap();
    let mut command = Command::new(root().join("scripts/host"));
    command.args(["--program", env!("CARGO_BIN_EXE_talk")]).arg("--file").arg(&file);
    for (_, image) in &images {
        command.arg("--file").arg(fs::canonicalize(image).unwrap());
    }
    let output = command
        .arg("--out")
        .arg(&out)
        .arg(root().join("tests/host/points"))
        // The path that the file has there, too.
        .arg(fs::canonicalize(&file).unwrap())
        .args([time, &lines.to_string()])
        .env("TAKT_TIMEOUT", timeout_s(3_000))
        .output()
        .unwrap();
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_default();
    let console = String::from_utf8_lossy(&output.stdout).into_owned() + &read("takt");
    assert!(output.status.success(), "{console}{}", String::from_utf8_lossy(&output.stderr));
    let answers = |name: &str| -> Vec<Value> {
        read(name).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    };
    let report = serde_json::from_str(&read("report.json")).unwrap();
    Told { one: answers("one"), two: answers("two"), orders: answers("orders"), report }
}

/// The four words of a line of values.
fn words(line: &Value) -> [u64; 4] {
    let bytes = line["values"]["bytes"].as_str().unwrap();
    assert_eq!(bytes.len(), 64, "{line}");
    std::array::from_fn(|word| {
        let digits = &bytes[16 * word..16 * (word + 1)];
        u64::from_str_radix(digits, 16).unwrap().swap_bytes()
    })
}

#[test]
fn values_of_one_line_are_of_one_cycle_and_neither_they_nor_forces_move_a_release() {
    let (time, lines) = if long() { ("60s", 50_000) } else { ("3s", 500) };
    let told = run(time, lines);
    for (client, lines) in [(&told.one, lines), (&told.two, 10)] {
        assert_eq!((&client[0]["answer"], &client[0]["bytes"]), (&"watching".into(), &32.into()));
        assert_eq!(client.len(), lines + 1);
        for line in &client[1..] {
            assert_eq!(
                (line["answer"].as_str(), &line["values"]["unsettled"]),
                (Some("values"), &0.into())
            );
            let [first, second, ..] = words(line);
            assert_eq!(first, second, "a line of two cycles: {line}");
        }
    }
    // Each line is a later cycle, and the next one but where the other program was in the middle of its work.
    let cycles: Vec<u64> =
        told.one[1..].iter().map(|line| line["values"]["cycle"].as_u64().unwrap()).collect();
    let next = cycles.windows(2).filter(|pair| pair[1] == pair[0] + 1).count();
    assert!(cycles.is_sorted() && next * 10 > cycles.len() * 6, "{next} of {}", cycles.len());
    for pair in told.two[1..].windows(2) {
        let at = |line: &Value| line["values"]["release_ns"].as_u64().unwrap();
        assert!(at(&pair[1]) - at(&pair[0]) >= 50_000_000, "{pair:?}");
    }

    let [too_much, outside, forced, of_q, status, rest @ ..] = &told.orders[..] else {
        panic!("{:?}", told.orders)
    };
    assert!(too_much["text"].as_str().unwrap().contains("allows 1024"), "{too_much}");
    assert!(outside["text"].as_str().unwrap().contains("16384 bytes"), "{outside}");
    assert_eq!(forced["answer"], "done", "{forced}");
    assert_eq!(of_q["error"], "unsupported", "{of_q}");
    let plc = &status["status"]["partitions"][0];
    assert_eq!(plc["forced"][0]["name"], "p.word", "{plc:#}");
    assert_eq!(plc["programs"][1]["tasks"][0]["name"], "main", "{plc:#}");
    // From some line on the value is forced after each job, and each job begins with it.
    let values: Vec<[u64; 4]> = told.one[1..].iter().map(words).collect();
    let since = values.iter().position(|[.., word, _]| *word == 1_000).unwrap();
    assert!(since + 20 < values.len(), "forced since line {since}");
    for [first, _, word, seen] in &values[since + 2..] {
        assert_eq!((*word, *seen), (1_000, 1_001), "in cycle {first}");
    }
    // Then it is not, and a value is written once.
    let [released, written, again, _, lines @ .., events] = rest else { panic!("{rest:?}") };
    assert_eq!((&released["answer"], &written["answer"]), (&"done".into(), &"done".into()));
    assert_eq!(again["error"], "refused", "{again}");
    for line in lines {
        let [_, _, word, seen] = words(line);
        assert!((7_000_000..7_003_000).contains(&word) && word == seen, "{line}");
    }
    let events = events["events"].as_array().unwrap();
    let kinds: Vec<&str> = events.iter().map(|event| event["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds, ["forced", "released", "written"], "{events:#?}");

    let plc = &told.report["partitions"][0];
    for key in ["lost", "late_releases", "overruns", "unrecorded"] {
        assert_eq!(plc[key], 0, "{key}: {plc:#}");
    }
    let worst = plc["release_latency_ns"]["max"].as_u64().unwrap();
    assert!(worst <= 10, "a release was {worst} ns late: {plc:#}");
}
