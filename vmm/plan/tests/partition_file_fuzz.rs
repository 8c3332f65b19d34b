//! Whatever the bytes are, reading a partition file ends in a system or in a message with a place.
//!
//! The file is hostile input and is read by a program that may be PID 1: a panic would be a machine
//! that does not start and does not say why. The cases come from fixed seeds, so a failure repeats.

mod guest_images;

use std::fs;
use std::path::Path;

use takt_plan::{self as config, check};

/// Files that are good, and between them have every key.
const GOOD: [&[u8]; 6] = [
    include_bytes!("partition_files/good/two-cpus.toml"),
    include_bytes!("partition_files/good/schedules-and-tasks.toml"),
    include_bytes!("partition_files/good/channels.toml"),
    include_bytes!("partition_files/good/host-ports.toml"),
    include_bytes!("partition_files/good/health.toml"),
    include_bytes!("partition_files/good/passthrough.toml"),
];
/// Pieces that a text file does not get from bit flips.
const WORDS: &[&str] = &[
    "[[partition]]\n",
    "[[schedule]]\n",
    "[[schedule.window]]\n",
    "[[partition.task]]\n",
    "[[channel]]\n",
    "[[health]]\n",
    "restarts = { at_most = 100, within = \"1ns\" }\n",
    "\"warm-start\"",
    "\"partition-reset\"",
    "\"sampling\"",
    "\"queuing\"",
    "\"overwrite\"",
    "\"plc:\"",
    "\"host:x\"",
    "host_socket = \"x\"\n",
    "host_file = \"/\"\n",
    "\":\"",
    "depth = 1024\n",
    "[[partition.io]]\n",
    "[[partition.can]]\n",
    "id = \"0x7ff\"\n",
    "length = 8\n",
    "[[partition.port_io]]\n",
    "[[partition.mmio]]\n",
    "[[partition.safe_value]]\n",
    "[[partition.interrupt]]\n",
    "vector = 32\n",
    "ports = \"0x0-0xffff\"\n",
    "\"0xffffffffffffffff\"",
    "\"0000:00:04.0\"",
    "refresh_period = \"60s\"\n",
    "destinations = []\n",
    "65536",
    "[system]\n",
    "version = 1\n",
    "\"plc\"",
    "\"linux\"",
    "\"0us\"",
    "\"18446744073709551615ns\"",
    "\"16777215GiB\"",
    "true",
    "-1",
    "9223372036854775807",
    "1e999",
    "[",
    "{",
    "'''",
    "\"\"\"",
    "\\u0000",
    "\r",
    "\r\n",
    "\t",
    "\0",
    "é",
    "\u{feff}",
    "\u{202e}",
    "= = =",
    "a.b.c.d = 1\n",
    "1979-05-27T07:32:00Z",
    "nan",
];

/// Marsaglia's xorshift64: repeatable, and no dependency for ten lines.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % bound.max(1) as u64) as usize
    }
}

/// Loads `bytes` as a partition file; whether it was good.
fn load(name: &str, case: usize, bytes: &[u8]) -> bool {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if case == 0 {
        // The fixtures name images of the folder above theirs.
        fs::create_dir_all(folder.join("case")).unwrap();
        fs::write(folder.join("dummy-image"), "").unwrap();
        fs::write(folder.join("dummy-kernel"), guest_images::kernel()).unwrap();
        fs::write(folder.join("dummy-plc"), guest_images::plc()).unwrap();
        fs::write(folder.join("dummy-program"), guest_images::program(&[])).unwrap();
    }
    let path = folder.join("case/case.toml");
    fs::write(&path, bytes).unwrap();
    let shown = || format!("{name} case {case}: {:?}", String::from_utf8_lossy(bytes));
    match config::load(&path, Some(2)) {
        Ok(file) => {
            let rows = check::report(&file);
            assert!(file.partitions().iter().all(|p| rows.contains(p.name())), "{}", shown());
            assert!(file.channels().iter().all(|c| rows.contains(&c.name)), "{}", shown());
            assert!(check::needs(&file).starts_with("memory "), "{}", shown());
            true
        }
        Err(error) => {
            let message = error.to_string();
            let prefix = format!("error: {}:", path.display());
            let place = message.strip_prefix(&prefix).unwrap_or_else(|| panic!("{}", shown()));
            let mut place = place.splitn(3, ':').map(str::parse::<usize>);
            let (line, column) = (place.next().unwrap(), place.next().unwrap());
            let last = bytes.iter().filter(|b| **b == b'\n').count() + 1;
            assert!((1..=last).contains(&line.unwrap()), "{message}\n{}", shown());
            assert!((1..=bytes.len() + 1).contains(&column.unwrap()), "{message}\n{}", shown());
            assert!(message.contains(" = allowed: "), "{message}\n{}", shown());
            false
        }
    }
}

fn splice(bytes: &mut Vec<u8>, random: &mut Random, piece: &[u8]) {
    let at = random.below(bytes.len() + 1);
    let end = (at + random.below(12)).min(bytes.len());
    bytes.splice(at..end, piece.iter().copied());
}

fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    match random.below(7) {
        0 => {
            let at = random.below(bytes.len());
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
        1 => bytes.truncate(random.below(bytes.len() + 1)),
        2 => {
            let word = WORDS[random.below(WORDS.len())];
            splice(bytes, random, word.as_bytes());
        }
        3 => {
            let start = random.below(bytes.len());
            let end = (start + random.below(60)).min(bytes.len());
            let piece = bytes[start..end].to_vec();
            splice(bytes, random, &piece);
        }
        // Numbers are where the rules are; most other damage already ends in the parser.
        _ => {
            let digits: Vec<usize> =
                (0..bytes.len()).filter(|i| bytes[*i].is_ascii_digit()).collect();
            if let Some(&at) = digits.get(random.below(digits.len())) {
                bytes[at] = b'0' + random.below(10) as u8;
            }
        }
    }
}

#[test]
fn random_bytes_are_refused_with_a_place() {
    let mut random = Random(0x7a47);
    for case in 0..2000 {
        let length = random.below(200);
        let bytes: Vec<u8> = (0..length).map(|_| random.below(256) as u8).collect();
        assert!(!load("random-bytes", case, &bytes));
    }
}

#[test]
fn random_words_are_refused_with_a_place() {
    let mut random = Random(0x1e57);
    for case in 0..2000 {
        let count = random.below(12);
        let text: String = (0..count).map(|_| WORDS[random.below(WORDS.len())]).collect();
        assert!(!load("random-words", case, text.as_bytes()));
    }
}

#[test]
fn a_damaged_file_is_good_or_is_refused_with_a_place() {
    let mut random = Random(0xf11e);
    let mut good = 0;
    for case in 0..6000 {
        let mut bytes = GOOD[case % GOOD.len()].to_vec();
        for _ in 0..=random.below(4) {
            mutate(&mut bytes, &mut random);
        }
        good += usize::from(load("damaged", case, &bytes));
    }
    // Both ways out must have been taken, or the test looks at less than it says.
    assert!((100..5000).contains(&good), "{good} of 6000 were good");
}

#[test]
fn every_truncation_is_good_or_is_refused_with_a_place() {
    for good in GOOD {
        for length in 0..good.len() {
            load("truncated", length, &good[..length]);
        }
        assert!(load("truncated", good.len(), good));
    }
}
