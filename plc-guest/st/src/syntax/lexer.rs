//! From text to words.
//!
//! The lexer never fails: what is no word becomes an error and a token that the parser does not see.
//! It gives all tokens, comments too, because the formatter wants them; [`Lexer::next_word`] leaves
//! out what has no meaning. It reads each byte a bounded number of times.

use std::collections::HashMap;
use std::sync::LazyLock;

use super::token::{Keyword, Sign, Token, TokenKind};
use crate::diagnostic::{Code, Diagnostic, Diagnostics};
use crate::source::{FileId, Source, Span};

static KEYWORDS: LazyLock<HashMap<&'static str, Keyword>> =
    LazyLock::new(|| Keyword::ALL.iter().map(|word| (word.text(), *word)).collect());

/// The longest keyword, END_FUNCTION_BLOCK and END_CONFIGURATION.
const LONGEST: usize = 18;

/// The longest name, so that messages, images and watch lists stay readable.
const LONGEST_NAME: usize = 255;

/// Reads a file word by word.
#[derive(Clone, Debug)]
pub struct Lexer<'a> {
    text: &'a str,
    file: FileId,
    at: usize,
}

impl<'a> Lexer<'a> {
    /// At the start of a file.
    #[must_use]
    pub fn new(file: FileId, source: &'a Source) -> Self {
        Self { text: source.text(), file, at: 0 }
    }

    /// The next word with a meaning; at the end of the file [`TokenKind::End`], again and again.
    pub fn next_word(&mut self, diagnostics: &mut Diagnostics) -> Token {
        loop {
            let token = self.next_token(diagnostics);
            match token.kind {
                TokenKind::Comment | TokenKind::Invalid => {}
                // One without an end has been told of.
                TokenKind::Pragma if !self.text[..self.at].ends_with('}') => {}
                TokenKind::Pragma => diagnostics.push(self.pragma(token)),
                _ => return token,
            }
        }
    }

    /// What is told of a pragma: it is ignored. A block in braces, as in C, must not be.
    fn pragma(&self, token: Token) -> Diagnostic {
        let text = self.text.get(token.span.start as usize..token.span.end as usize);
        if text.is_some_and(|text| text.contains(';')) {
            return Diagnostic::new(Code::Syntax, token.span, "statements in braces")
                .hint("a block has no braces: it ends with END_IF, END_FOR and so on");
        }
        Diagnostic::new(Code::PragmaIgnored, token.span, "this pragma is ignored")
            .hint("Takt has no pragmas; remove it or make it a comment")
    }

    /// The next token, comments and pragmas too.
    pub fn next_token(&mut self, diagnostics: &mut Diagnostics) -> Token {
        let blanks = self.rest().bytes().take_while(u8::is_ascii_whitespace).count();
        self.at += blanks;
        let start = self.at;
        let kind = self.scan(start, diagnostics);
        Token { kind, span: self.span(start) }
    }

    fn scan(&mut self, start: usize, diagnostics: &mut Diagnostics) -> TokenKind {
        let Some(first) = self.byte(0) else { return TokenKind::End };
        match first {
            b'A'..=b'Z' | b'a'..=b'z' | b'_' => self.word(start, diagnostics),
            b'0'..=b'9' => self.number(start, diagnostics),
            b'\'' | b'"' => self.string(first, start, diagnostics),
            b'%' => {
                self.at += 1;
                self.skip_while(|byte| byte.is_ascii_alphanumeric() || byte == b'_');
                while self.byte(0) == Some(b'.')
                    && self.byte(1).is_some_and(|byte| byte.is_ascii_digit())
                {
                    self.at += 1;
                    self.skip_while(|byte| byte.is_ascii_digit());
                }
                if self.byte(0) == Some(b'*') {
                    self.at += 1;
                }
                TokenKind::Address
            }
            b'{' => {
                let end = self.rest().find('}');
                self.until(end.map(|at| at + 1), "pragma", "}", start, diagnostics);
                TokenKind::Pragma
            }
            b'/' if self.byte(1) == Some(b'/') => {
                self.at += self.rest().find('\n').unwrap_or(self.rest().len());
                self.refuse_hidden_line(start, diagnostics);
                TokenKind::Comment
            }
            b'(' if self.byte(1) == Some(b'*') => self.comment(b"(*", b"*)", start, diagnostics),
            b'/' if self.byte(1) == Some(b'*') => self.comment(b"/*", b"*/", start, diagnostics),
            _ => self.sign(start, diagnostics),
        }
    }

