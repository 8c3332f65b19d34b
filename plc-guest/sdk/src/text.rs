//! STRING of IEC 61131-3.

use core::fmt;
use core::str::Utf8Error;

/// A text of up to `N` characters of 8 bits, as points have it: `STRING[N]`, with a byte more that is 0.
///
/// `write!` appends to it.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Text<const N: usize> {
    characters: [u8; N],
    end: u8,
}

impl<const N: usize> Text<N> {
    /// Without characters.
    pub const EMPTY: Self = Self { characters: [0; N], end: 0 };

    /// This text.
    ///
    /// # Panics
    /// It has more than `N` bytes. In a constant that is an error of the compiler.
    #[must_use]
    pub const fn new(text: &str) -> Self {
        assert!(text.len() <= N, "the text is longer than its STRING");
        let (mut made, mut at) = (Self::EMPTY, 0);
        while at < text.len() {
            made.characters[at] = text.as_bytes()[at];
            at += 1;
        }
        made
    }

    /// With the 0 at its end, which a text from elsewhere may lack.
    pub(crate) const fn ended(self) -> Self {
        Self { end: 0, ..self }
    }

    /// The characters up to the first 0. They come from anywhere, so they need not be UTF-8.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        let length = self.characters.iter().position(|byte| *byte == 0).unwrap_or(N);
        &self.characters[..length]
    }

    /// The same as text.
    ///
    /// # Errors
    /// It is no UTF-8.
    pub fn as_str(&self) -> Result<&str, Utf8Error> {
        core::str::from_utf8(self.bytes())
    }
}

impl<const N: usize> fmt::Write for Text<N> {
    /// Appends. Of what is too long nothing is appended, and an error given.
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let length = self.bytes().len();
        let end = length.checked_add(text.len()).ok_or(fmt::Error)?;
        self.characters.get_mut(length..end).ok_or(fmt::Error)?.copy_from_slice(text.as_bytes());
        // What was behind the text before is not of it.
        self.characters[end..].fill(0);
        Ok(())
    }
}

impl<const N: usize> PartialEq for Text<N> {
    /// What is behind the end does not count.
    fn eq(&self, other: &Self) -> bool {
        self.bytes() == other.bytes()
    }
}

impl<const N: usize> Eq for Text<N> {}

impl<const N: usize> Default for Text<N> {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl<const N: usize> fmt::Debug for Text<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "\"{}\"", self.bytes().escape_ascii())
    }
}

#[cfg(test)]
mod tests {
    use core::fmt::Write;

    use super::*;

    #[test]
    fn a_text_ends_at_its_first_zero_and_is_never_longer_than_its_room() {
        const IDLE: Text<6> = Text::new("idle");
        assert_eq!(size_of::<Text<6>>(), 7);
        assert_eq!((IDLE.bytes(), IDLE.as_str()), (&b"idle"[..], Ok("idle")));
        let mut text = IDLE;
        assert_eq!(write!(text, "{}", 12), Ok(()));
        assert_eq!(text.as_str(), Ok("idle12"));
        assert_eq!(write!(text, "3"), Err(fmt::Error));
        assert_eq!(format!("{text:?}"), "\"idle12\"");
        text.characters[2] = 0;
        // What a shorter text has left behind.
        assert_eq!(text, Text::new("id"));
        assert_eq!(write!(text, "-"), Ok(()));
        assert_eq!(text.characters, *b"id-\0\0\0");
        text.characters[0] = 0xff;
        assert!(text.as_str().is_err());
        assert_eq!(Text::<0>::EMPTY.bytes(), b"");
    }

    #[test]
    #[should_panic(expected = "longer than its STRING")]
    fn a_text_that_does_not_fit_is_not_cut() {
        let _ = Text::<3>::new("four");
    }
}
