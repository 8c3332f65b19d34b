//! What fetches the values, against a Takt that says what the test wants.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use takt_program::build::{Builder, Task, Variable};
use takt_program::{Area, CodeOffset, Elementary, Image, Nanoseconds};
use takt_protocol::{
    Answer, ErrorKind, ProgramState, ProgramStatus, Refusal, Request, Status, Values,
};
use takt_scheduler::time::Nanos;

use super::tests::status;
use super::view::Watched;
use super::watcher::Watcher;

const FILE: &str = r#"
version = 1
[system]
name = "s"
major_frame = "1ms"
control = "takt.sock"
[[partition]]
name = "plc"
kind = "plc"
cpu = 0
memory = "16MiB"
[[partition.program]]
image = "tank.plc"
name = "tank"
[[schedule]]
name = "normal"
[[schedule.window]]
partition = "plc"
offset = "0us"
duration = "300us"
"#;

/// A program whose `level` lies at this place.
fn image(level: u32) -> Vec<u8> {
    let mut image = Builder::new("tank");
    image.code = vec![0xc3];
    image.state_bytes = 16;
    image.task(Task::cyclic("main", Nanoseconds(1_000_000), CodeOffset(0)));
    let ty = image.elementary(Elementary::Uint);
    image.variable(Variable::new("level", ty, Area::State, level));
    image.variable(Variable::new("count", ty, Area::State, 12));
    image.build().unwrap()
}

/// A folder with the partition file and an image of it.
fn plant(name: &str, image: &[u8]) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("takt-top-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("plant.toml"), FILE).unwrap();
    fs::write(folder.join("tank.plc"), image).unwrap();
    folder
}

/// The status of a Takt in which this image runs.
fn running(image: &[u8]) -> Status {
    let mut status = status(1, 0, 0);
    status.partitions[0].programs = vec![ProgramStatus {
        name: "tank".into(),
        state: Some(ProgramState::Running),
        image: Some(takt_protocol::hex(&Image::parse(image).unwrap().hash())),
        tasks: Vec::new(),
    }];
    status
}

fn values(bytes: &str) -> Answer {
    let (partition, bytes) = ("plc".into(), bytes.into());
    let (release_ns, time_ns, missed, unsettled) = (5_000_000, 0, 0, 0);
    let values = Values { partition, cycle: 5, release_ns, time_ns, missed, unsettled, bytes };
    Answer::Values { values }
}

fn watching() -> Answer {
    Answer::Watching { partition: "plc".into(), bytes: 4 }
}

fn pong() -> Answer {
    Answer::Done { text: String::new() }
}

fn refused(text: &str) -> Answer {
    Answer::Error(Refusal::new(ErrorKind::Refused, text))
}

/// A Takt that gives these answers to the requests of one connection after the other. Returns the requests.
fn takt(folder: &Path, connections: Vec<Vec<Vec<Answer>>>) -> JoinHandle<Vec<Request>> {
    let listener = UnixListener::bind(folder.join("takt.sock")).unwrap();
    thread::spawn(move || {
        let mut asked = Vec::new();
        for answers in connections {
            let stream: UnixStream = listener.accept().unwrap().0;
            let mut requests = BufReader::new(stream.try_clone().unwrap());
            for answers in answers {
                let mut line = Vec::new();
                requests.read_until(b'\n', &mut line).unwrap();
                asked.push(Request::parse(line.strip_suffix(b"\n").unwrap()).unwrap());
                answers.into_iter().for_each(|a| (&stream).write_all(&a.line()).unwrap());
            }
        }
        asked
    })
}

struct Page {
    folder: PathBuf,
    watcher: Watcher,
    watched: Vec<Watched>,
}

impl Page {
    fn new(folder: PathBuf, names: &[&str]) -> Self {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let file = folder.join("plant.toml");
        let watcher = Watcher::new(&file, &names, Duration::from_millis(500)).unwrap();
        let watched = watcher.watched();
        Self { folder, watcher, watched }
    }

    /// What went wrong in an update, or the values after it.
    fn update(&mut self) -> String {
        let socket = self.folder.join("takt.sock");
        match self.watcher.update(&socket, &mut self.watched) {
            Err(error) => error.to_string(),
            Ok(()) => match &self.watched[0].latest {
                None => "nothing yet".into(),
                Some((_, texts)) => texts.join(" "),
            },
        }
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.folder);
    }
}

