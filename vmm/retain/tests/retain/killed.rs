//! A process that writes generations is killed at any instant: what it had written is there, whole.
//!
//! The process is this test program itself. It tells of each generation that is written, so at least that one must be
//! found. The kernel lives on, so this shows nothing of a loss of power: the tests with files that are cut do.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::PoisonError;
use std::time::Duration;

use crate::common::{Own, STARTING, image, layout};
use takt_program::{Elementary, Flags};
use takt_retain::{Layout, Store};

const FOLDER: &str = "TAKT_RETAIN_FOLDER";
const KILLS: u64 = 100;

fn kept() -> Layout {
    let own: Vec<(String, Own, Flags)> =
        (0..60).map(|n| (format!("v{n}"), Own::One(Elementary::Lint), Flags::RETAIN)).collect();
    let own: Vec<_> = own.iter().map(|(name, ty, flags)| (name.as_str(), *ty, *flags)).collect();
    layout(&image(0, &own))
}

/// Each value is the number of the generation.
fn values(layout: &Layout, number: u64) -> Vec<u8> {
    number.to_le_bytes().repeat(layout.initial().len() / 8)
}

fn write_for_ever(folder: &Path) {
    let layout = kept();
    let (mut store, found) = Store::open(&folder.join("tank")).unwrap();
    let first = found.newest.map_or(0, |newest| newest.number);
    for number in first + 1.. {
        store.save(number, &layout, &values(&layout, number)).unwrap();
        println!("written {number}");
        std::io::stdout().flush().unwrap();
    }
}

#[test]
fn a_process_that_is_killed_leaves_a_whole_generation() {
    if let Some(folder) = std::env::var_os(FOLDER) {
        return write_for_ever(Path::new(&folder));
    }
    let folder = tempfile::tempdir().unwrap();
    let layout = kept();
    let mut last = 0;
    for kill in 0..KILLS {
        let starting = STARTING.write().unwrap_or_else(PoisonError::into_inner);
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args([
                "--exact",
                "killed::a_process_that_is_killed_leaves_a_whole_generation",
                "--nocapture",
            ])
            .env(FOLDER, folder.path())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        drop(starting);
        let mut told = BufReader::new(child.stdout.take().unwrap()).lines();
        let number = |line: &str| {
            let at = line.find("written ")? + "written ".len();
            line[at..].parse::<u64>().ok()
        };
        // It has begun; then the instant is another one each time.
        let mut known = told.by_ref().find_map(|line| number(&line.unwrap())).unwrap();
        std::thread::sleep(Duration::from_micros(kill * 37 % 3000));
        child.kill().unwrap();
        child.wait().unwrap();
        known = told.map_while(Result::ok).filter_map(|line| number(&line)).last().unwrap_or(known);
        let (_, found) = Store::open(&folder.path().join("tank")).unwrap();
        let newest = found.newest.unwrap();
        assert!(newest.number >= known && newest.number > last, "{} after {known}", newest.number);
        assert!(newest.number <= known + 1);
        last = newest.number;
        assert_eq!(layout.restore(&newest).block, values(&layout, newest.number));
    }
}
