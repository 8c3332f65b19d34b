//! What a load says on the console.
//!
//! A line `takt-load: NAME COUNT UNIT`, such as `takt-load: compile 37 objects`. It is the guest's
//! word: shown as such, used for nothing else, and bounded, since a guest can print what it likes.

use std::io::{self, Read};

use crate::load::Progress;

const MARK: &str = "takt-load: ";
/// Longer lines are not looked at.
const LINE_MAX: usize = 512;
/// Longest name and unit.
const WORD_MAX: usize = 32;

/// Cuts a console's output into lines.
#[derive(Default)]
pub struct Lines {
    line: Vec<u8>,
}

impl Lines {
    /// Takes output, and calls `line` with each line that is complete and not too long.
    pub fn add(&mut self, bytes: &[u8], mut line: impl FnMut(&str)) {
        for &byte in bytes {
            if byte != b'\n' {
                if self.line.len() <= LINE_MAX {
                    self.line.push(byte);
                }
            } else {
                if self.line.len() <= LINE_MAX {
                    line(String::from_utf8_lossy(&self.line).trim_end());
                }
                self.line.clear();
            }
        }
    }
}

/// What a line of the console says of a load.
pub fn of(line: &str) -> Option<Progress> {
    let mut words = line.split_once(MARK)?.1.split(' ');
    let mut word = || words.next().filter(|w| plain(w));
    let (load, count, unit) = (word()?, word()?, word()?);
    Some(Progress { load: load.into(), count: count.parse().ok()?, unit: unit.into() })
}

fn plain(word: &str) -> bool {
    let legal = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'/');
    (1..=WORD_MAX).contains(&word.len()) && word.bytes().all(legal)
}

/// The last that a whole console says.
pub fn last(mut console: impl Read) -> io::Result<Option<Progress>> {
    let (mut lines, mut last, mut buffer) = (Lines::default(), None, [0; 4096]);
    loop {
        match console.read(&mut buffer) {
            Ok(0) => return Ok(last),
            Ok(read) => lines.add(&buffer[..read], |line| last = of(line).or(last.take())),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn progress(count: u64) -> Option<Progress> {
        Some(Progress { load: "compile".into(), count, unit: "objects".into() })
    }

    #[test]
    fn the_last_line_of_a_load_counts() {
        let console = "[    1.2] Linux\r\ntakt-load: compile 2 objects\r\nnoise\r\n\
                       takt-load: compile 37 objects\r\ntakt-load: compile 39 obj";
        assert_eq!(last(console.as_bytes()).unwrap(), progress(37));
        assert_eq!(last(&b"nothing\n"[..]).unwrap(), None);
    }

    #[test]
    fn however_the_output_is_cut() {
        let (mut lines, mut seen) = (Lines::default(), None);
        for byte in b"x\ntakt-load: compile 5 objects\r\n" {
            lines.add(&[*byte], |line| seen = of(line).or(seen.take()));
        }
        assert_eq!(seen, progress(5));
    }

    #[test]
    fn what_a_hostile_guest_prints_is_not_taken() {
        for line in [
            "takt-load: ",
            "takt-load: compile",
            "takt-load: compile -1 objects",
            "takt-load: compile 99999999999999999999999 objects",
            "takt-load: <b> 1 objects",
            "takt-load: compile 1 \u{1b}[2Jobjects",
            &format!("takt-load: compile 1 {}", "x".repeat(WORD_MAX + 1)),
        ] {
            assert_eq!(of(line), None, "{line}");
        }
        let long = format!("{}takt-load: compile 1 objects\n", "x".repeat(1 << 20));
        assert_eq!(last(long.as_bytes()).unwrap(), None);
        assert_eq!(last(&b"\xff\x00takt-load: compile 1 objects\n"[..]).unwrap(), progress(1));
    }
}