    /// Refuses a carriage return within a comment that ends with its line. Editors show it as the end of the line, and
    /// what follows would be a part of the comment.
    fn refuse_hidden_line(&self, start: usize, diagnostics: &mut Diagnostics) {
        let comment = &self.text[start..self.at];
        let comment = comment.strip_suffix('\r').unwrap_or(comment);
        if let Some(at) = comment.find('\r') {
            let found = "a carriage return alone in a comment, which does not end its line";
            let span = Span { start: (start + at) as u32, ..self.span(start) };
            diagnostics.push(
                Diagnostic::new(Code::InvalidCharacter, span, found)
                    .hint("end the line with LF, or with CR LF"),
            );
        }
    }

    fn word(&mut self, start: usize, diagnostics: &mut Diagnostics) -> TokenKind {
        self.skip_while(is_name_byte);
        let word = &self.text[start..self.at];
        if word.len() > LONGEST_NAME {
            let found = format!("a name of {} characters", word.len());
            let allowed = format!("at most {LONGEST_NAME}");
            diagnostics
                .push(Diagnostic::new(Code::Syntax, self.span(start), found).allowed(allowed));
            return TokenKind::Invalid;
        }
        if self.byte(0) == Some(b'#') {
            return self.prefixed(start);
        }
        if word.contains("__") {
            diagnostics.push(
                Diagnostic::new(
                    Code::ReservedName,
                    self.span(start),
                    format!("`{word}` has two underscores in a row"),
                )
                .allowed("names with single underscores (IEC 61131-3, 6.1.2)"),
            );
        }
        match keyword(word) {
            // `test` is too good a name to be taken from programs: it is a keyword before a string only, where no
            // name can stand.
            Some(Keyword::Test) if !self.string_follows() => TokenKind::Identifier,
            Some(keyword) => TokenKind::Keyword(keyword),
            None => TokenKind::Identifier,
        }
    }

    fn string_follows(&self) -> bool {
        let behind = self.text.get(self.at..).unwrap_or("").trim_ascii_start();
        behind.starts_with(['\'', '"'])
    }

    /// A name with `#`: the start of a literal of time, else a prefix alone.
    fn prefixed(&mut self, start: usize) -> TokenKind {
        let prefix = self.text[start..self.at].to_ascii_uppercase();
        self.at += 1;
        match prefix.as_str() {
            "T" | "TIME" | "LT" | "LTIME" => {
                if matches!(self.byte(0), Some(b'-' | b'+')) {
                    self.at += 1;
                }
                self.literal_body(b"");
                TokenKind::Duration
            }
            "D" | "DATE" | "LD" | "LDATE" => {
                self.literal_body(b"-");
                TokenKind::Date
            }
            "TOD" | "TIME_OF_DAY" | "LTOD" | "LTIME_OF_DAY" => {
                self.literal_body(b":");
                TokenKind::TimeOfDay
            }
            "DT" | "DATE_AND_TIME" | "LDT" | "LDATE_AND_TIME" => {
                self.literal_body(b"-:");
                TokenKind::DateAndTime
            }
            _ => TokenKind::TypePrefix,
        }
    }

    /// Letters, digits and underscores; points and `separators` only before a digit.
    fn literal_body(&mut self, separators: &[u8]) {
        while let Some(byte) = self.byte(0) {
            let joins = byte == b'.' || separators.contains(&byte);
            let digit_next = self.byte(1).is_some_and(|next| next.is_ascii_digit());
            if !(is_name_byte(byte) || joins && digit_next) {
                return;
            }
            self.at += 1;
        }
    }

