//! A file as a list of words, with what has to be known of the space between them.

use crate::diagnostic::Diagnostics;
use crate::source::{FileId, Source};
use crate::syntax::lexer::Lexer;
use crate::syntax::token::{Keyword, Sign, TokenKind};

/// A token, a comment or a pragma.
#[derive(Clone, Copy, Debug)]
pub(super) struct Word<'a> {
    pub kind: TokenKind,
    /// As it is to be written: keywords in upper case.
    pub text: &'a str,
    /// The ends of lines between it and the word before.
    pub breaks: usize,
    /// The offset of its first byte in the source.
    pub start: usize,
}

impl Word<'_> {
    /// A comment or a pragma: it may stand anywhere.
    pub fn is_remark(&self) -> bool {
        matches!(self.kind, TokenKind::Comment | TokenKind::Pragma)
    }

    /// A comment that ends with its line.
    pub fn ends_line(&self) -> bool {
        self.kind == TokenKind::Comment && self.text.starts_with("//")
    }

    pub fn is_sign(&self, sign: Sign) -> bool {
        self.kind == TokenKind::Sign(sign)
    }

    pub fn keyword(&self) -> Option<Keyword> {
        match self.kind {
            TokenKind::Keyword(keyword) => Some(keyword),
            _ => None,
        }
    }

    /// Whether it says the same: white space does not count at the ends of a comment's lines.
    pub fn same_as(&self, other: &Self) -> bool {
        let lines = |text| str::lines(text).map(str::trim_ascii);
        self.kind == other.kind
            && match self.is_remark() {
                true => lines(self.text).eq(lines(other.text)),
                false => self.text == other.text,
            }
    }
}

/// All words of a file.
pub(super) fn cut<'a>(file: FileId, source: &'a Source) -> Vec<Word<'a>> {
    let text = source.text();
    let mut lexer = Lexer::new(file, source);
    // What is wrong with a word, the parser has told.
    let mut told = Diagnostics::new();
    let (mut words, mut end) = (Vec::new(), 0);
    loop {
        let token = lexer.next_token(&mut told);
        let (start, next) = (token.span.start as usize, token.span.end as usize);
        let between = text.get(end..start).unwrap_or("");
        let written = match token.kind {
            TokenKind::End => return words,
            TokenKind::Keyword(keyword) => keyword.text(),
            // Blanks before the end of a line are no part of what it says.
            TokenKind::Comment => text.get(start..next).unwrap_or("").trim_ascii_end(),
            _ => text.get(start..next).unwrap_or(""),
        };
        let breaks = between.bytes().filter(|byte| *byte == b'\n').count();
        words.push(Word { kind: token.kind, text: written, breaks, start });
        end = next;
    }
}
