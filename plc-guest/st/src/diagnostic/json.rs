//! Messages as lines of JSON, one object a line, for other programs.
//!
//! Lines and columns are counted from 1, columns in characters; byte offsets are from the file's
//! start. `end` is exclusive. A message about a file as a whole has no line in its place.

use serde::Serialize;

use super::Diagnostic;
use crate::source::{Sources, Span};

#[derive(Serialize)]
struct Message<'a> {
    severity: String,
    code: &'a str,
    message: &'a str,
    place: Place<'a>,
    #[serde(skip_serializing_if = "Option::is_none")]
    allowed: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    hint: Option<&'a str>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    related: Vec<Note<'a>>,
}

#[derive(Serialize)]
struct Note<'a> {
    place: Place<'a>,
    message: &'a str,
}

#[derive(Serialize)]
struct Place<'a> {
    file: &'a str,
    #[serde(flatten)]
    range: Option<Range>,
}

#[derive(Serialize)]
struct Range {
    line: u32,
    column: u32,
    end_line: u32,
    end_column: u32,
    offset: u32,
    end_offset: u32,
}

impl<'a> Place<'a> {
    fn new(sources: &'a Sources, span: Span) -> Self {
        let source = sources.get(span.file);
        let (start, end) = (source.position(span.start), source.position(span.end));
        let range = source.has_places().then_some(Range {
            line: start.line,
            column: start.column,
            end_line: end.line,
            end_column: end.column,
            offset: span.start,
            end_offset: span.end,
        });
        Self { file: source.name(), range }
    }
}

/// One message as a JSON object without an end of line.
#[must_use]
pub fn to_string(sources: &Sources, one: &Diagnostic) -> String {
    let related = one.related.iter();
    let message = Message {
        severity: one.code.severity().to_string(),
        code: one.code.name(),
        message: &one.found,
        place: Place::new(sources, one.span),
        allowed: one.allowed.as_deref(),
        hint: one.hint.as_deref(),
        related: related
            .map(|note| Note { place: Place::new(sources, note.span), message: &note.note })
            .collect(),
    };
    // Strings and numbers alone: there is nothing in it that JSON cannot say.
    serde_json::to_string(&message).unwrap_or_default()
}
