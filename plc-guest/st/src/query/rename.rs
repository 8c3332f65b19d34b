//! A new name for a declaration and all its uses.
//!
//! Which names a new one would hide or take the place of is a matter of every scope that it appears in. So
//! the change is tried: the changed project is read again, and each use must mean what it meant before.

use thiserror::Error;

use super::{Index, Symbol, Use};
use crate::check::known;
use crate::diagnostic::Diagnostics;
use crate::project::{self, Checked};
use crate::source::{FileId, Sources, Span};
use crate::stack;
use crate::syntax::lexer::Lexer;
use crate::syntax::parser;
use crate::syntax::token::TokenKind;

/// Why a declaration is not renamed.
#[derive(Debug, Error)]
pub enum RenameError {
    /// There is no name at the place, or one without a declaration.
    #[error("there is no declared name at this place")]
    NoName,
    /// It is the library's.
    #[error("`{0}` is declared in a library, which a project does not change")]
    Library(String),
    /// The new name is none.
    #[error(
        "`{0}` cannot be a name: allowed are letters A to Z, digits and single underscores, no digit first, at most \
         255 of them, and no keyword and no standard type"
    )]
    Invalid(String),
    /// A file does not parse, so that not all uses are known.
    #[error(
        "{0} has errors of syntax, so that not all uses of the name can be seen; mend them first"
    )]
    Syntax(String),
    /// A use that may or may not be one of this declaration.
    #[error(
        "it is not clear whether {place} means this `{name}`; mend this or write it with its type first"
    )]
    Unclear {
        /// File and line.
        place: String,
        /// The old name.
        name: String,
    },
    /// Something would mean something else.
    #[error("`{name}` has another meaning already: {place} would change its own")]
    Clash {
        /// File and line.
        place: String,
        /// The new name.
        name: String,
    },
    /// The changed project would have an error that is new.
    #[error("the project would have an error that it has not now: {0}")]
    NewError(String),
    /// The system has no room for a thread.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// The name at a place that can be changed.
///
/// # Errors
///
/// If there is none, or it is the library's.
pub fn prepare<'i>(
    sources: &Sources,
    index: &'i Index,
    file: FileId,
    offset: u32,
) -> Result<(&'i Use, &'i Symbol), RenameError> {
    let one = index.at(file, offset).ok_or(RenameError::NoName)?;
    let symbol = index.symbol(one.symbol);
    if symbol.library || sources.is_of_library(symbol.span.file) {
        return Err(RenameError::Library(symbol.name.clone()));
    }
    Ok((one, symbol))
}

/// All places where `new` is to be written instead of the name at a place. `sources` begin with `own` files of the
/// project; those behind are the library's.
///
/// # Errors
///
/// See [`RenameError`].
pub fn rename(
    sources: &Sources,
    own: usize,
    index: &Index,
    (file, offset): (FileId, u32),
    new: &str,
) -> Result<Vec<Span>, RenameError> {
    let (one, symbol) = prepare(sources, index, file, offset)?;
    if !is_name(new) {
        return Err(RenameError::Invalid(new.to_owned()));
    }
    let key = symbol.key();
    all_parse(sources, own)?;
    let unclear = |span: Span| RenameError::Unclear {
        place: place(sources, span),
        name: symbol.name.clone(),
    };
    let same_key = |span: &Span| sources.text(*span).eq_ignore_ascii_case(&key);
    let doubted = index.uses().iter().filter(|one| !one.certain).map(|one| one.span);
    if let Some(span) = doubted.chain(index.unknown().iter().copied()).find(same_key) {
        return Err(unclear(span));
    }
    let places: Vec<Span> = index.uses_of(one.symbol).map(|one| one.span).collect();
    // The project as it is, without the library, which a check adds.
    let mut before = changed(sources, own, &[], "").map_err(|()| unclear(one.span))?;
    let mut after =
        changed(sources, own, &places, new).map_err(|()| RenameError::Invalid(new.to_owned()))?;
    let old_errors = errors(&project::check_all("rename", &mut before)?);
    let checked = project::check_all("rename", &mut after)?;
    let changed = Index::new(&after, own)?;
    let differs = index
        .uses()
        .iter()
        .zip(changed.uses())
        .find(|(one, other)| one.symbol != other.symbol || one.certain != other.certain);
    if let Some((one, _)) = differs {
        return Err(RenameError::Clash { place: place(sources, one.span), name: new.to_owned() });
    }
    if index.uses().len() != changed.uses().len()
        || index.unknown().len() != changed.unknown().len()
    {
        return Err(RenameError::Clash { place: place(sources, one.span), name: new.to_owned() });
    }
    if errors(&checked) > old_errors {
        let first = checked.diagnostics.iter().find(|one| one.is_error());
        let shown = first.map(|one| format!("{}: {}", place(&after, one.span), one.found));
        return Err(RenameError::NewError(shown.unwrap_or_default()));
    }
    Ok(places)
}

fn errors(checked: &Checked) -> usize {
    checked.diagnostics.iter().filter(|one| one.is_error()).count()
}

fn place(sources: &Sources, span: Span) -> String {
    let name = sources.get(span.file).name();
    format!("`{}` in {name}:{}", sources.text(span), sources.position(span).line)
}

fn is_name(text: &str) -> bool {
    let mut one = Sources::new();
    let Ok(file) = one.add("name", text.as_bytes()) else { return false };
    let mut told = Diagnostics::new();
    let mut lexer = Lexer::new(file, one.get(file));
    let token = lexer.next_token(&mut told);
    let key = text.to_ascii_uppercase();
    token.kind == TokenKind::Identifier
        && token.span.end as usize == text.len()
        && token.span.start == 0
        && !told.has_errors()
        && !known::is_type(&key)
        && !matches!(&*key, "EN" | "ENO")
}

fn all_parse(sources: &Sources, own: usize) -> Result<(), RenameError> {
    let wrong = stack::with_room(|| {
        sources.iter().take(own).find_map(|(file, source)| {
            let mut told = Diagnostics::new();
            let _ = parser::parse(file, sources, &mut told);
            told.has_errors().then(|| source.name().to_owned())
        })
    })?;
    wrong.map_or(Ok(()), |name| Err(RenameError::Syntax(name)))
}

/// The files of the project with `new` at these places, which are in order.
fn changed(sources: &Sources, own: usize, places: &[Span], new: &str) -> Result<Sources, ()> {
    let mut result = Sources::new();
    for (file, source) in sources.iter().take(own) {
        let mut text = String::with_capacity(source.text().len());
        let mut at = 0;
        for span in places.iter().filter(|span| span.file == file) {
            text.push_str(source.text().get(at..span.start as usize).ok_or(())?);
            text.push_str(new);
            at = span.end as usize;
        }
        text.push_str(source.text().get(at..).ok_or(())?);
        let added = result.add(source.name(), text.as_bytes()).map_err(|_| ())?;
        if sources.is_of_library(file) {
            result.mark_as_library(added);
        }
    }
    Ok(result)
}
