//! Lines on Takt's debug console.
//!
//! A line is formatted into a buffer of fixed size: no allocator, no lock, an upper bound on what
//! it can cost. What does not fit is cut off, and the cut is marked. The finished line is copied to
//! the text area that the host reads, and one port write says how long it is: one exit a line.

use crate::{pages, port};
use core::fmt::{self, Write};
use takt_abi::{memory, port::CONSOLE};

/// Longest line in bytes, with the line feed.
pub const LINE: usize = 160;
/// Ends a line that was cut off.
const CUT: &[u8] = b"...\n";

/// One line of text.
pub struct Line {
    bytes: [u8; LINE],
    length: usize,
}

impl Line {
    /// Formats a line; the line feed is added.
    #[must_use]
    pub fn new(text: fmt::Arguments) -> Self {
        let mut body = Body { line: Self { bytes: [0; LINE], length: 0 }, cut: false };
        // A line that is too long has been marked. If the formatting of a value fails, what there is
        // of it is printed.
        let _ = body.write_fmt(text);
        let Body { mut line, cut } = body;
        line.append(if cut { CUT } else { b"\n" }, LINE);
        line
    }

    /// The line, with its line feed: at most [`LINE`] bytes.
    #[must_use]
    pub fn text(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    /// Prints it, at the price of one VM exit.
    pub fn print(&self) {
        pages::publish_text(self.text());
        port::write(CONSOLE, self.length as u32);
    }

    /// Appends what fits below `limit`; returns whether that was everything. A cut in the middle
    /// of a character is left to the reader of the console, who must expect any bytes.
    fn append(&mut self, text: &[u8], limit: usize) -> bool {
        let taken = text.len().min(limit.saturating_sub(self.length));
        let end = self.length + taken;
        self.bytes[self.length..end].copy_from_slice(&text[..taken]);
        self.length = end;
        taken == text.len()
    }
}

/// A line while it is formatted: the room for the end is kept free.
struct Body {
    line: Line,
    cut: bool,
}

impl Write for Body {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.cut |= !self.line.append(text.as_bytes(), LINE - CUT.len());
        if self.cut { Err(fmt::Error) } else { Ok(()) }
    }
}

/// Formats one line and prints it.
pub fn print(text: fmt::Arguments) {
    Line::new(text).print();
}

const _: () = assert!(LINE <= memory::TEXT_BYTES);

#[cfg(test)]
mod tests {
    use super::*;

    fn finished(text: &str) -> Vec<u8> {
        Line::new(format_args!("{text}")).text().to_vec()
    }

    #[test]
    fn a_short_line_ends_with_a_line_feed() {
        assert_eq!(finished("level 1.2"), b"level 1.2\n");
        assert_eq!(finished(""), b"\n");
    }

    #[test]
    fn the_longest_text_that_fits_is_not_marked() {
        let text = "x".repeat(LINE - CUT.len());
        assert_eq!(finished(&text), format!("{text}\n").as_bytes());
    }

    #[test]
    fn a_longer_text_is_cut_and_marked() {
        let text = "x".repeat(LINE - CUT.len() + 1);
        let line = finished(&text);
        assert_eq!(line.len(), LINE);
        assert!(line.ends_with(b"xx...\n"));
    }

    #[test]
    fn nothing_follows_a_cut() {
        let long = "x".repeat(2 * LINE);
        let line = Line::new(format_args!("{long}{}", "y"));
        assert!(!line.text().contains(&b'y'));
    }
}
