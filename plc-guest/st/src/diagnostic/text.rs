//! Messages as text for people, with the line of the source that each is about.

use std::fmt::{self, Write};

use super::Diagnostic;
use crate::source::{Sources, Span};

/// The characters of a line that are shown: a file may be one line of megabytes.
const WIDTH: usize = 120;

/// One message, several lines, with an end of line behind the last.
///
/// ```text
/// error[unknown-name]: tank.st:14:5: there is no variable `levl`
///  14 |     levl := 3;
///     |     ^^^^
///   allowed: a variable of this program
///   hint: did you mean `level`?
///   tank.st:3:5: `level` is declared here
/// ```
///
/// # Errors
///
/// Those of `out`.
pub fn write(out: &mut dyn Write, sources: &Sources, one: &Diagnostic) -> fmt::Result {
    let place = place(sources, one.span);
    writeln!(out, "{}[{}]: {place}: {}", one.code.severity(), one.code, one.found)?;
    excerpt(out, sources, one.span)?;
    if let Some(allowed) = &one.allowed {
        writeln!(out, "  allowed: {allowed}")?;
    }
    if let Some(hint) = &one.hint {
        writeln!(out, "  hint: {hint}")?;
    }
    for related in &one.related {
        writeln!(out, "  {}: {}", self::place(sources, related.span), related.note)?;
    }
    Ok(())
}

/// One message as text.
#[must_use]
pub fn to_string(sources: &Sources, one: &Diagnostic) -> String {
    let mut out = String::new();
    // A String takes everything.
    let _ = write(&mut out, sources, one);
    out
}

fn place(sources: &Sources, span: Span) -> String {
    let source = sources.get(span.file);
    if !source.has_places() {
        return source.name().to_owned();
    }
    format!("{}:{}", sources.get(span.file).name(), sources.position(span))
}

/// The first line of a place, with marks below it. Of a long line, what is around the place.
fn excerpt(out: &mut dyn Write, sources: &Sources, span: Span) -> fmt::Result {
    let source = sources.get(span.file);
    if !source.has_places() {
        return Ok(());
    }
    let start = source.position(span.start);
    let end = source.position(span.end);
    let column = start.column as usize - 1;
    let from = if column < WIDTH * 2 / 3 { 0 } else { column - WIDTH / 3 };
    let line = source.line(start.line);
    // A tab is shown as one blank, so that the marks stand below what they mark.
    let shown: String =
        line.chars().skip(from).take(WIDTH).map(|c| if c.is_control() { ' ' } else { c }).collect();
    let characters = shown.chars().count();
    let marked = if end.line == start.line { end.column as usize - 1 } else { from + characters };
    let marks = marked.saturating_sub(column).clamp(1, (from + WIDTH - column).max(1));
    let number = start.line.to_string();
    writeln!(out, " {number} | {shown}")?;
    let (gutter, blanks) = (" ".repeat(number.len()), " ".repeat(column - from));
    writeln!(out, " {gutter} | {blanks}{}", "^".repeat(marks))
}

#[cfg(test)]
#[path = "text_tests.rs"]
mod tests;
