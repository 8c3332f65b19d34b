//! As many values as a PLC can show, and many forced ones, beside a Linux that is never idle.

use std::fs;
use std::path::{Path, PathBuf};

use takt_test_programs::{Entry, Program, cyclic, us};
use takt_tests::{BUSY, File, Host, Value, long, plc_image, save_bytes, target};

/// Values of 4 bytes, from the second page of the state on. Each job writes its number into all of them.
const POINTS: usize = 10_000;
const FIRST: usize = 0x1000;
const FORCED: usize = 100;
/// Clients that force them.
const FORCING: usize = 4;

/// Which value is forced, and what to.
fn forced(number: usize) -> (usize, u32) {
    (number * 97 + 5, 0x7f00_0000 + number as u32)
}

/// The request to watch these ranges of the state.
fn watch(interval_ms: u64, ranges: &[(usize, usize)]) -> String {
    let ranges: Vec<String> =
        ranges.iter().map(|(offset, bytes)| format!("[0,1,{offset},{bytes}]")).collect();
    format!(
        r#"{{"version":2,"request":"watch","partition":"plc","interval_ns":{},"ranges":[{}]}}"#,
        interval_ms * 1_000_000,
        ranges.join(",")
    )
}

/// The same values three times: at once, in a thousand pieces, and the second half before the first.
fn watches() -> [Vec<(usize, usize)>; 3] {
    let bytes = 4 * POINTS;
    let each = bytes / 1_000;
    let pieces = (0..1_000).map(|i| (FIRST + i * each, each)).collect();
    let half = bytes / 2;
    [vec![(FIRST, bytes)], pieces, vec![(FIRST + half, half), (FIRST, half)]]
}

/// A folder with the requests.
fn requests(interval_ms: u64) -> PathBuf {
    let folder = target("tests").join("many-points");
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, text: String| fs::write(folder.join(name), text).unwrap();
    for (client, ranges) in watches().iter().enumerate() {
        write(&format!("watch-{client}"), watch(interval_ms, ranges));
    }
    write("watch-each", watch(0, &watches()[0]));
    for client in 0..FORCING {
        let lines = (0..FORCED / FORCING).map(|i| {
            let (point, value) = forced(FORCING * i + client);
            let offset = FIRST + 4 * point;
            format!(
                "{{\"version\":2,\"request\":\"force\",\"partition\":\"plc\",\"point\":[0,1,{offset},4,255],\
                 \"value\":{value},\"name\":\"p.row[{point}]\",\"text\":\"{value}\"}}\n"
            )
        });
        write(&format!("force-{client}"), lines.collect());
    }
    fs::canonicalize(folder).unwrap()
}

/// The values of a line in the order of their places, however the client asked for them.
fn values(client: usize, line: &Value) -> Vec<u32> {
    assert_eq!(line["answer"], "values", "{line}");
    let digits = line["values"]["bytes"].as_str().unwrap().as_bytes();
    assert_eq!(digits.len(), 8 * POINTS);
    let word = |digits: &[u8]| {
        u32::from_str_radix(std::str::from_utf8(digits).unwrap(), 16).unwrap().swap_bytes()
    };
    let mut all: Vec<u32> = digits.chunks(8).map(word).collect();
    if client == 2 {
        all.rotate_left(POINTS / 2);
    }
    all
}

/// How many values of a line are forced. All others are the number of one job.
fn assert_of_one_cycle(client: usize, line: &Value) -> usize {
    let mut all = values(client, line);
    // Point 0 is never forced.
    let job = all[0];
    let mut count = 0;
    for (point, value) in (0..FORCED).map(forced) {
        if all[point] == value {
            (all[point], count) = (job, count + 1);
        }
    }
    let other = all.iter().position(|value| *value != job);
    assert_eq!(other, None, "client {client}, cycle {}: {job}", line["values"]["cycle"]);
    count
}

