//! The formatter: one layout for all sources of a project.
//!
//! It works on tokens, not on the tree, because the tree has no comments. A file has to parse, so that
//! the structure that the tokens are laid out by is the one that the compiler sees. `words` cuts the
//! file, `layout` decides where lines begin, `spacing` what stands between two words of a line, and
//! `render` writes the text.
//!
//! White space and the case of keywords are all that changes. The result is read again and compared
//! with the source word by word before anyone gets it: a mistake in here is an error and no damage.

mod block;
mod layout;
mod render;
mod spacing;
mod words;

use thiserror::Error;

use crate::diagnostic::{Diagnostic, Diagnostics};
use crate::limits;
use crate::source::{FileId, Position, Sources};
use crate::syntax::parser;
use words::Word;

/// Why a source is not formatted.
#[derive(Debug, Error)]
pub enum FormatError {
    /// It does not parse.
    #[error("{} errors; a file is formatted if it can be parsed", .0.len())]
    Syntax(Vec<Diagnostic>),
    /// With its indentation it would be larger than a source may be.
    #[error(
        "the formatted file would have more than {} bytes, which is the most that a source may have",
        limits::FILE_BYTES
    )]
    TooLarge,
    /// The result would have other words than the source.
    #[error(
        "the formatter would change more than white space here, which is a mistake of Takt; \
         the file is left as it is"
    )]
    Changed(Position),
}

/// The formatted text of a file.
///
/// # Errors
///
/// See [`FormatError`].
pub fn format(sources: &Sources, file: FileId) -> Result<String, FormatError> {
    let mut diagnostics = Diagnostics::new();
    let _ = parser::parse(file, sources, &mut diagnostics);
    if diagnostics.has_errors() {
        let mut errors = diagnostics.sorted();
        errors.retain(Diagnostic::is_error);
        return Err(FormatError::Syntax(errors));
    }
    let source = sources.get(file);
    let before = words::cut(file, source);
    let text = render::text(&layout::lines(&before), source.text()).ok_or(FormatError::TooLarge)?;
    let mut result = Sources::new();
    let formatted =
        result.add(source.name(), text.as_bytes()).map_err(|_| FormatError::TooLarge)?;
    let after = words::cut(formatted, result.get(formatted));
    if let Some(place) = difference(&before, &after) {
        let place = place.unwrap_or(source.text().len()) as u32;
        return Err(FormatError::Changed(source.position(place)));
    }
    Ok(text)
}

/// Where the first word stands that is not the same; `Some(None)` if it is behind the last one.
fn difference(before: &[Word<'_>], after: &[Word<'_>]) -> Option<Option<usize>> {
    let differs = before.iter().zip(after).find(|(one, other)| !one.same_as(other));
    match differs {
        Some((one, _)) => Some(Some(one.start)),
        None if before.len() != after.len() => Some(before.get(after.len()).map(|word| word.start)),
        None => None,
    }
}

#[cfg(test)]
#[path = "format_tests.rs"]
mod tests;
