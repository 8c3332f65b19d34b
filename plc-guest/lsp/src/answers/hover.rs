//! What a name is: its declaration, and the comments beside it.

use lsp_types::{Hover, HoverContents, MarkupContent, MarkupKind};
use takt_st::check::known;
use takt_st::query::{comment, describe};
use takt_st::source::Span;

use crate::analysis::{Analysis, File};

/// The forms of a function that are shown.
const FORMS: usize = 6;

/// What is at a byte.
pub fn at(analysis: &Analysis, file: &File, offset: u32) -> Option<Hover> {
    let Analysis { sources, index, .. } = analysis;
    let Some(one) = index.at(file.id, offset) else { return standard(analysis, file, offset) };
    let symbol = index.symbol(one.symbol);
    let forms = match index.forms(one.symbol) {
        forms if symbol.library && forms.len() > 1 => &forms[..forms.len().min(FORMS)],
        _ => std::slice::from_ref(&one.symbol),
    };
    let shown = forms.iter().map(|id| describe::declaration(sources, index, *id));
    let shown: Vec<String> = shown.collect();
    let mut text = code(&shown.join("\n"));
    if let Some(about) = comment::of(sources, symbol) {
        text.push_str("\n\n");
        text.push_str(&plain(&about));
    }
    Some(hover(analysis, file, one.span, text))
}

/// A function that the compiler makes itself.
fn standard(analysis: &Analysis, file: &File, offset: u32) -> Option<Hover> {
    let text = analysis.sources.get(file.id).text();
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let (before, behind) = text.split_at_checked(offset as usize)?;
    let start = offset as usize - before.chars().rev().take_while(|c| is_part(*c)).count();
    let end = offset as usize + behind.chars().take_while(|c| is_part(*c)).count();
    let form = known::function(&text.get(start..end)?.to_ascii_uppercase())?;
    // The word may be a part of a comment or of a string: those have no call behind it.
    text.get(end..)?.trim_start().starts_with('(').then_some(())?;
    let span = Span { file: file.id, start: start as u32, end: end as u32 };
    Some(hover(analysis, file, span, code(&form)))
}

fn hover(analysis: &Analysis, file: &File, span: Span, value: String) -> Hover {
    Hover {
        contents: HoverContents::Markup(MarkupContent { kind: MarkupKind::Markdown, value }),
        range: Some(analysis.range(file, span)),
    }
}

fn code(text: &str) -> String {
    // A text cannot end the block: it has no line of three ticks, since lines of declarations are joined.
    format!("```structured-text\n{text}\n```")
}

/// A comment as Markdown that shows it as it is written.
fn plain(text: &str) -> String {
    let mut plain = String::new();
    for character in text.chars() {
        match character {
            '\\' | '`' | '*' | '_' | '[' | ']' | '<' | '>' | '#' | '|' | '!' | '~' => {
                plain.push('\\');
                plain.push(character);
            }
            // Two blanks before the end of a line keep it.
            '\n' => plain.push_str("  \n"),
            _ => plain.push(character),
        }
    }
    plain
}