fn answers(path: &Path) -> Vec<Value> {
    let text = fs::read_to_string(path).unwrap_or_default();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[ignore = "takes long: scripts/test --all"]
#[test]
fn ten_thousand_values_and_a_hundred_forced_ones_move_no_release() {
    let (alone, time) = if long() { ("60s", "60s") } else { ("1s", "3s") };
    let (interval_ms, lines) = if long() { (1_000, 50) } else { (200, 8) };
    let folder = requests(interval_ms);
    let program = Program::new("p").state_bytes((FIRST + 4 * POINTS) as u32);
    let program = program.task(cyclic("main", us(1_000), 0, Entry::Fill), POINTS as u64);
    let image = fs::canonicalize(save_bytes("many-points.plc", &program.image())).unwrap();
    let kernel = fs::canonicalize(plc_image("kernel")).unwrap();
    let table = format!(
        "memory = \"32MiB\"\nimage = {kernel:?}\nrelease_guard = \"10us\"\n[[partition.program]]\nimage = {image:?}\n\
         name = \"p\"\nwatch = \"60KiB\"\nallow_force = true"
    );
    let file = File::new("1ms")
        .plc_with("plc", &table)
        .linux(BUSY)
        .schedule("normal")
        .window("plc", 0, 300)
        .save("many-points");
    let host = Host::new().with("--memory", "512").with("--program", env!("CARGO_BIN_EXE_talk"));
    let needed = [&file, &folder, &image, &kernel];
    let host = needed.into_iter().fold(host, |host, path| host.with_file(path));
    let host = ["guest/vmlinuz", "guest/initrd.img"]
        .into_iter()
        .fold(host, |host, path| host.with_file(&target(path)));
    let (file, folder) = (file.to_str().unwrap(), folder.to_str().unwrap());
    let arguments = [file, folder, alone, time, &lines.to_string()];
    let out = target("tests").join("many-points.out");
    let _ = fs::remove_dir_all(&out);
    let outcome = host.given_up_after(3_000).run("many-points", &arguments);
    let said = fs::read_to_string(out.join("takt")).unwrap_or_default();
    assert_eq!(outcome.status, 0, "{}\n{said}", outcome.output);

    for client in 0..3 {
        let told = answers(&out.join(format!("watched-{client}")));
        let (first, told) = told.split_first().unwrap();
        assert_eq!((&first["answer"], &first["bytes"]), (&"watching".into(), &40_000.into()));
        assert_eq!(told.len(), lines);
        let cycle = |line: &Value| line["values"]["cycle"].as_u64().unwrap();
        assert!(told.windows(2).all(|pair| cycle(&pair[0]) < cycle(&pair[1])));
        // Once forced, a value stays so.
        let counts: Vec<usize> =
            told.iter().map(|line| assert_of_one_cycle(client, line)).collect();
        println!("client {client}: {counts:?} values forced");
        assert!(counts.is_sorted(), "client {client}: {counts:?}");
        assert_eq!(counts.last(), Some(&FORCED), "client {client}: {counts:?}");
    }
    for client in 0..FORCING {
        let told = answers(&out.join(format!("forced-{client}")));
        assert_eq!(told.len(), FORCED / FORCING);
        assert!(told.iter().all(|answer| answer["answer"] == "done"), "{told:#?}");
    }
    let status = &answers(&out.join("ending"))[0]["status"];
    assert_eq!(status["partitions"][0]["forced"].as_array().map(Vec::len), Some(FORCED));
    let [alone, watched] = ["alone.json", "report.json"].map(|name| {
        let text = fs::read_to_string(out.join(name)).unwrap();
        serde_json::from_str::<Value>(&text).unwrap()
    });
    for (who, report) in [("alone", &alone), ("watched", &watched)] {
        let plc = &report["partitions"][0];
        let share = report["partitions"][1]["cpu_share"].as_f64().unwrap();
        println!("{who}: {}, Linux {share:.2}", plc["release_latency_ns"]);
        // It never idles, so it has had what the PLC and the clients have left.
        assert!(share > 0.5, "{who}: Linux had {share} of the processor");
        for key in ["lost", "late_releases", "overruns", "unrecorded"] {
            assert_eq!(plc[key], 0, "{who}, {key}: {plc:#}");
        }
    }
    // Both runs have the same releases, so a release that was moved shows in the latest one.
    let latest = |report: &Value| report["partitions"][0]["release_latency_ns"]["max"].as_u64();
    let (alone, watched) = (latest(&alone).unwrap(), latest(&watched).unwrap());
    assert!(alone <= 10 && watched <= 10 && watched <= alone + 10, "{alone} and {watched} ns");
}
