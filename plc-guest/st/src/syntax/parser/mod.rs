//! From words to a tree, by recursive descent.
//!
//! An error unwinds (as `Err(Told)`) to the next place where parsing can go on: the end of a
//! statement, of a declaration, of a section or of a unit. What could not be understood is left out of
//! the tree or is an `Error` node. A token is told of at most once, so one mistake is one message.
//!
//! The parser looks at each token a bounded number of times, and goes no deeper than
//! [`limits::DEPTH`]: no text makes it exhaust the stack or take more than linear time.

mod address;
mod configuration;
mod expression;
mod foreign;
mod initial;
mod refused;
mod statement;
mod types;
mod unit;
mod variables;

use super::ast::{File, Name};
use super::lexer::Lexer;
use super::token::{Keyword, Sign, Token, TokenKind};
use crate::diagnostic::{Code, Diagnostic, Diagnostics};
use crate::limits;
use crate::source::{FileId, Source, Sources, Span};

/// The tree of one file. What is wrong in it goes to `diagnostics`.
#[must_use]
pub fn parse(file: FileId, sources: &Sources, diagnostics: &mut Diagnostics) -> File {
    let mut parser = Parser::new(file, sources.get(file), diagnostics);
    parser.file()
}

/// That something was told of and parsing goes on elsewhere.
#[derive(Clone, Copy, Debug)]
struct Told;

type Parse<T> = Result<T, Told>;

struct Parser<'a> {
    source: &'a Source,
    lexer: Lexer<'a>,
    diagnostics: &'a mut Diagnostics,
    /// The token that is looked at.
    current: Token,
    /// The place of the last one that was taken.
    previous: Span,
    /// How deep statements, types, initial values and expressions are within each other.
    depth: u32,
    /// The start of the token that an error was last told at.
    last_error: Option<u32>,
    /// Whether the statements that are read are a branch of CASE, where a name may be a label.
    case: bool,
    /// The last `ELSE IF`, which is often meant as ELSIF and then lacks an END_IF.
    else_if: Option<Span>,
}

impl<'a> Parser<'a> {
    fn new(file: FileId, source: &'a Source, diagnostics: &'a mut Diagnostics) -> Self {
        let mut lexer = Lexer::new(file, source);
        let current = lexer.next_word(diagnostics);
        let previous = Span { file, start: 0, end: 0 };
        Self {
            source,
            lexer,
            diagnostics,
            current,
            previous,
            depth: 0,
            last_error: None,
            case: false,
            else_if: None,
        }
    }

    /// Takes the current token.
    fn advance(&mut self) -> Span {
        let span = self.current.span;
        if self.current.kind != TokenKind::End {
            self.previous = span;
            let before = self.diagnostics.errors();
            self.current = self.lexer.next_word(self.diagnostics);
            if self.diagnostics.errors() > before {
                // The word, or something before it, is wrong in itself.
                self.last_error = Some(self.current.span.start);
            }
        }
        span
    }

    /// The kind of the word `ahead` words behind the current one, for the few places where one word
    /// does not decide.
    fn peek(&self, ahead: usize) -> TokenKind {
        let mut lexer = self.lexer.clone();
        // Its messages come when the words are reached.
        let mut unseen = Diagnostics::new();
        (0..ahead).fold(self.current.kind, |_, _| lexer.next_word(&mut unseen).kind)
    }

