//! Lines and columns of a text.
//!
//! A file may be one line of 64 MiB and have a million defects, so neither the file nor the line is read again for each
//! of them.

use crate::error::Position;

/// Bytes from one known position to the next.
const STEP: usize = 1024;

/// The positions of all bytes of a text.
#[derive(Debug)]
pub struct Positions<'a> {
    bytes: &'a [u8],
    /// At each multiple of [`STEP`].
    known: Vec<Position>,
}

impl<'a> Positions<'a> {
    pub fn new(text: &'a str) -> Self {
        let bytes = text.as_bytes();
        let mut at = Position { line: 1, column: 1 };
        let mut known = vec![at];
        for chunk in bytes.chunks_exact(STEP) {
            at = behind(at, chunk);
            known.push(at);
        }
        Self { bytes, known }
    }

    /// The position of the character at a byte, or of the end behind the last one.
    pub fn of(&self, offset: usize) -> Position {
        let offset = offset.min(self.bytes.len());
        behind(self.known[offset / STEP], &self.bytes[offset / STEP * STEP..offset])
    }
}

/// The position behind some bytes that begin at one.
fn behind(at: Position, bytes: &[u8]) -> Position {
    bytes.iter().fold(at, |Position { line, column }, byte| match byte {
        b'\n' => Position { line: line + 1, column: 1 },
        // What goes on with a character (UTF-8) is no character of its own.
        0x80..=0xbf => Position { line, column },
        _ => Position { line, column: column + 1 },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_character_has_the_position_that_counting_gives() {
        let text = format!("a\nä\r\n{}\n\n😀{}ü\n", "é".repeat(3000), "x".repeat(STEP));
        for text in [&*text, "", "\n", &"y".repeat(2 * STEP)] {
            let positions = Positions::new(text);
            let (mut line, mut column) = (1, 1);
            for (offset, c) in text.char_indices() {
                assert_eq!(positions.of(offset), Position { line, column }, "{offset}");
                (line, column) = if c == '\n' { (line + 1, 1) } else { (line, column + 1) };
            }
            assert_eq!(positions.of(text.len()), Position { line, column });
            assert_eq!(positions.of(text.len() + 1), Position { line, column });
        }
    }
}
