//! What the compiler tells about a source: errors and warnings with their places.
//!
//! A message has the same parts everywhere: a code that documentation and tests can name, the place,
//! what was found, what is allowed, a hint what to do, and other places that explain it, such as the
//! first of two declarations. The parts are kept apart until the end, so that text for people
//! ([`text`]), lines of JSON ([`json`]) and an editor show the same.

mod code;
pub mod json;
pub mod text;

pub use code::{Code, Severity};

use crate::limits;
use crate::source::{FileId, Span};

/// One message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Diagnostic {
    /// Which kind of mistake it is.
    pub code: Code,
    /// Where it is.
    pub span: Span,
    /// What was found: one clause that starts in lower case, without a full stop.
    pub found: String,
    /// What is allowed there.
    pub allowed: Option<String>,
    /// What to do about it.
    pub hint: Option<String>,
    /// Other places that explain it.
    pub related: Vec<Related>,
}

/// Another place that explains a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Related {
    /// Where.
    pub span: Span,
    /// What is there.
    pub note: String,
}

impl Diagnostic {
    /// A message that says no more than what was found.
    #[must_use]
    pub fn new(code: Code, span: Span, found: impl Into<String>) -> Self {
        Self { code, span, found: found.into(), allowed: None, hint: None, related: Vec::new() }
    }

    /// Says what is allowed.
    #[must_use]
    pub fn allowed(mut self, allowed: impl Into<String>) -> Self {
        self.allowed = Some(allowed.into());
        self
    }

    /// Says what to do.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Points at another place.
    #[must_use]
    pub fn related(mut self, span: Span, note: impl Into<String>) -> Self {
        self.related.push(Related { span, note: note.into() });
        self
    }

    /// Whether it keeps the program from being built.
    #[must_use]
    pub fn is_error(&self) -> bool {
        self.code.severity() == Severity::Error
    }
}

/// The messages of a run. All stages add to one.
#[derive(Debug, Default)]
pub struct Diagnostics {
    list: Vec<Diagnostic>,
    /// The number found in each file, by its index.
    per_file: Vec<usize>,
    errors: usize,
}

impl Diagnostics {
    /// None yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one. Behind [`limits::ERRORS_PER_FILE`] for a file it is only counted.
    pub fn push(&mut self, diagnostic: Diagnostic) {
        let index = diagnostic.span.file.index();
        if self.per_file.len() <= index {
            self.per_file.resize(index + 1, 0);
        }
        self.per_file[index] += 1;
        // The first error is kept whatever was warned of before it.
        let first_error = diagnostic.is_error() && self.errors == 0;
        self.errors += usize::from(diagnostic.is_error());
        if self.per_file[index] <= limits::ERRORS_PER_FILE || first_error {
            self.list.push(diagnostic);
        }
    }

    /// Whether anything was found that keeps the program from being built.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        self.errors > 0
    }

    /// How many errors were found.
    #[must_use]
    pub fn errors(&self) -> usize {
        self.errors
    }

    /// How many of a file were not kept.
    #[must_use]
    pub fn left_out(&self, file: FileId) -> usize {
        let counted = self.per_file.get(file.index()).copied().unwrap_or(0);
        counted.saturating_sub(self.list.iter().filter(|one| one.span.file == file).count())
    }

    /// Takes back the warnings for which `keep` is not true.
    pub fn keep_warnings(&mut self, keep: impl Fn(&Diagnostic) -> bool) {
        self.list.retain(|one| one.is_error() || keep(one));
    }

    /// Those kept, by file and place.
    #[must_use]
    pub fn sorted(mut self) -> Vec<Diagnostic> {
        self.list.sort_by_key(|one| (one.span.file, one.span.start, one.span.end, one.code));
        self.list
    }

    /// Those kept, in the order in which they were found.
    pub fn iter(&self) -> impl Iterator<Item = &Diagnostic> {
        self.list.iter()
    }
}
