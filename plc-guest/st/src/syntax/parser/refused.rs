//! What the standard has and this compiler has not: it is named and skipped whole, so that the rest
//! of the file is still checked.

use super::{Parser, Told};
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::token::{Keyword, TokenKind};

impl Parser<'_> {
    /// Tells that `what`, which begins at the current word, is not supported.
    pub(super) fn refuse(&mut self, what: &str) -> Told {
        let found = format!("{what}, which this compiler does not have");
        let one = Diagnostic::new(Code::NotSupported, self.current.span, found)
            .allowed("programs, functions and function blocks in Structured Text");
        self.tell(one)
    }

    /// If something with an end of its own begins here that is not supported, refuses and skips it.
    pub(super) fn refuse_block(&mut self) -> bool {
        let TokenKind::Keyword(keyword) = self.current.kind else { return false };
        let (what, end) = match keyword {
            Keyword::Method => ("METHOD", Keyword::EndMethod),
            Keyword::Property => ("PROPERTY", Keyword::EndProperty),
            Keyword::Class => ("CLASS", Keyword::EndClass),
            Keyword::Interface => ("INTERFACE", Keyword::EndInterface),
            Keyword::Action => ("ACTION", Keyword::EndAction),
            Keyword::Step | Keyword::InitialStep => ("Sequential Function Chart", Keyword::EndStep),
            Keyword::Transition => ("Sequential Function Chart", Keyword::EndTransition),
            Keyword::VarAccess => ("VAR_ACCESS", Keyword::EndVar),
            // It stands in a CONFIGURATION, where it is read before this.
            Keyword::VarConfig => ("VAR_CONFIG outside of a CONFIGURATION", Keyword::EndVar),
            _ => return false,
        };
        self.refuse(what);
        self.advance();
        self.skip_to(|kind| match kind {
            TokenKind::Keyword(keyword) => {
                keyword == end
                    || matches!(
                        keyword,
                        Keyword::Program
                            | Keyword::Function
                            | Keyword::FunctionBlock
                            | Keyword::Configuration
                            | Keyword::EndFunctionBlock
                            | Keyword::EndProgram
                            | Keyword::EndFunction
                            | Keyword::EndConfiguration
                    )
            }
            _ => false,
        });
        self.eat_keyword(end);
        true
    }

    /// Refuses the keywords of object orientation before and behind the name of a unit.
    pub(super) fn refuse_modifiers(&mut self) {
        loop {
            let what = match self.current.kind {
                TokenKind::Keyword(Keyword::Abstract) => "ABSTRACT",
                TokenKind::Keyword(Keyword::Final) => "FINAL",
                TokenKind::Keyword(Keyword::Extends) => "EXTENDS (inheritance)",
                TokenKind::Keyword(Keyword::Implements) => "IMPLEMENTS (interfaces)",
                TokenKind::Keyword(
                    Keyword::Public | Keyword::Private | Keyword::Protected | Keyword::Internal,
                ) => "an access specifier",
                _ => return,
            };
            let named = self.at_keyword(Keyword::Extends) || self.at_keyword(Keyword::Implements);
            self.refuse(what);
            self.advance();
            if named {
                // The names behind it, up to what can follow a head.
                self.skip_to(|kind| match kind {
                    TokenKind::Identifier => false,
                    TokenKind::Sign(sign) => sign == super::Sign::Semicolon,
                    _ => true,
                });
            }
        }
    }
}
