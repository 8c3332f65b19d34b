//! The sources of a project and places in them.
//!
//! A place is a file's number and two byte offsets: 12 bytes, which every token and every node of the
//! trees can afford. Lines and columns are computed when a message is shown.

use std::fmt;

use crate::diagnostic::Diagnostic;
use crate::limits;

/// A file of a [`Sources`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct FileId(u32);

impl FileId {
    /// Its place in the order in which files were added.
    #[must_use]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// A stretch of one file, in bytes from its start; the end is exclusive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    /// The file.
    pub file: FileId,
    /// Its first byte.
    pub start: u32,
    /// The byte after its last one.
    pub end: u32,
}

impl Span {
    /// From the start of this one to the end of `last`, which is behind it in the same file.
    #[must_use]
    pub fn to(self, last: Self) -> Self {
        Self { file: self.file, start: self.start, end: last.end.max(self.end) }
    }

    /// The empty place right behind it.
    #[must_use]
    pub fn after(self) -> Self {
        Self { start: self.end, ..self }
    }

    /// The empty place at its start.
    #[must_use]
    pub fn before(self) -> Self {
        Self { end: self.start, ..self }
    }
}

/// Line and column, both from 1; the column counts characters, a tab as one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Position {
    /// The line.
    pub line: u32,
    /// The column.
    pub column: u32,
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.line, self.column)
    }
}

/// Why a file cannot be a source.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum SourceError {
    /// More than [`limits::FILE_BYTES`].
    #[error("{name}: {}", self.what())]
    TooLarge {
        /// The file's name.
        name: String,
    },
    /// Not text.
    #[error("{name}: {}; {}", self.what(), self.allowed())]
    NotText {
        /// The file's name.
        name: String,
        /// The first byte that is none.
        offset: usize,
    },
    /// More than [`limits::FILES`].
    #[error("{name}: {}", self.what())]
    TooMany {
        /// The file's name.
        name: String,
    },
}

impl SourceError {
    /// What was found.
    #[must_use]
    pub fn what(&self) -> String {
        match self {
            Self::TooLarge { .. } => format!("more than {} bytes", limits::FILE_BYTES),
            Self::NotText { offset, .. } => format!("byte {offset} is not UTF-8 text"),
            Self::TooMany { .. } => format!("more than {} files in one project", limits::FILES),
        }
    }

    /// What is allowed.
    #[must_use]
    pub fn allowed(&self) -> String {
        match self {
            Self::TooLarge { .. } => format!("a source of at most {} bytes", limits::FILE_BYTES),
            Self::NotText { .. } => {
                "text in UTF-8 (was this saved in another encoding, or is it a binary file?)".into()
            }
            Self::TooMany { .. } => format!("at most {} files", limits::FILES),
        }
    }
}

/// One file: its name as messages show it, and its text.
#[derive(Debug)]
pub struct Source {
    name: String,
    text: String,
    /// The offset of each line's first byte.
    lines: Vec<u32>,
    /// The characters before each block of [`BLOCK`] bytes, so that a column in a line of megabytes
    /// costs no more than one in a short line. Empty where each character is a byte.
    characters: Vec<u32>,
    library: bool,
    read: bool,
    whole: bool,
}

/// In bytes.
const BLOCK: usize = 256;

/// A text without the mark of byte order that editors of Windows put before UTF-8.
pub(crate) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes)
}

/// Every byte of UTF-8 but the continuations begins a character.
fn count_characters(bytes: &[u8]) -> u32 {
    bytes.iter().filter(|byte| **byte & 0xC0 != 0x80).count() as u32
}

impl Source {
    fn new(name: &str, text: &str) -> Self {
        let bytes = text.as_bytes();
        let mut lines = vec![0];
        lines.extend(
            bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(at, _)| at as u32 + 1),
        );
        let mut characters = Vec::new();
        if !text.is_ascii() {
            let mut before = 0;
            // The end of a text that ends with a block has a place too.
            characters.push(0);
            characters.extend(bytes.chunks(BLOCK).map(|block| {
                before += count_characters(block);
                before
            }));
        }
        let (name, text) = (name.into(), text.into());
        Self { name, text, lines, characters, library: false, read: true, whole: true }
    }

    /// Whether the file could be read, so that it has declarations.
    #[must_use]
    pub fn is_read(&self) -> bool {
        self.read
    }

    /// Whether places in the file are known. Of a file that could not be read at all there is only the name.
    #[must_use]
    pub fn has_places(&self) -> bool {
        self.whole
    }

    /// Its name, as messages show it.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its text.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Where a byte offset is. An offset behind the end is the end.
    #[must_use]
    pub fn position(&self, offset: u32) -> Position {
        let line = self.lines.partition_point(|start| *start <= offset).saturating_sub(1);
        let start = self.lines.get(line).map_or(0, |start| *start as usize);
        let end = (offset as usize).clamp(start, self.text.len());
        let column = self.characters_before(end) - self.characters_before(start);
        Position { line: line as u32 + 1, column: column + 1 }
    }

    /// The characters before a byte.
    fn characters_before(&self, at: usize) -> u32 {
        if self.characters.is_empty() {
            return at as u32;
        }
        let block = at / BLOCK;
        let behind = self.text.as_bytes().get(block * BLOCK..at).unwrap_or(&[]);
        self.characters.get(block).copied().unwrap_or(0) + count_characters(behind)
    }

    /// The text of a line (from 1) without its end.
    #[must_use]
    pub fn line(&self, line: u32) -> &str {
        let index = line.saturating_sub(1) as usize;
        let start = self.lines.get(index).map_or(self.text.len(), |start| *start as usize);
        let end = self.lines.get(index + 1).map_or(self.text.len(), |start| *start as usize);
        self.text.get(start..end).unwrap_or("").trim_end_matches(['\n', '\r'])
    }
}

