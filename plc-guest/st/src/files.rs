//! The files of a project on disk.
//!
//! What cannot be read hides nothing: it becomes a message of the project, and the other files are read.

use std::io::Read;
use std::path::{Path, PathBuf};

use crate::diagnostic::{Code, Diagnostic};
use crate::limits;
use crate::source::{FileId, SourceError, Sources, Span, without_mark};

/// How deep folders are followed.
const FOLDERS: u32 = 16;

/// Why something is not read.
#[derive(Debug, thiserror::Error)]
pub enum FilesError {
    /// The system refuses.
    #[error("cannot read {}: {error}", shown(path))]
    Read {
        /// What.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// A folder without any source.
    #[error("{}: no file in this folder ends with .st", shown(path))]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// Folders too deep within each other.
    #[error("{}: folders more than {FOLDERS} deep", shown(path))]
    TooDeep {
        /// The folder.
        path: PathBuf,
    },
    /// A link to a folder around it.
    #[error("{}: a link to a folder around it, {}, which is not followed", shown(path), target.display())]
    Loop {
        /// The link.
        path: PathBuf,
        /// Where it leads to.
        target: PathBuf,
    },
    /// Not a regular file or a folder.
    #[error("{}: neither a file nor a folder", shown(path))]
    Special {
        /// What.
        path: PathBuf,
    },
}

impl FilesError {
    /// What it is about.
    #[must_use]
    pub fn path(&self) -> &Path {
        match self {
            Self::Read { path, .. }
            | Self::Empty { path }
            | Self::TooDeep { path }
            | Self::Loop { path, .. }
            | Self::Special { path } => path,
        }
    }

    fn diagnostic(&self, span: Span) -> Diagnostic {
        const SOURCES: &str = "files in Structured Text, and folders with files that end with .st";
        match self {
            Self::Read { error, .. } => {
                Diagnostic::new(Code::CannotRead, span, format!("cannot be read: {error}"))
            }
            Self::Empty { .. } => {
                Diagnostic::new(Code::NoSource, span, "no file in this folder ends with .st")
                    .allowed(SOURCES)
            }
            Self::TooDeep { .. } => {
                let found = format!("folders more than {FOLDERS} deep");
                Diagnostic::new(Code::TooDeep, span, found)
                    .allowed(format!("folders at most {FOLDERS} deep within each other"))
            }
            Self::Loop { target, .. } => {
                let found = format!(
                    "a link to a folder around it, {}, which is not followed",
                    target.display()
                );
                Diagnostic::new(Code::FolderLoop, span, found)
                    .hint("remove the link: the files of that folder are read without it")
            }
            Self::Special { .. } => {
                Diagnostic::new(Code::NoSource, span, "neither a file nor a folder")
                    .allowed(SOURCES)
            }
        }
    }
}

/// The files that some paths lead to, and what leads to none.
#[derive(Debug, Default)]
pub struct Listed {
    /// The files.
    pub files: Vec<PathBuf>,
    /// What is not read, and why.
    pub refused: Vec<FilesError>,
}

impl Listed {
    /// The files, if all can be listed. A link that leads nowhere new hides no file.
    ///
    /// # Errors
    ///
    /// The first that is not read.
    pub fn all(self) -> Result<Vec<PathBuf>, FilesError> {
        match self.refused.into_iter().find(|error| !matches!(error, FilesError::Loop { .. })) {
            Some(error) => Err(error),
            None => Ok(self.files),
        }
    }
}

/// Reads files, and of folders all that end with `.st`, those of folders within them too, in the order
/// of their names. Messages show them as they are written here.
#[must_use]
pub fn read(paths: &[PathBuf]) -> Sources {
    let mut sources = Sources::new();
    let Listed { files, refused } = list(paths);
    for path in files {
        add(&mut sources, &path);
    }
    refuse(&mut sources, &refused);
    sources
}

/// Adds messages about what is not read.
pub fn refuse(sources: &mut Sources, errors: &[FilesError]) {
    for error in errors {
        sources.refuse(&shown(error.path()), None, |span| error.diagnostic(span));
    }
}

/// As messages show a path.
fn shown(path: &Path) -> String {
    if path.as_os_str().is_empty() { ".".to_owned() } else { path.display().to_string() }
}

/// The files that [`read`] reads.
#[must_use]
pub fn list(paths: &[PathBuf]) -> Listed {
    let mut listed = Listed::default();
    for path in paths {
        // What is left of `.`, for which names are shown without it.
        let there = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        match there.metadata() {
            Err(error) => listed.refused.push(cannot_read(there, error)),
            Ok(metadata) if metadata.is_dir() => {
                let before = (listed.files.len(), listed.refused.len());
                Walk::new("st").folder(path, &mut listed);
                if (listed.files.len(), listed.refused.len()) == before {
                    listed.refused.push(FilesError::Empty { path: path.clone() });
                }
            }
            Ok(metadata) if metadata.is_file() => listed.files.push(path.clone()),
            Ok(_) => listed.refused.push(FilesError::Special { path: path.clone() }),
        }
    }
    listed
}

fn cannot_read(path: &Path, error: std::io::Error) -> FilesError {
    FilesError::Read { path: path.into(), error }
}

/// The files in a folder, and in folders within it, whose names end so, in the order of their names.
#[must_use]
pub fn within(folder: &Path, extension: &str) -> Listed {
    let mut listed = Listed::default();
    Walk::new(extension).folder(folder, &mut listed);
    listed
}

/// Whether a path ends with a dot and this extension, in small or large letters.
#[must_use]
pub fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

/// A walk through a folder and those within it.
struct Walk<'e> {
    extension: &'e str,
    /// The folders that it is in, without links in their paths.
    around: Vec<PathBuf>,
}