#[test]
fn the_newest_line_that_has_come_is_shown_and_the_rate_is_bounded() {
    let image = image(0);
    let mut page = Page::new(plant("newest", &image), &["tank.count", "tank.level"]);
    let status = Answer::Status { status: Box::new(running(&image)) };
    let answers = vec![
        vec![status],
        vec![watching()],
        vec![pong()],
        vec![values("01000200"), values("03000401"), pong()],
        vec![pong()],
    ];
    let takt = takt(&page.folder, vec![answers]);
    assert_eq!(page.update(), "nothing yet");
    assert_eq!(page.update(), "3 260");
    assert_eq!(page.update(), "3 260", "no line has come since");
    let asked = takt.join().unwrap();
    let Request::Watch { partition, ranges, interval } = &asked[1] else { panic!("{asked:?}") };
    assert_eq!((partition.as_str(), *interval), ("plc", Nanos::from_millis(500)));
    assert_eq!(ranges.iter().map(|range| range.offset).collect::<Vec<_>>(), [12, 0]);
    assert!(asked[2..].iter().all(|request| *request == Request::Ping), "{asked:?}");
}

#[test]
fn another_version_is_watched_by_the_names_of_its_own_image_and_not_before() {
    let (old, new) = (image(0), image(4));
    let mut page = Page::new(plant("version", &old), &["tank.level"]);
    let status = |image: &[u8]| vec![Answer::Status { status: Box::new(running(image)) }];
    let ended = refused("values of tank are watched no longer");
    let first = vec![status(&old), vec![watching()], vec![values("0100"), pong()], vec![ended]];
    let connections = vec![
        first,
        vec![status(&new)],
        vec![status(&new), vec![watching()], vec![values("0700"), pong()]],
    ];
    let takt = takt(&page.folder, connections);
    assert_eq!(page.update(), "1");
    assert_eq!(page.update(), "refused: values of tank are watched no longer");
    assert!(page.update().contains("is not the one that runs"), "the file has the old image");
    assert!(page.watched[0].latest.is_none(), "its values are those of no version");
    fs::write(page.folder.join("tank.plc"), &new).unwrap();
    assert_eq!(page.update(), "7");
    let asked = takt.join().unwrap();
    let offsets = asked.iter().filter_map(|request| match request {
        Request::Watch { ranges, .. } => Some(ranges[0].offset),
        _ => None,
    });
    assert_eq!(offsets.collect::<Vec<_>>(), [0, 4]);
}

#[test]
fn a_takt_that_was_started_again_shows_no_value_of_the_run_before() {
    let image = image(0);
    let mut page = Page::new(plant("again", &image), &["tank.level"]);
    let begun = |more: Vec<Vec<Answer>>| {
        let status = Answer::Status { status: Box::new(running(&image)) };
        let begun = vec![vec![status], vec![watching()]];
        [begun, more].concat()
    };
    let first = begun(vec![vec![values("0100"), pong()]]);
    let takt =
        takt(&page.folder, vec![first, begun(vec![vec![pong()], vec![values("0200"), pong()]])]);
    assert_eq!(page.update(), "1");
    assert!(page.update().starts_with("Takt does not answer"));
    assert!(page.watched[0].latest.is_some(), "while there is none, the last values stay");
    assert_eq!(page.update(), "nothing yet");
    assert_eq!(page.update(), "2");
    takt.join().unwrap();
}

#[test]
fn a_name_without_a_value_is_refused_before_anything_is_shown() {
    let folder = plant("names", &image(0));
    let names = |name: &str| vec!["tank.count".to_owned(), name.to_owned()];
    let new = |name| Watcher::new(&folder.join("plant.toml"), &names(name), Duration::ZERO);
    let error = new("tank.lever").err().unwrap();
    assert_eq!(error.status(), takt_client::error::USAGE);
    assert!(error.to_string().contains("no value is named `tank.lever`"), "{error}");
    assert!(new("*.LEVEL").is_ok());
    fs::remove_dir_all(&folder).unwrap();
}