/// All files of a project.
#[derive(Debug, Default)]
pub struct Sources {
    files: Vec<Source>,
    refused: Vec<Diagnostic>,
}

impl Sources {
    /// None yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a file under the name that messages shall show.
    ///
    /// # Errors
    ///
    /// If it is too large, not text, or one too many.
    pub fn add(&mut self, name: &str, bytes: &[u8]) -> Result<FileId, SourceError> {
        if bytes.len() > limits::FILE_BYTES {
            return Err(SourceError::TooLarge { name: name.into() });
        }
        if self.files.len() >= limits::FILES {
            return Err(SourceError::TooMany { name: name.into() });
        }
        let bytes = without_mark(bytes);
        let text = std::str::from_utf8(bytes)
            .map_err(|e| SourceError::NotText { name: name.into(), offset: e.valid_up_to() })?;
        if let Some(offset) = bytes.iter().position(|byte| *byte == 0) {
            return Err(SourceError::NotText { name: name.into(), offset });
        }
        Ok(self.push(name, text))
    }

    /// Adds a file of the compiler's own, which counts for no limit.
    pub(crate) fn push(&mut self, name: &str, text: &str) -> FileId {
        let id = FileId(self.files.len() as u32);
        self.files.push(Source::new(name, text));
        id
    }

    /// Takes note of something that is no source, by its name and the text before what is wrong with it, if there is
    /// such a place. Its message is one of the project's; the others are checked all the same.
    pub fn refuse(
        &mut self,
        name: &str,
        before: Option<&str>,
        message: impl FnOnce(Span) -> Diagnostic,
    ) {
        // A few more than a project may have: those are told of by their number.
        if self.files.len() > limits::FILES + 16 {
            return;
        }
        let file = FileId(self.files.len() as u32);
        let text = before.unwrap_or("");
        let source = Source::new(name, text);
        self.files.push(Source { read: false, whole: before.is_some(), ..source });
        let end = text.len() as u32;
        self.refused.push(message(Span { file, start: end, end }));
    }

    /// The messages about what is no source.
    #[must_use]
    pub fn refused(&self) -> &[Diagnostic] {
        &self.refused
    }

    /// The place of a word that begins at a line and column of a file, both from 1.
    #[must_use]
    pub fn word_at(&self, file: usize, line: u32, column: u32) -> Option<Span> {
        let source = self.files.get(file)?;
        let start = *source.lines.get(line.checked_sub(1)? as usize)? as usize;
        let rest = source.text.get(start..)?;
        let skipped = rest.char_indices().nth(column.checked_sub(1)? as usize);
        let at = start + skipped.map_or(rest.len(), |(at, _)| at);
        let is_word = |c: &char| c.is_alphanumeric() || *c == '_';
        let word = source.text.get(at..)?.chars().take_while(is_word);
        let end = at + word.map(char::len_utf8).sum::<usize>();
        Some(Span { file: FileId(file as u32), start: at as u32, end: end as u32 })
    }

    /// Makes a file one of a library: what is not used of it is neither told of nor compiled.
    pub fn mark_as_library(&mut self, file: FileId) {
        if let Some(source) = self.files.get_mut(file.index()) {
            source.library = true;
        }
    }

    /// Whether a file is one of a library.
    #[must_use]
    pub fn is_of_library(&self, file: FileId) -> bool {
        self.get(file).library
    }

    /// The file of this number.
    ///
    /// # Panics
    ///
    /// If the number is from another `Sources`.
    #[must_use]
    pub fn get(&self, file: FileId) -> &Source {
        &self.files[file.index()]
    }

    /// All files with their numbers, in the order in which they were added.
    pub fn iter(&self) -> impl Iterator<Item = (FileId, &Source)> {
        self.files.iter().enumerate().map(|(index, file)| (FileId(index as u32), file))
    }

    /// The text of a place.
    #[must_use]
    pub fn text(&self, span: Span) -> &str {
        self.get(span.file).text.get(span.start as usize..span.end as usize).unwrap_or("")
    }

    /// Where a place starts.
    #[must_use]
    pub fn position(&self, span: Span) -> Position {
        self.get(span.file).position(span.start)
    }
}

#[cfg(test)]
#[path = "source_tests.rs"]
mod tests;
