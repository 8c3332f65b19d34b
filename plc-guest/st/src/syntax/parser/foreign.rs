//! What other languages and other tools write otherwise: it is named, with what to write, and read as what is meant
//! where that is clear. So one mistake is one message.

use super::{Parse, Parser};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::{Expression, ExpressionKind, Variables};
use crate::syntax::token::{Keyword, Sign, TokenKind};

impl Parser<'_> {
    /// An operator behind a value that is none: `%` of C, IN of Pascal. Of what it would have made no more is told.
    pub(super) fn foreign_operator(&mut self, left: &mut Expression) -> Parse<()> {
        let span = self.current.span;
        let text = self.text(span);
        match self.current.kind {
            // An address cannot stand behind a value, so this is no beginning of one.
            TokenKind::Address if text.bytes().skip(1).all(|c| c.is_ascii_digit()) => {
                let sign = Span { end: span.start + 1, ..span };
                let one = Diagnostic::new(Code::Syntax, sign, "`%` is no operator");
                self.tell(one.hint("the remainder of a division is written `MOD`"));
                if sign == span {
                    self.current.kind = TokenKind::Keyword(Keyword::Mod);
                    return Ok(());
                }
                self.advance();
            }
            TokenKind::Identifier
                if text.eq_ignore_ascii_case("IN")
                    && self.peek(1) == TokenKind::Sign(Sign::OpenParenthesis) =>
            {
                let value = self.text(left.span);
                let one = Diagnostic::new(Code::Syntax, span, "`IN` is no operator");
                let hint = format!("compare with each: `({value} = 3) OR ({value} = 4)`");
                self.tell(one.hint(hint));
                self.advance();
                self.advance();
                self.deeper(Self::expressions)?;
                self.expect_sign(Sign::CloseParenthesis)?;
            }
            _ => return Ok(()),
        }
        *left = Expression::new(ExpressionKind::Error, left.span.to(self.previous));
        Ok(())
    }

    /// A sign of C that begins with one of Structured Text, which was taken already: `==`, `&&`, `+=`, `++`.
    pub(super) fn foreign_sign(&mut self, left: &Expression, place: Span) -> Parse<()> {
        let TokenKind::Sign(second) = self.current.kind else { return Ok(()) };
        if self.current.span.start != place.end {
            return Ok(());
        }
        let (first, value) = (self.text(place), self.text(left.span));
        let (hint, meant) = match (first, second) {
            ("=", Sign::Equal) => ("`=` compares; `:=` assigns".to_owned(), true),
            ("=", Sign::Colon) => ("an assignment is written `:=`".to_owned(), false),
            ("&", Sign::Ampersand) => ("write `AND` or `&`".to_owned(), true),
            ("+" | "-" | "*" | "/", Sign::Equal) => {
                (format!("write `{value} := {value} {first} ...`"), false)
            }
            ("+", Sign::Plus) | ("-", Sign::Minus)
                if self.peek(1) == TokenKind::Sign(Sign::Semicolon) =>
            {
                (format!("write `{value} := {value} {first} 1`"), false)
            }
            _ => return Ok(()),
        };
        let found = format!("`{first}{}` is no sign of Structured Text", second.text());
        let told =
            self.tell(Diagnostic::new(Code::Syntax, place.to(self.current.span), found).hint(hint));
        if !meant {
            return Err(told);
        }
        self.advance();
        Ok(())
    }

    /// Tells of a number with a decimal comma, which the current comma is, and takes it.
    pub(super) fn decimal_comma(&mut self) {
        let (before, comma) = (self.previous, self.current.span);
        let digits = |span: Span| self.text(span).bytes().all(|c| c.is_ascii_digit() || c == b'_');
        if !self.at_sign(Sign::Comma)
            || comma.start != before.end
            || !digits(before)
            || self.peek(1) != TokenKind::Integer
        {
            return;
        }
        let number = self.text(before);
        self.advance();
        let whole = before.to(self.current.span);
        let found = format!("`{}` has a decimal comma", self.text(whole));
        let hint = format!("write `{number}.{}`", self.text(self.current.span));
        self.diagnostics.push(Diagnostic::new(Code::InvalidLiteral, whole, found).hint(hint));
        self.advance();
    }

    /// A section of variables of other tools: told of and read as VAR.
    pub(super) fn foreign_section(&mut self) -> bool {
        let text = self.text(self.current.span);
        let hint = match () {
            () if self.current.kind != TokenKind::Identifier => return false,
            () if text.eq_ignore_ascii_case("VAR_STAT") => {
                "VAR of a function block keeps its values; what all instances share is in VAR_GLOBAL"
            }
            () if text.eq_ignore_ascii_case("VAR_INST") => {
                "it is of methods; VAR of a function block keeps its values"
            }
            () => return false,
        };
        let section = [Keyword::EndVar, Keyword::Constant, Keyword::Retain, Keyword::Persistent];
        let next = self.peek(1);
        if next != TokenKind::Identifier
            && !section.iter().any(|word| next == TokenKind::Keyword(*word))
        {
            return false;
        }
        let found = format!("{}, which this compiler does not have", text.to_ascii_uppercase());
        let one = Diagnostic::new(Code::NotSupported, self.current.span, found)
            .allowed("VAR, VAR_INPUT, VAR_OUTPUT, VAR_IN_OUT, VAR_TEMP, VAR_EXTERNAL, VAR_GLOBAL");
        self.tell(one.hint(hint));
        self.current.kind = TokenKind::Keyword(Keyword::Var);
        true
    }

    /// The fields of a UNION, which is told of and read as a structure, so that their names are known.
    pub(super) fn union(&mut self) -> Vec<Variables> {
        let one = Diagnostic::new(
            Code::NotSupported,
            self.current.span,
            "UNION, which this compiler does not have",
        );
        self.tell(one.allowed("STRUCT").hint(
            "parts of a bit string are `w.%B0`; conversions such as `DWORD_TO_REAL` keep the bits",
        ));
        self.advance();
        let mut fields = Vec::new();
        loop {
            while self.eat_sign(Sign::Semicolon).is_some() {}
            if self.current.kind != TokenKind::Identifier {
                return fields;
            }
            if self.text(self.current.span).eq_ignore_ascii_case("END_UNION") {
                self.advance();
                // The semicolon may be missing, as behind END_STRUCT.
                if !self.at_sign(Sign::Semicolon) {
                    self.last_error = Some(self.current.span.start);
                }
                return fields;
            }
            let start = self.current.span;
            match self.field() {
                Ok(field) => fields.push(field),
                Err(super::Told) => {
                    if self.current.span == start {
                        self.advance();
                    }
                    self.skip_to(|kind| {
                        matches!(kind, TokenKind::Sign(Sign::Semicolon) | TokenKind::Keyword(_))
                    });
                }
            }
        }
    }

    /// EXTENDS of a structure, with the name behind it.
    pub(super) fn refuse_extended_structure(&mut self) {
        if !self.at_keyword(Keyword::Extends) {
            return;
        }
        let one = Diagnostic::new(
            Code::NotSupported,
            self.current.span,
            "EXTENDS of a structure, which this compiler does not have",
        );
        self.tell(one.allowed("STRUCT").hint("give it a field of the other structure's type"));
        self.advance();
        if self.current.kind == TokenKind::Identifier {
            self.advance();
        }
    }
}
