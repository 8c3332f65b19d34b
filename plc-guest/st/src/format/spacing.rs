//! What stands between two words of one line: a blank or nothing.

use super::words::Word;
use crate::syntax::token::{Keyword, Sign, TokenKind};

/// The word before, and what its neighbours make of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Before {
    pub kind: TokenKind,
    /// A sign of a number, or an operator that is used as the name of a function.
    pub prefix: bool,
}

/// What a word is a part of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Context {
    /// A label of CASE or its ELSE.
    pub label: bool,
    /// A type or the head of a declaration: there, `(` begins no call.
    pub declaration: bool,
}

/// Whether there is a blank between `before` and `word`. Comments do not come here.
pub(super) fn blank(before: Before, word: &Word<'_>, context: Context) -> bool {
    use Sign::*;
    let after_value = ends_value(before.kind);
    match word.kind {
        // With nothing between, `w.3 .5` would be read as `3.5`.
        TokenKind::Sign(Dot) => before.kind == TokenKind::Integer,
        // The only statement of a branch may be empty: `1: ;`.
        TokenKind::Sign(Semicolon) => before.kind == TokenKind::Sign(Colon),
        TokenKind::Sign(Comma | CloseParenthesis | CloseBracket | Caret | Range) => false,
        TokenKind::Sign(Colon) => !context.label,
        TokenKind::Sign(OpenParenthesis) if after_value => context.declaration,
        TokenKind::Sign(OpenBracket) if after_value => false,
        TokenKind::Sign(OpenBracket) => {
            before.kind != TokenKind::Keyword(Keyword::Array) && !joins(before)
        }
        _ => !joins(before),
    }
}

/// Whether what follows belongs to it without a blank.
fn joins(before: Before) -> bool {
    use Sign::*;
    before.prefix
        || matches!(
            before.kind,
            TokenKind::TypePrefix | TokenKind::Sign(OpenParenthesis | OpenBracket | Dot | Range)
        )
}

/// Whether `word` stands where a value begins and is a sign of it or the name of a function.
pub(super) fn is_prefix(before: Option<Before>, word: &Word<'_>, next: Option<&Word<'_>>) -> bool {
    if before.is_some_and(|before| ends_value(before.kind)) {
        return false;
    }
    match word.kind {
        TokenKind::Sign(Sign::Minus | Sign::Plus) => true,
        TokenKind::Keyword(Keyword::And | Keyword::Or | Keyword::Xor | Keyword::Mod) => {
            next.is_some_and(|next| next.is_sign(Sign::OpenParenthesis))
        }
        _ => false,
    }
}

/// Whether a value may end with it, so that what follows is an operator.
fn ends_value(kind: TokenKind) -> bool {
    use TokenKind as K;
    matches!(
        kind,
        K::Identifier
            | K::Integer
            | K::BasedInteger
            | K::Real
            | K::Duration
            | K::Date
            | K::TimeOfDay
            | K::DateAndTime
            | K::String
            | K::WideString
            | K::Address
            | K::Keyword(Keyword::True | Keyword::False | Keyword::Null)
            | K::Sign(Sign::CloseParenthesis | Sign::CloseBracket | Sign::Caret)
    )
}
