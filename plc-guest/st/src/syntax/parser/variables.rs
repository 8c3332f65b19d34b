//! Sections of variables, and the fields of structures, which have the same form.

use super::unit::{begins_declaration, section_kind};
use super::{Parse, Parser, Told};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::{Edge, Retention, Section, Variables};
use crate::syntax::token::{Keyword, Sign, TokenKind};

impl Parser<'_> {
    /// `VAR ... END_VAR`. None if it is of a kind that was refused.
    pub(super) fn section(&mut self) -> Parse<Option<Section>> {
        if self.refuse_block() {
            return Ok(None);
        }
        let TokenKind::Keyword(keyword) = self.current.kind else {
            return Err(self.unexpected("a section of variables"));
        };
        let Some(kind) = section_kind(keyword) else {
            return Err(self.unexpected("a section of variables"));
        };
        let open = self.advance();
        let mut section =
            Section { kind, constant: None, retention: None, variables: Vec::new(), span: open };
        self.qualifiers(&mut section);
        self.variables(&mut section.variables);
        // Without it, what follows is read all the same.
        let _ = self.close(Keyword::EndVar, open);
        self.eat_sign(Sign::Semicolon);
        Ok(Some(section))
    }

    fn qualifiers(&mut self, section: &mut Section) {
        loop {
            let span = self.current.span;
            let retention = match self.current.kind {
                TokenKind::Keyword(Keyword::Constant) => {
                    section.constant = Some(span);
                    self.advance();
                    continue;
                }
                TokenKind::Keyword(Keyword::Retain) => Retention::Retain,
                TokenKind::Keyword(Keyword::NonRetain) => Retention::NonRetain,
                TokenKind::Keyword(Keyword::Persistent) => Retention::Persistent,
                TokenKind::Keyword(
                    Keyword::Public | Keyword::Private | Keyword::Protected | Keyword::Internal,
                ) => {
                    self.refuse("an access specifier");
                    self.advance();
                    continue;
                }
                _ => return,
            };
            match (section.retention, retention) {
                // PERSISTENT keeps over more than RETAIN: both together are PERSISTENT.
                (None, _) | (Some((Retention::Retain, _)), Retention::Persistent) => {
                    section.retention = Some((retention, span));
                }
                (Some((Retention::Persistent, _)), Retention::Retain) => {}
                (Some((_, first)), _) => {
                    let found = format!("`{}` with another of its kind", self.text(span));
                    let one = Diagnostic::new(Code::Syntax, span, found)
                        .allowed("one of RETAIN, NON_RETAIN and PERSISTENT")
                        .related(first, "the first is here");
                    self.tell(one);
                }
            }
            self.advance();
        }
    }

    /// Declarations up to the closing keyword.
    pub(super) fn variables(&mut self, into: &mut Vec<Variables>) {
        loop {
            while self.eat_sign(Sign::Semicolon).is_some() {}
            let start = self.current.span;
            match self.current.kind {
                // A statement: the closing keyword is missing.
                TokenKind::Identifier if self.peek(1) == TokenKind::Sign(Sign::Assign) => return,
                TokenKind::Identifier | TokenKind::Keyword(Keyword::At) => {}
                TokenKind::End => return,
                TokenKind::Keyword(keyword)
                    if ends_variables(keyword) && self.peek(1) != TokenKind::Sign(Sign::Colon) =>
                {
                    return;
                }
                _ => {}
            }
            match self.deeper(Self::declared) {
                Ok(variables) => into.push(variables),
                Err(Told) => {
                    if self.current.span == start {
                        self.advance();
                    }
                    self.skip_to(|kind| match kind {
                        TokenKind::Sign(Sign::Semicolon) => true,
                        TokenKind::Keyword(keyword) => ends_variables(keyword),
                        _ => false,
                    });
                }
            }
        }
    }

    /// One declaration of a structure's fields.
    pub(super) fn field(&mut self) -> Parse<Variables> {
        self.deeper(Self::declared)
    }

    fn declared(&mut self) -> Parse<Variables> {
        let start = self.current.span;
        let mut names = Vec::new();
        let named = |next| {
            let begins = [Sign::Colon, Sign::Comma].map(TokenKind::Sign);
            begins.contains(&next) || next == TokenKind::Keyword(Keyword::At)
        };
        // Without a name there is an address. But AT itself may have been meant as a name.
        if !self.at_keyword(Keyword::At) || named(self.peek(1)) {
            names.push(self.name("the name of a variable")?);
            while self.eat_sign(Sign::Comma).is_some() {
                names.push(self.name("the name of a variable")?);
            }
        }
        let mut address = None;
        if self.eat_keyword(Keyword::At).is_some() {
            if self.current.kind != TokenKind::Address {
                return Err(self.unexpected("an address such as `%IX0.0` or `%Q*`"));
            }
            // With a wrong address it is still a variable.
            address = self.address().ok();
            if let [_, second, ..] = &names[..] {
                let one = Diagnostic::new(
                    Code::InvalidDeclaration,
                    second.span,
                    "several variables at one address",
                )
                .allowed("one name for each AT");
                self.diagnostics.push(one);
            }
        }
        if self.at_sign(Sign::Assign) {
            let one = Diagnostic::new(
                Code::Syntax,
                self.current.span,
                "an initial value before the type",
            )
            .allowed("`name : TYPE := value;`");
            return Err(self.tell(one));
        }
        self.expect_sign(Sign::Colon)?;
        let spec = self.type_spec()?;
        let edge = self.edge();
        let initial = match self.eat_sign(Sign::Assign) {
            Some(_) => Some(self.initial()?),
            None => None,
        };
        if initial.is_some() {
            self.decimal_comma();
        }
        let span = start.to(self.previous);
        if self.at_sign(Sign::OpenParenthesis) {
            let one = Diagnostic::new(
                Code::Syntax,
                self.current.span,
                "arguments behind the type of a variable",
            )
            .hint("initial values of a function block are written `: TYPE := (name := value)`");
            return Err(self.tell(one));
        }
        self.end_of_declaration()?;
        Ok(Variables { names, address, spec, edge, initial, span })
    }

    fn edge(&mut self) -> Option<(Edge, Span)> {
        let edge = match self.current.kind {
            TokenKind::Keyword(Keyword::RisingEdge) => Edge::Rising,
            TokenKind::Keyword(Keyword::FallingEdge) => Edge::Falling,
            _ => return None,
        };
        Some((edge, self.advance()))
    }

    /// The semicolon. Where it is missing before the next declaration, that one is read all the same.
    pub(super) fn end_of_declaration(&mut self) -> Parse<()> {
        if self.eat_sign(Sign::Semicolon).is_some() {
            return Ok(());
        }
        // As many tools do, END_STRUCT may stand without one.
        if self.text(self.previous).eq_ignore_ascii_case(Keyword::EndStruct.text()) {
            return Ok(());
        }
        let told = self.missing(";");
        match self.current.kind {
            TokenKind::Identifier => Ok(()),
            TokenKind::Keyword(keyword) if ends_variables(keyword) => Ok(()),
            _ => Err(told),
        }
    }
}

/// Whether a list of variables ends before it.
fn ends_variables(keyword: Keyword) -> bool {
    use Keyword::*;
    section_kind(keyword).is_some()
        || begins_declaration(TokenKind::Keyword(keyword))
        || matches!(
            keyword,
            EndVar
                | EndStruct
                | EndType
                | EndProgram
                | EndFunction
                | EndFunctionBlock
                | EndConfiguration
                | EndResource
                | If
                | Case
                | For
                | While
                | Repeat
                | Return
        )
}