    fn number(&mut self, start: usize, diagnostics: &mut Diagnostics) -> TokenKind {
        let digits = |byte: u8| byte.is_ascii_digit() || byte == b'_';
        self.skip_while(digits);
        if self.byte(0) == Some(b'#') {
            self.at += 1;
            self.skip_while(is_name_byte);
            return TokenKind::BasedInteger;
        }
        let mut kind = TokenKind::Integer;
        if self.byte(0) == Some(b'.') && self.byte(1).is_some_and(|byte| byte.is_ascii_digit()) {
            self.at += 1;
            self.skip_while(digits);
            kind = TokenKind::Real;
        }
        let signed = matches!(self.byte(1), Some(b'+' | b'-'));
        let exponent = matches!(self.byte(0), Some(b'e' | b'E'))
            && self.byte(1 + usize::from(signed)).is_some_and(|byte| byte.is_ascii_digit());
        if exponent {
            self.at += 1 + usize::from(signed);
            self.skip_while(digits);
            if kind == TokenKind::Integer {
                let text = &self.text[start..self.at];
                let (mantissa, power) = text.split_at(text.find(['e', 'E']).unwrap_or(text.len()));
                diagnostics.push(
                    Diagnostic::new(
                        Code::InvalidLiteral,
                        self.span(start),
                        format!("`{text}` has an exponent and no point"),
                    )
                    .hint(format!("write `{mantissa}.0{power}`")),
                );
                return TokenKind::Real;
            }
        }
        if self.byte(0).is_some_and(is_name_byte) {
            self.skip_while(is_name_byte);
            diagnostics.push(
                Diagnostic::new(
                    Code::InvalidLiteral,
                    self.span(start),
                    format!("`{}` is neither a number nor a name", self.shown(start)),
                )
                .allowed(
                    "a number such as `12`, `16#FF`, `1.5`, or a name that starts with a letter",
                ),
            );
        }
        kind
    }

    fn string(&mut self, quote: u8, start: usize, diagnostics: &mut Diagnostics) -> TokenKind {
        self.at += 1;
        loop {
            match self.byte(0) {
                Some(b'$') if self.byte(1).is_some_and(|byte| byte.is_ascii_graphic()) => {
                    self.at += 2;
                }
                Some(byte) if byte == quote => {
                    self.at += 1;
                    break;
                }
                None | Some(b'\n' | b'\r') => {
                    let found = "a string that does not end on its line";
                    diagnostics.push(
                        Diagnostic::new(Code::Unterminated, self.span(start), found)
                            .allowed(format!("`{}` at its end", char::from(quote)))
                            .hint("write `$N` for an end of line within a string"),
                    );
                    break;
                }
                // Quotes and `$` are ASCII: they are never a part of another character.
                Some(_) => self.at += 1,
            }
        }
        if quote == b'"' { TokenKind::WideString } else { TokenKind::String }
    }

    /// Comments of one form nest within themselves (IEC 61131-3, 6.1.5).
    fn comment(
        &mut self,
        open: &[u8],
        close: &[u8],
        start: usize,
        diagnostics: &mut Diagnostics,
    ) -> TokenKind {
        let mut depth = 0_u32;
        loop {
            let rest = &self.text.as_bytes()[self.at..];
            if rest.starts_with(open) {
                depth += 1;
                self.at += 2;
            } else if rest.starts_with(close) {
                depth -= 1;
                self.at += 2;
                if depth == 0 {
                    return TokenKind::Comment;
                }
            } else if rest.is_empty() {
                let close = String::from_utf8_lossy(close);
                let found = match depth {
                    1 => "a comment that does not end".to_owned(),
                    _ => format!("a comment that does not end: {depth} `{close}` are missing"),
                };
                let span = Span { end: start as u32 + 2, ..self.span(start) };
                diagnostics.push(
                    Diagnostic::new(Code::Unterminated, span, found)
                        .hint(format!("comments nest: each one needs its own `{close}`")),
                );
                return TokenKind::Comment;
            } else {
                self.at += 1;
            }
        }
    }

