//! `takt plc record` and `shadow` with a PLC whose values stop, as they do when it is stopped.

mod common;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixListener;
use std::thread;

use common::{Ended, Folder, status_of};
use serde_json::json;
use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds};

/// A folder with a partition file and a program of one value; its image's hash.
fn plant() -> (Folder, String) {
    let mut image = Builder::new("tank");
    image.code = vec![0xc3];
    image.state_bytes = 4;
    let real = image.elementary(Elementary::Real);
    image.variable(Variable::new("level", real, Area::State, 0));
    let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
    task.budget = Some(Nanoseconds(10_000));
    image.task(task);
    let (folder, bytes) = (Folder::new(), image.build().unwrap());
    fs::write(folder.path().join("tank.plc"), &bytes).unwrap();
    folder.write(
        "plant.toml",
        "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\ncontrol = \"s\"\n\
         [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
         [[partition.program]]\nimage = \"tank.plc\"\n[[schedule]]\nname = \"normal\"\n\
         [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n",
    );
    let hash = Image::verify(&bytes).unwrap().hash();
    (folder, takt_protocol::hex(&hash))
}

/// How Takt goes on behind the values.
#[derive(PartialEq)]
enum Then {
    /// It tells nothing, as long as the command runs.
    Silence,
    Ends,
}

/// Runs the command with a Takt that tells three cycles, each with so many values.
fn run(plant: &(Folder, String), words: &[&str], count: usize, then: Then) -> Ended {
    beside_takt(plant, |folder| folder.takt_plc(words), count, then)
}

fn beside_takt(
    (folder, hash): &(Folder, String),
    command: impl FnOnce(&Folder) -> Ended,
    count: usize,
    then: Then,
) -> Ended {
    let _ = fs::remove_file(folder.path().join("s"));
    let hash = hash.clone();
    let listener = UnixListener::bind(folder.path().join("s")).unwrap();
    let takt = thread::spawn(move || {
        let (stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
        let bytes = "00000000".repeat(count);
        let values = |cycle: u64| {
            json!({"version": 2, "answer": "values", "values": {
                "partition": "plc", "cycle": cycle, "release_ns": cycle * 1_000_000,
                "time_ns": cycle * 1_000_000, "missed": 0, "unsettled": 0, "bytes": bytes,
            }})
        };
        for answer in [
            status_of("tank", &hash),
            json!({"version": 2, "answer": "watching", "partition": "plc", "bytes": 4 * count}),
        ] {
            lines.next().unwrap().unwrap();
            writeln!(&stream, "{answer}").unwrap();
        }
        (1..=3).for_each(|cycle| writeln!(&stream, "{}", values(cycle)).unwrap());
        // Until the command closes its end.
        assert!(then == Then::Ends || lines.next().is_none());
    });
    let ended = command(folder);
    takt.join().unwrap();
    ended
}

#[test]
fn a_recording_of_a_plc_that_stops_is_a_whole_file() {
    let words = ["record", "plant.toml", "--points", "tank.level", "--for", "20ms", "--out"];
    let plant = plant();
    let ended = run(&plant, &[&words[..], &["out.csv"]].concat(), 1, Then::Silence);
    ended.expect(0, "no values have come for 5 s").expect(0, "3 cycles recorded");
    let file = String::from_utf8(plant.0.read("out.csv")).unwrap();
    assert!(file.lines().last().unwrap().starts_with("3,3000000,"), "{file}");
}

#[test]
fn an_earlier_recording_stays_until_there_is_a_row() {
    use std::os::unix::fs::PermissionsExt;
    let plant = plant();
    let kept = plant.0.write("kept.csv", "an earlier one\n");
    fs::set_permissions(&kept, PermissionsExt::from_mode(0o640)).unwrap();
    let words = ["record", "plant.toml", "--points", "tank.level", "--for", "1ms", "--out"];
    let record = |file: &'static str| [&words[..], &[file]].concat();
    let wait = [&record("kept.csv")[..], &["--trigger", "tank.level > 1.0"]].concat();
    let ended = run(&plant, &wait, 2, Then::Ends);
    assert!(ended.text.contains("the trigger has not come"), "{}", ended.text);
    assert!(ended.text.contains("kept.csv stays as it was"), "{}", ended.text);
    assert_eq!(plant.0.read("kept.csv"), b"an earlier one\n");
    let names = || fs::read_dir(plant.0.path()).unwrap().map(|one| one.unwrap().file_name());
    assert!(names().all(|name| !name.to_string_lossy().starts_with(".tmp")));

    run(&plant, &record("kept.csv"), 1, Then::Ends).expect(0, "2 cycles recorded");
    let file = String::from_utf8(plant.0.read("kept.csv")).unwrap();
    assert!(file.starts_with("cycle,") && file.contains("\n2,2000000,"), "{file}");
    assert_eq!(fs::metadata(&kept).unwrap().permissions().mode() & 0o7777, 0o640);

    // The recording does not fit, and the earlier one stays. Ignored, the signal is an error.
    let tool = env!("CARGO_BIN_EXE_takt-plc");
    let script = format!("trap '' XFSZ; ulimit -f 0; exec {tool} \"$@\"");
    let shell = ["-c", &script, "record"];
    for out in ["kept.csv", "kept.svg"] {
        plant.0.write(out, "an earlier one\n");
        let words = [&shell[..], &record(out)].concat();
        beside_takt(&plant, |folder| folder.run("bash", &words), 1, Then::Ends)
            .expect(2, "cannot write");
        assert_eq!(plant.0.read(out), b"an earlier one\n");
    }

    // What is no file is written itself.
    std::os::unix::fs::symlink("/dev/null", plant.0.path().join("null.csv")).unwrap();
    run(&plant, &record("null.csv"), 1, Then::Ends).expect(0, "2 cycles recorded");
    assert!(plant.0.path().join("null.csv").is_symlink());
}

#[test]
fn a_shadow_of_a_plc_that_stops_tells_what_it_has_compared() {
    let words = ["shadow", "plant.toml", "tank", "tank.plc", "--for", "20ms"];
    let ended = run(&plant(), &words, 1, Then::Silence).expect(0, "no values have come for 5 s");
    ended.expect(0, "beside it for 2 cycles");
}
