//! Names: one form for all of them, so that each can stand in a file name, a trace and a terminal.

use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};

/// Who an end of a channel belongs to if it is Takt itself. No partition has this name.
pub const HOST: &str = "host";
/// Longest name, in characters.
const NAME_MAX: usize = 32;

/// A name, of anything that has one.
pub fn check_name(name: &Spanned<String>) -> Result<&str, Diagnostic> {
    check_word(name.get_ref(), name.span())
}

/// A name that may be a part only of the value at `span`.
pub fn check_word(text: &str, span: Span) -> Result<&str, Diagnostic> {
    let rest = |c: char| matches!(c, 'a'..='z' | '0'..='9' | '-');
    if text.starts_with(|c: char| c.is_ascii_lowercase())
        && text.chars().all(rest)
        && text.len() <= NAME_MAX
    {
        return Ok(text);
    }
    let found = format!("the name {} is not a word of the allowed form", quote(text));
    let allowed = "1 to 32 of a-z, 0-9 and \"-\", the first of them a letter";
    Err(Diagnostic::new(span, found, allowed))
}