    fn sign(&mut self, start: usize, diagnostics: &mut Diagnostics) -> TokenKind {
        let rest = self.rest();
        // The longest first: the list has those of two characters before their beginnings.
        let two =
            Sign::ALL.iter().find(|sign| sign.text().len() == 2 && rest.starts_with(sign.text()));
        let one =
            Sign::ALL.iter().find(|sign| sign.text().len() == 1 && rest.starts_with(sign.text()));
        if let Some(sign) = two.or(one) {
            self.at += sign.text().len();
            return TokenKind::Sign(*sign);
        }
        if let Some(kind) = self.sign_of_c(start, diagnostics) {
            return kind;
        }
        // All that follow count as one error: a binary file would have thousands.
        let strange = |c: &char| !c.is_ascii() || c.is_ascii_control() || "!@\\`~$?|".contains(*c);
        let blank = |c: &char| c.is_ascii_whitespace();
        let strangers: Vec<char> =
            rest.chars().take_while(|c| strange(c) && !blank(c)).take(1 << 16).collect();
        self.at += strangers.iter().map(|c| c.len_utf8()).sum::<usize>().max(1);
        let first = strangers.first().copied().unwrap_or('?');
        let found = if first.is_control() {
            format!("the control character U+{:04X}", u32::from(first))
        } else {
            format!("the character `{first}`")
        };
        let mut one = Diagnostic::new(Code::InvalidCharacter, self.span(start), found)
            .allowed("letters, digits, `_` and the signs of Structured Text");
        if first == '!' || first == '|' {
            one = one.hint("write `NOT`, `<>` or `OR`");
        } else if first.is_alphabetic() {
            one = one
                .hint("names have the letters A to Z only; comments and strings may have others");
        }
        diagnostics.push(one);
        TokenKind::Invalid
    }

    /// `!=`, `||` and `!`, which are read as what is meant, so that nothing behind them is told of.
    fn sign_of_c(&mut self, start: usize, diagnostics: &mut Diagnostics) -> Option<TokenKind> {
        let (text, write, kind) = match self.rest().as_bytes() {
            [b'!', b'=', ..] => ("!=", "<>", TokenKind::Sign(Sign::NotEqual)),
            [b'|', b'|', ..] => ("||", "OR", TokenKind::Keyword(Keyword::Or)),
            [b'!', next, ..] if is_name_byte(*next) || *next == b'(' => {
                ("!", "NOT", TokenKind::Keyword(Keyword::Not))
            }
            _ => return None,
        };
        self.at += text.len();
        let found = format!("`{text}` is no sign of Structured Text");
        let one = Diagnostic::new(Code::InvalidCharacter, self.span(start), found);
        diagnostics.push(one.hint(format!("write `{write}`")));
        Some(kind)
    }

    fn until(
        &mut self,
        end: Option<usize>,
        what: &str,
        close: &str,
        start: usize,
        diagnostics: &mut Diagnostics,
    ) {
        let Some(length) = end else {
            self.at = self.text.len();
            let span = Span { end: start as u32 + 1, ..self.span(start) };
            diagnostics.push(
                Diagnostic::new(Code::Unterminated, span, format!("a {what} that does not end"))
                    .allowed(format!("`{close}` at its end")),
            );
            return;
        };
        self.at += length;
    }

    /// The text from `start`, cut so that it fits into a message.
    fn shown(&self, start: usize) -> &'a str {
        &self.text[start..self.at.min(start + 40)]
    }

    fn skip_while(&mut self, wanted: impl Fn(u8) -> bool) {
        while self.byte(0).is_some_and(&wanted) {
            self.at += 1;
        }
    }

    fn rest(&self) -> &'a str {
        self.text.get(self.at..).unwrap_or("")
    }

    fn byte(&self, ahead: usize) -> Option<u8> {
        self.text.as_bytes().get(self.at + ahead).copied()
    }

    fn span(&self, start: usize) -> Span {
        Span { file: self.file, start: start as u32, end: self.at as u32 }
    }
}

fn is_name_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}

/// The keyword that a word is, whatever its case.
#[must_use]
pub fn keyword(word: &str) -> Option<Keyword> {
    let mut buffer = [0; LONGEST];
    let upper = buffer.get_mut(..word.len())?;
    upper.copy_from_slice(word.as_bytes());
    upper.make_ascii_uppercase();
    KEYWORDS.get(std::str::from_utf8(upper).ok()?).copied()
}

#[cfg(test)]
#[path = "lexer_tests.rs"]
mod tests;
