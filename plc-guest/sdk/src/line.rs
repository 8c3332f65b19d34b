//! Lines of the log with numbers in them.

use core::fmt::{self, Write};

use crate::call::{LOG_BYTES, log};

/// A line in the making. What is longer than a line of the log is cut.
pub struct Line {
    bytes: [u8; LOG_BYTES],
    length: usize,
}

impl Line {
    /// Logs what the arguments say; see [`log!`](crate::log).
    pub fn log(arguments: fmt::Arguments<'_>) {
        let mut line = Self { bytes: [0; LOG_BYTES], length: 0 };
        // The only error is that it is full.
        let _ = line.write_fmt(arguments);
        log(line.text());
    }

    fn text(&self) -> &str {
        core::str::from_utf8(&self.bytes[..self.length]).unwrap_or_default()
    }
}

impl Write for Line {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for character in text.chars() {
            let rest = &mut self.bytes[self.length..];
            if rest.len() < character.len_utf8() {
                return Err(fmt::Error);
            }
            self.length += character.encode_utf8(rest).len();
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_is_too_long_is_cut_between_characters() {
        let mut line = Line { bytes: [0; LOG_BYTES], length: 0 };
        assert!(write!(line, "{:>119}ä", 7).is_err());
        assert_eq!(line.text().len(), 119);
        assert!(line.text().ends_with(" 7"));
    }
}
