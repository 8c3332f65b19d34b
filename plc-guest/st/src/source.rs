//! The sources of a project and places in them.
//!
//! A place is a file's number and two byte offsets: 12 bytes, which every token and every node of the
//! trees can afford. Lines and columns are computed when a message is shown.

use std::fmt;

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
    #[error(
        "{name}: more than {} bytes, which is the most that a source may have",
        limits::FILE_BYTES
    )]
    TooLarge {
        /// The file's name.
        name: String,
    },
    /// Not text.
    #[error(
        "{name}: byte {offset} is not UTF-8 text; a source is text in UTF-8 (was this saved in \
         another encoding, or is it a binary file?)"
    )]
    NotText {
        /// The file's name.
        name: String,
        /// The first byte that is none.
        offset: usize,
    },
    /// More than [`limits::FILES`].
    #[error("{name}: more than {} files in one project", limits::FILES)]
    TooMany {
        /// The file's name.
        name: String,
    },
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
}

/// In bytes.
const BLOCK: usize = 256;

/// Every byte of UTF-8 but the continuations begins a character.
fn count_characters(bytes: &[u8]) -> u32 {
    bytes.iter().filter(|byte| **byte & 0xC0 != 0x80).count() as u32
}

impl Source {
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
        // Editors of Windows put this before UTF-8.
        let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
        let text = std::str::from_utf8(bytes)
            .map_err(|e| SourceError::NotText { name: name.into(), offset: e.valid_up_to() })?;
        if let Some(offset) = bytes.iter().position(|byte| *byte == 0) {
            return Err(SourceError::NotText { name: name.into(), offset });
        }
        let mut lines = vec![0];
        lines.extend(
            bytes.iter().enumerate().filter(|(_, b)| **b == b'\n').map(|(at, _)| at as u32 + 1),
        );
        let id = FileId(self.files.len() as u32);
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
        self.files.push(Source {
            name: name.into(),
            text: text.into(),
            lines,
            characters,
            library: false,
        });
        Ok(id)
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