    fn text(&self, span: Span) -> &'a str {
        self.source.text().get(span.start as usize..span.end as usize).unwrap_or("")
    }

    fn at_keyword(&self, keyword: Keyword) -> bool {
        self.current.kind == TokenKind::Keyword(keyword)
    }

    fn at_sign(&self, sign: Sign) -> bool {
        self.current.kind == TokenKind::Sign(sign)
    }

    fn eat_keyword(&mut self, keyword: Keyword) -> Option<Span> {
        self.at_keyword(keyword).then(|| self.advance())
    }

    fn eat_sign(&mut self, sign: Sign) -> Option<Span> {
        self.at_sign(sign).then(|| self.advance())
    }

    fn expect_keyword(&mut self, keyword: Keyword) -> Parse<Span> {
        self.eat_keyword(keyword).ok_or_else(|| self.missing(keyword.text()))
    }

    fn expect_sign(&mut self, sign: Sign) -> Parse<Span> {
        self.eat_sign(sign).ok_or_else(|| self.missing(sign.text()))
    }

    fn name(&mut self, what: &str) -> Parse<Name> {
        if self.current.kind == TokenKind::Identifier {
            let span = self.advance();
            return Ok(Name::new(self.text(span), span));
        }
        if let TokenKind::Keyword(keyword) = self.current.kind {
            let found = format!("`{}` is a keyword and no name", keyword.text());
            return Err(self.tell(
                Diagnostic::new(Code::ReservedName, self.current.span, found)
                    .allowed(what.to_owned())
                    .hint("choose another name, such as this one with a suffix"),
            ));
        }
        Err(self.unexpected(what))
    }

    /// The closing keyword of what `open` opened.
    fn close(&mut self, keyword: Keyword, open: Span) -> Parse<Span> {
        if let Some(span) = self.eat_keyword(keyword) {
            return Ok(span);
        }
        let found = format!("`{}` is missing before {}", keyword.text(), self.shown());
        let note = format!("`{}` is here", self.text(open));
        let mut one = Diagnostic::new(Code::Syntax, self.current.span, found).related(open, note);
        if let TokenKind::Keyword(Keyword::Else | Keyword::Elsif) = self.current.kind {
            one = one.hint("ELSE and ELSIF belong to the innermost IF or CASE that is still open");
        }
        if let (Keyword::EndIf, Some(place)) = (keyword, self.else_if) {
            let note = "`ELSE IF` opens another IF, which needs an END_IF of its own";
            one = one.hint("if no IF within ELSE is meant, write `ELSIF`").related(place, note);
        }
        Err(self.tell(one))
    }

    /// How a message names the current token.
    fn shown(&self) -> String {
        match self.current.kind {
            TokenKind::End => "the end of the file".into(),
            TokenKind::String | TokenKind::WideString => "a string".into(),
            _ => {
                let text = self.text(self.current.span);
                let mut shown: String = text.chars().take(40).collect();
                if shown.len() < text.len() {
                    shown.push_str("...");
                }
                format!("`{shown}`")
            }
        }
    }

    /// Tells that the current token cannot stand here.
    fn unexpected(&mut self, allowed: &str) -> Told {
        let found = format!("{} cannot stand here", self.shown());
        self.tell(Diagnostic::new(Code::Syntax, self.current.span, found).allowed(allowed))
    }

    /// Tells that a sign or keyword is missing: at the end of the word before, where it belongs.
    fn missing(&mut self, what: &str) -> Told {
        let found = format!("`{what}` is missing before {}", self.shown());
        let at = Span { start: self.previous.end.saturating_sub(1), ..self.previous };
        self.tell(Diagnostic::new(Code::Syntax, at, found))
    }

    /// Tells of an error at the current token, unless there was one already.
    fn tell(&mut self, one: Diagnostic) -> Told {
        if self.last_error != Some(self.current.span.start) {
            self.last_error = Some(self.current.span.start);
            self.diagnostics.push(one);
        }
        Told
    }

    /// Goes one level deeper for `inner`.
    fn deeper<T>(&mut self, inner: impl FnOnce(&mut Self) -> Parse<T>) -> Parse<T> {
        if self.depth >= limits::DEPTH {
            let found = "expressions, statements or types are too deep within each other";
            let allowed = format!("at most {} levels", limits::DEPTH);
            self.tell(Diagnostic::new(Code::TooDeep, self.current.span, found).allowed(allowed));
            // Whatever closes these levels would be told of as well, one by one.
            self.skip_to(|_| false);
            self.last_error = Some(self.current.span.start);
            return Err(Told);
        }
        self.depth += 1;
        let result = inner(self);
        self.depth -= 1;
        result
    }

    /// Skips to a word for which `stop` holds, or to the end.
    fn skip_to(&mut self, stop: impl Fn(TokenKind) -> bool) {
        while self.current.kind != TokenKind::End && !stop(self.current.kind) {
            self.advance();
        }
    }
}

#[cfg(test)]
#[path = "parser_tests.rs"]
mod tests;
