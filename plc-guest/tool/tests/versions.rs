//! `takt plc load`, `versions`, `commit`, `rollback`, against a socket that answers as Takt does.

mod common;

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixListener;
use std::thread;

use common::{Ended, Folder};
use takt_program::build::{Builder, Task};
use takt_program::{CodeOffset, Nanoseconds};

/// A folder with a partition file and the image of its program `tank`.
fn plant() -> Folder {
    let folder = Folder::new();
    let mut image = Builder::new("tank");
    image.code = vec![0xc3];
    let mut task = Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0));
    task.budget = Some(Nanoseconds(10_000));
    image.task(task);
    fs::write(folder.path().join("tank.plc"), image.build().unwrap()).unwrap();
    let text = "version = 1\n[system]\nname = \"s\"\nmajor_frame = \"1ms\"\ncontrol = \"s\"\n\
        [[partition]]\nname = \"plc\"\nkind = \"plc\"\ncpu = 0\nmemory = \"8MiB\"\n\
        [[partition.program]]\nimage = \"tank.plc\"\n[[schedule]]\nname = \"normal\"\n\
        [[schedule.window]]\npartition = \"plc\"\noffset = \"0us\"\nduration = \"300us\"\n";
    folder.write("plant.toml", text);
    folder
}

fn versions(phase: &str) -> String {
    let image = |version| format!("{{\"version\":\"{version}\",\"hash\":\"{}\"}}", "7a".repeat(32));
    format!(
        "{{\"version\":2,\"answer\":\"versions\",\"versions\":[{{\"program\":\"tank\",\"running\":{},\"other\":{},\
         \"phase\":\"{phase}\",\"reason\":null,\"jobs\":0,\"references_gone\":0,\"took_ns\":0,\"at_ns\":0,\"cycle\":0}}]}}",
        image("1.2.0"),
        image("1.3.0")
    )
}

/// Runs the command with a Takt that gives these answers; what was asked of it, and what the command did.
fn run(words: &[&str], answers: &[String]) -> (Vec<String>, Ended) {
    let folder = plant();
    let listener = UnixListener::bind(folder.path().join("s")).unwrap();
    let answers = answers.to_vec();
    let takt = thread::spawn(move || {
        let mut asked = Vec::new();
        let (stream, _) = listener.accept().unwrap();
        let mut lines = BufReader::new(stream.try_clone().unwrap()).lines();
        for answer in answers {
            let Some(Ok(line)) = lines.next() else { break };
            asked.push(line);
            writeln!(&stream, "{answer}").unwrap();
        }
        asked
    });
    let ended = folder.takt_plc(words);
    (takt.join().unwrap(), ended)
}

fn done() -> String {
    "{\"version\":2,\"answer\":\"done\",\"text\":\"taken\"}".to_owned()
}

#[test]
fn load_sends_the_image_and_waits_until_it_is_prepared() {
    let answers = [done(), versions("preparing"), versions("preparing"), versions("prepared")];
    let (asked, ended) = run(&["load", "plant.toml", "tank", "tank.plc"], &answers);
    ended.expect(0, "runs 1.2.0 (7a7a7a7a), other 1.3.0 (7a7a7a7a), prepared");
    assert!(asked[0].contains("\"request\":\"load\"") && asked[0].contains("\"parts\":1"));
    assert_eq!(asked.len(), 4);
}

#[test]
fn an_order_tells_what_came_of_it() {
    for (order, request, phase, status) in [
        ("commit", "commit", "trial", 0),
        ("commit", "commit", "rolled-back", 5),
        ("commit", "commit", "prepared", 5),
        ("rollback", "roll-back", "rolled-back", 0),
        ("roll-back", "roll-back", "none", 0),
        ("rollback", "roll-back", "held", 5),
    ] {
        let during = if request == "commit" { "committing" } else { "rolling-back" };
        let answers = [done(), versions(during), versions(phase)];
        let (asked, ended) = run(&[order, "plant.toml", "tank"], &answers);
        ended.expect(status, phase);
        assert!(asked[0].contains(&format!("\"request\":\"{request}\"")), "{asked:?}");
    }
}

#[test]
fn what_is_refused_or_not_there_ends_with_its_status() {
    let refusal = r#"{"version":2,"answer":"error","error":"refused","text":"no version is prepared (none)"}"#;
    let (_, ended) = run(&["commit", "plant.toml", "tank"], &[refusal.to_owned()]);
    ended.expect(5, "no version is prepared (none)");
    let plant = plant();
    plant
        .takt_plc(&["commit", "plant.toml", "press"])
        .expect(2, "no program is named `press`; there are tank");
    plant.takt_plc(&["versions", "plant.toml"]).expect(6, "no Takt at");
}

#[test]
fn versions_shows_each_program() {
    let (_, ended) = run(&["versions", "plant.toml"], &[versions("held")]);
    ended.expect(0, "other 1.3.0 (7a7a7a7a), held");
}
