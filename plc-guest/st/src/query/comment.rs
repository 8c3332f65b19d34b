//! The comments that describe a declaration: those right before it, and those behind it in its line.

use super::Symbol;
use crate::diagnostic::Diagnostics;
use crate::source::{Sources, Span};
use crate::syntax::lexer::Lexer;
use crate::syntax::token::TokenKind;

/// The text of the comments of a declaration, without their marks.
#[must_use]
pub fn of(sources: &Sources, symbol: &Symbol) -> Option<String> {
    let comments = all(sources, symbol.extent);
    let before = comments.partition_point(|span| span.start < symbol.extent.start);
    let (before, behind) = comments.split_at(before);
    let mut lines = Vec::new();
    let mut at = symbol.extent.start;
    for span in before.iter().rev() {
        if !touches(sources, *span, at) {
            break;
        }
        lines.splice(0..0, content(sources.text(*span)));
        at = span.start;
    }
    let behind = behind.iter().find(|span| span.start >= symbol.extent.end);
    if let Some(span) = behind.filter(|span| ends_line(sources, symbol.extent, **span)) {
        lines.extend(content(sources.text(*span)));
    }
    let text = lines.join("\n").trim().to_owned();
    (!text.is_empty()).then_some(text)
}

/// The comments of the file that a declaration is in.
fn all(sources: &Sources, extent: Span) -> Vec<Span> {
    let mut unseen = Diagnostics::new();
    let mut lexer = Lexer::new(extent.file, sources.get(extent.file));
    let mut comments = Vec::new();
    loop {
        let token = lexer.next_token(&mut unseen);
        match token.kind {
            TokenKind::End => return comments,
            TokenKind::Comment => comments.push(token.span),
            _ => {}
        }
    }
}

/// Whether a comment has its lines for itself, and what begins at `at` follows without a blank line.
fn touches(sources: &Sources, comment: Span, at: u32) -> bool {
    let text = sources.get(comment.file).text();
    let line = text[..comment.start as usize].rsplit('\n').next().unwrap_or("");
    let between = text.get(comment.end as usize..at as usize).unwrap_or("x");
    line.trim().is_empty() && between.trim().is_empty() && between.matches('\n').count() <= 1
}

/// Whether only the end of a declaration stands between it and a comment in its line.
fn ends_line(sources: &Sources, extent: Span, comment: Span) -> bool {
    let text = sources.get(extent.file).text();
    let between = text.get(extent.end as usize..comment.start as usize).unwrap_or("x");
    between.chars().all(|c| matches!(c, ' ' | '\t' | ';' | ','))
}

/// The lines of a comment.
fn content(comment: &str) -> Vec<String> {
    let inner = match comment.strip_prefix("//") {
        Some(inner) => inner.trim_start_matches('/'),
        None => {
            let inner = comment.trim_start_matches("(*").trim_start_matches("/*");
            inner.trim_end_matches("*)").trim_end_matches("*/")
        }
    };
    inner.lines().map(|line| line.trim().trim_start_matches("* ").to_owned()).collect()
}