impl<'e> Walk<'e> {
    fn new(extension: &'e str) -> Self {
        Self { extension, around: Vec::new() }
    }

    fn folder(&mut self, folder: &Path, listed: &mut Listed) {
        if self.around.len() >= FOLDERS as usize {
            listed.refused.push(FilesError::TooDeep { path: folder.into() });
            return;
        }
        let there = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        let real = there.canonicalize();
        let (real, mut paths) = match real.and_then(|real| Ok((real, names(there, folder)?))) {
            Ok(found) => found,
            Err(error) => return listed.refused.push(cannot_read(folder, error)),
        };
        self.around.push(real);
        paths.sort();
        for path in paths {
            if path.is_dir() {
                match self.looped(&path) {
                    Some(target) => listed.refused.push(FilesError::Loop { path, target }),
                    None => self.folder(&path, listed),
                }
            } else if has_extension(&path, self.extension) {
                match path.metadata() {
                    Ok(metadata) if metadata.is_file() => listed.files.push(path),
                    Ok(_) => listed.refused.push(FilesError::Special { path }),
                    Err(_) if is_lock(&path) => {}
                    Err(error) => listed.refused.push(cannot_read(&path, error)),
                }
            }
        }
        self.around.pop();
    }

    /// Where a link to a folder leads to, if the walk is in that folder already.
    fn looped(&self, path: &Path) -> Option<PathBuf> {
        if !path.is_symlink() {
            return None;
        }
        let target = path.canonicalize().ok()?;
        self.around.iter().any(|around| around.starts_with(&target)).then_some(target)
    }
}

/// Editors mark a file that they change by such a link beside it, which leads nowhere: no source is missing there.
fn is_lock(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b".#"))
}

fn names(there: &Path, folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    std::fs::read_dir(there)?.map(|entry| Ok(folder.join(entry?.file_name()))).collect()
}

/// Adds a file under the name of its path; none if it is no source, which is a message of the project then.
pub fn add(sources: &mut Sources, path: &Path) -> Option<FileId> {
    let bytes = match bytes(path) {
        Ok(bytes) => bytes,
        Err(error) => {
            refuse(sources, &[cannot_read(path, error)]);
            return None;
        }
    };
    let name = path.display().to_string();
    let bytes = without_mark(&bytes);
    let error = match sources.add(&name, bytes) {
        Ok(file) => return Some(file),
        Err(error) => error,
    };
    let (code, before) = match &error {
        SourceError::NotText { offset, .. } => {
            (Code::NotText, bytes.get(..*offset).and_then(|text| str::from_utf8(text).ok()))
        }
        // One message is enough for all that are too many.
        SourceError::TooMany { .. }
            if sources.refused().iter().any(|one| one.found == error.what()) =>
        {
            return None;
        }
        SourceError::TooLarge { .. } | SourceError::TooMany { .. } => (Code::TooLarge, None),
    };
    sources.refuse(&name, before, |span| {
        let one = Diagnostic::new(code, span, error.what()).allowed(error.allowed());
        one.hint(of_bytes(bytes).unwrap_or("what it declares is not known to the other files"))
    });
    None
}

/// What a file that is no source seems to be, by its first bytes.
fn of_bytes(bytes: &[u8]) -> Option<&'static str> {
    const UTF_16: &str = "it seems to be text in UTF-16: save it in UTF-8";
    Some(match bytes {
        [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] => UTF_16,
        // Latin letters in it have a zero each.
        [first, 0, second, 0, ..] if first.is_ascii_graphic() && !second.is_ascii_control() => {
            UTF_16
        }
        [0x7F, b'E', b'L', b'F', ..] => "it seems to be a compiled program (ELF)",
        _ if bytes.starts_with(&takt_program::MAGIC) => "it is a program image of Takt",
        _ => return None,
    })
}

/// One byte more than allowed is enough to know that it is too large.
fn bytes(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path)?;
    file.take(limits::FILE_BYTES as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}
