//! Places as the protocol counts them: lines from 0, and UTF-16 units from the start of the line.

use lsp_types::{Position, Range};

/// Where the lines of a text begin.
#[derive(Clone, Debug)]
pub struct Lines {
    starts: Vec<usize>,
}

impl Lines {
    /// Those of this text. A line ends with `\n`, `\r\n` or `\r`.
    pub fn new(text: &str) -> Self {
        let bytes = text.as_bytes();
        let mut starts = vec![0];
        for (at, byte) in bytes.iter().enumerate() {
            let ends = match byte {
                b'\n' => true,
                b'\r' => bytes.get(at + 1) != Some(&b'\n'),
                _ => false,
            };
            if ends {
                starts.push(at + 1);
            }
        }
        Self { starts }
    }

    /// The byte at a position. Behind the end of a line it is the end of the line, behind the last line that of the
    /// text, and within a character its start: a client may be wrong, and no byte is cut.
    pub fn offset(&self, text: &str, position: Position) -> usize {
        let line = position.line as usize;
        let Some(start) = self.starts.get(line).copied() else { return text.len() };
        let end = self.starts.get(line + 1).copied().unwrap_or(text.len());
        let content = text.get(start..end).unwrap_or("").trim_end_matches(['\n', '\r']);
        let mut units = 0;
        for (at, character) in content.char_indices() {
            units += character.len_utf16();
            if units > position.character as usize {
                return start + at;
            }
        }
        start + content.len()
    }

    /// The position of a byte.
    pub fn position(&self, text: &str, offset: usize) -> Position {
        let offset = offset.min(text.len());
        let line = self.starts.partition_point(|start| *start <= offset).saturating_sub(1);
        let start = self.starts.get(line).copied().unwrap_or(0);
        let units = text.get(start..offset).map_or(0, |before| before.encode_utf16().count());
        Position { line: line as u32, character: units as u32 }
    }

    /// The range of these bytes.
    pub fn range(&self, text: &str, bytes: std::ops::Range<usize>) -> Range {
        Range { start: self.position(text, bytes.start), end: self.position(text, bytes.end) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_utf_16_units() {
        // ü has 2 bytes and 1 unit, the face 4 bytes and 2 units.
        let text = "(* ü😀 *) x\r\ny\rz\n";
        let lines = Lines::new(text);
        let x = text.find('x').expect("it is there");
        assert_eq!(lines.position(text, x), Position { line: 0, character: 10 });
        for (at, _) in text.char_indices().filter(|(_, one)| !"\r\n".contains(*one)) {
            assert_eq!(lines.offset(text, lines.position(text, at)), at);
        }
        assert_eq!(lines.position(text, text.find('z').expect("it is there")).line, 2);
        // Within the face, behind the end of a line, behind the last line.
        let face = text.find('😀').expect("it is there");
        assert_eq!(lines.offset(text, Position { line: 0, character: 5 }), face);
        assert_eq!(lines.offset(text, Position { line: 0, character: 9999 }), x + 1);
        assert_eq!(lines.offset(text, Position { line: u32::MAX, character: 0 }), text.len());
    }
}
