//! Sources that no person would write: the cases, cut into words and put together again at random.
//!
//! They reach deeper than random bytes, and `tests/fuzz` goes on from there with a fuzzer.
//! `TAKT_TEST_LONG=1` makes it five hundred times as many.

use std::path::Path;

use takt_st::diagnostic::Code;
use takt_st::format::{self, FormatError};
use takt_st::project;
use takt_st::source::Sources;

/// A small generator with a fixed start (Marsaglia, "Xorshift RNGs", 2003), so that every run is the
/// same.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 % bound.max(1) as u64) as usize
    }
}

fn collect(folder: &Path, into: &mut Vec<String>) {
    for entry in std::fs::read_dir(folder).expect("the folder is there") {
        let path = entry.expect("it can be listed").path();
        if path.is_dir() {
            collect(&path, into);
        } else {
            into.push(std::fs::read_to_string(&path).expect("a case is text"));
        }
    }
}

/// A source with some words left out, doubled, exchanged or taken from another one.
fn spoiled(random: &mut Random, cases: &[String]) -> String {
    let mut words: Vec<&str> =
        cases[random.below(cases.len())].split_inclusive([' ', '\n', '(', ';', ',']).collect();
    for _ in 0..=random.below(6) {
        let at = random.below(words.len());
        match random.below(4) {
            0 if words.len() > 1 => {
                words.remove(at);
            }
            1 => words.insert(at, words[at]),
            2 => {
                let other = random.below(words.len());
                words.swap(at, other);
            }
            _ => {
                let other = &cases[random.below(cases.len())];
                let others: Vec<&str> = other.split_inclusive([' ', '\n', '(', ';']).collect();
                words.insert(at, others[random.below(others.len())]);
            }
        }
    }
    words.concat()
}

#[test]
fn no_source_makes_the_compiler_panic() {
    let mut cases = Vec::new();
    collect(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases"), &mut cases);
    cases.sort();
    let mut random = Random(0x5374_7275_6374_7572);
    let count = if std::env::var_os("TAKT_TEST_LONG").is_some() { 30_000 } else { 60 };
    for round in 0..count {
        let source = spoiled(&mut random, &cases);
        let mut sources = Sources::new();
        sources.add("hostile.st", source.as_bytes()).expect("it is text");
        let checked = std::panic::catch_unwind(move || project::check("hostile", &mut sources));
        let checked = checked.unwrap_or_else(|_| panic!("round {round}:\n{source}"));
        let checked = checked.expect("there is a thread");
        let errors = checked.diagnostics.iter().filter(|one| one.is_error()).count();
        assert_eq!(checked.program.is_some(), errors == 0, "round {round}:\n{source}");
        let gap = checked.diagnostics.iter().any(|one| one.code == Code::Internal);
        assert!(!gap, "round {round}: something is left out\n{source}");
    }
}

/// Whether it was formatted. What comes out says the same and stays as it is.
fn formatted_well(source: &str) -> bool {
    let mut sources = Sources::new();
    let file = sources.add("hostile.st", source.as_bytes()).expect("it is text");
    let once = match format::format(&sources, file) {
        Ok(once) => once,
        Err(FormatError::Syntax(_)) => return false,
        Err(error) => panic!("{error}"),
    };
    let again = sources.add("once.st", once.as_bytes()).expect("it is text");
    assert_eq!(format::format(&sources, again).expect("it parses"), once);
    true
}

#[test]
fn no_source_makes_the_formatter_panic_or_change_its_mind() {
    let mut cases = Vec::new();
    collect(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases"), &mut cases);
    cases.sort();
    let mut random = Random(0x466F_726D_6174_7465);
    let count = if std::env::var_os("TAKT_TEST_LONG").is_some() { 200_000 } else { 2000 };
    let mut formatted = 0;
    for round in 0..count {
        let source = spoiled(&mut random, &cases);
        let well = std::panic::catch_unwind(|| formatted_well(&source));
        formatted += usize::from(well.unwrap_or_else(|_| panic!("round {round}:\n{source}")));
    }
    assert!(formatted > count / 50, "only {formatted} of {count} parse");
}
