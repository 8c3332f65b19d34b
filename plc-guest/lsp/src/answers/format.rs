//! A text as the formatter lays it out.

use lsp_types::TextEdit;
use takt_st::format::{self, FormatError};
use takt_st::source::Span;

use crate::analysis::{Analysis, File};

/// The changes that format a text: one that covers the lines that differ, so that the cursor of the editor stays where
/// it is. None if the text does not parse: its errors are shown as such.
pub fn edits(analysis: &Analysis, file: &File) -> Result<Option<Vec<TextEdit>>, String> {
    let formatted = match format::format(&analysis.sources, file.id) {
        Ok(formatted) => formatted,
        Err(FormatError::Syntax(_)) => return Ok(None),
        Err(error) => return Err(error.to_string()),
    };
    let text = analysis.sources.get(file.id).text();
    let same = |one: &(&str, &str)| one.0 == one.1;
    let lines = || text.split_inclusive('\n').zip(formatted.split_inclusive('\n'));
    let before: usize = lines().take_while(same).map(|(line, _)| line.len()).sum();
    let (rest, new) = (&text[before..], &formatted[before..]);
    let last = || rest.split_inclusive('\n').rev().zip(new.split_inclusive('\n').rev());
    let behind: usize = last().take_while(same).map(|(line, _)| line.len()).sum();
    let end = text.len() - behind;
    let new = &new[..new.len() - behind];
    if new == &text[before..end] {
        return Ok(Some(Vec::new()));
    }
    let span = Span { file: file.id, start: before as u32, end: end as u32 };
    Ok(Some(vec![TextEdit { range: analysis.range(file, span), new_text: new.to_owned() }]))
}
