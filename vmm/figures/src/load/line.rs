//! What a load says on the console.
//!
//! A line `takt-load: NAME COUNT UNIT`, such as `takt-load: compile 37 objects`. It is the guest's
//! word: only shown, and bounded, since a guest can print what it likes.

const MARK: &[u8] = b"takt-load: ";
/// Longer lines are not looked at.
const LINE_MAX: usize = 512;
/// Longest name and unit.
const WORD_MAX: usize = 32;

/// Cuts a console's output into lines, in memory that does not grow with them.
#[derive(Debug, Default)]
pub struct Lines {
    line: Vec<u8>,
}

impl Lines {
    /// Takes output, and calls `line` with each line that is complete and not too long.
    pub fn add(&mut self, bytes: &[u8], mut line: impl FnMut(&[u8])) {
        for &byte in bytes {
            if byte != b'\n' {
                if self.line.len() <= LINE_MAX {
                    self.line.push(byte);
                }
            } else {
                if self.line.len() <= LINE_MAX {
                    line(self.line.trim_ascii_end());
                }
                self.line.clear();
            }
        }
    }
}

/// What a load has got done, as it says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Word<'a> {
    /// The load.
    pub load: &'a str,
    /// How many.
    pub count: u64,
    /// Of what.
    pub unit: &'a str,
}

impl<'a> Word<'a> {
    /// What a line of the console says of a load; a prompt may stand before it.
    #[must_use]
    pub fn of(line: &'a [u8]) -> Option<Word<'a>> {
        let at = line.windows(MARK.len()).position(|part| part == MARK)?;
        let rest = std::str::from_utf8(line.get(at + MARK.len()..)?).ok()?;
        let mut words = rest.split(' ');
        let mut word = || words.next().filter(|word| plain(word));
        let (load, count, unit) = (word()?, word()?, word()?);
        Some(Word { load, count: count.parse().ok()?, unit })
    }
}

fn plain(word: &str) -> bool {
    let legal = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'/');
    (1..=WORD_MAX).contains(&word.len()) && word.bytes().all(legal)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The counts that a console tells.
    fn counts(console: &[u8]) -> Vec<u64> {
        let (mut lines, mut counts) = (Lines::default(), Vec::new());
        lines.add(console, |line| counts.extend(Word::of(line).map(|word| word.count)));
        counts
    }

    #[test]
    fn the_lines_of_a_load_are_found_among_others() {
        let console = b"[    1.2] Linux\r\ntakt-load: compile 2 objects\r\nnoise\r\n\
                        linux# takt-load: compile 37 objects\r\ntakt-load: compile 39 obj";
        assert_eq!(counts(console), [2, 37]);
        let word = Word::of(b"takt-load: memory 16 MiB").unwrap();
        assert_eq!(word, Word { load: "memory", count: 16, unit: "MiB" });
    }

    #[test]
    fn however_the_output_is_cut() {
        let (mut lines, mut seen) = (Lines::default(), 0);
        for byte in b"x\ntakt-load: compile 5 objects\r\n" {
            lines.add(&[*byte], |line| seen += Word::of(line).map_or(0, |word| word.count));
        }
        assert_eq!(seen, 5);
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
            assert_eq!(Word::of(line.as_bytes()), None, "{line}");
        }
        assert_eq!(Word::of(b"takt-load: compile 1 \xff"), None);
        let long = format!("{}takt-load: compile 1 objects\n", "x".repeat(1 << 20));
        assert_eq!(counts(long.as_bytes()), [0; 0]);
        assert_eq!(counts(b"\xff\x00takt-load: compile 1 objects\n"), [1]);
    }
}
