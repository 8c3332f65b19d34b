//! The files of a project on disk.

use std::io::Read;
use std::path::{Path, PathBuf};

use crate::limits;
use crate::source::{FileId, SourceError, Sources};

/// How deep folders are followed.
const FOLDERS: u32 = 16;

/// Why the files of a project cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum FilesError {
    /// The system refuses.
    #[error("cannot read {}: {error}", path.display())]
    Read {
        /// What.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// It is no source.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A folder without any source.
    #[error("{}: no file in this folder ends with .st", path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
    },
    /// Folders too deep within each other, perhaps by a link to a folder above.
    #[error("{}: folders more than {FOLDERS} deep", path.display())]
    TooDeep {
        /// The folder.
        path: PathBuf,
    },
    /// Not a regular file or a folder.
    #[error("{}: neither a file nor a folder", path.display())]
    Special {
        /// What.
        path: PathBuf,
    },
}

/// Reads files, and of folders all that end with `.st`, those of folders within them too, in the order
/// of their names. Messages show them as they are written here.
///
/// # Errors
///
/// At the first that cannot be a source.
pub fn read(paths: &[PathBuf]) -> Result<Sources, FilesError> {
    let mut sources = Sources::new();
    for path in list(paths)? {
        add(&mut sources, &path)?;
    }
    Ok(sources)
}

/// The files that [`read`] reads.
///
/// # Errors
///
/// At the first path that is neither a file nor a folder with a source.
pub fn list(paths: &[PathBuf]) -> Result<Vec<PathBuf>, FilesError> {
    let mut files = Vec::new();
    for path in paths {
        // What is left of `.`, for which names are shown without it.
        let there = if path.as_os_str().is_empty() { Path::new(".") } else { path };
        let metadata = there.metadata().map_err(|error| cannot_read(there, error))?;
        if metadata.is_dir() {
            let before = files.len();
            collect(path, "st", FOLDERS, &mut files)?;
            if files.len() == before {
                return Err(FilesError::Empty { path: path.clone() });
            }
        } else if metadata.is_file() {
            files.push(path.clone());
        } else {
            return Err(FilesError::Special { path: path.clone() });
        }
    }
    Ok(files)
}

fn cannot_read(path: &Path, error: std::io::Error) -> FilesError {
    FilesError::Read { path: path.into(), error }
}

/// The files in a folder, and in folders within it, whose names end so, in the order of their names.
///
/// # Errors
///
/// If a folder cannot be read.
pub fn within(folder: &Path, extension: &str) -> Result<Vec<PathBuf>, FilesError> {
    let mut files = Vec::new();
    collect(folder, extension, FOLDERS, &mut files)?;
    Ok(files)
}

/// Whether a path ends with a dot and this extension, in small or large letters.
#[must_use]
pub fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|found| found.eq_ignore_ascii_case(extension))
}

fn collect(
    folder: &Path,
    extension: &str,
    depth: u32,
    files: &mut Vec<PathBuf>,
) -> Result<(), FilesError> {
    if depth == 0 {
        return Err(FilesError::TooDeep { path: folder.into() });
    }
    let there = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = std::fs::read_dir(there).map_err(|error| cannot_read(folder, error))?;
    let mut paths = Vec::new();
    for entry in entries {
        paths.push(folder.join(entry.map_err(|error| cannot_read(folder, error))?.file_name()));
    }
    paths.sort();
    for path in paths {
        if path.is_dir() {
            collect(&path, extension, depth - 1, files)?;
        } else if has_extension(&path, extension) && path.is_file() {
            files.push(path);
        }
    }
    Ok(())
}

/// Adds a file under the name of its path.
///
/// # Errors
///
/// If it cannot be a source.
pub fn add(sources: &mut Sources, path: &Path) -> Result<FileId, FilesError> {
    let file = std::fs::File::open(path).map_err(|error| cannot_read(path, error))?;
    let mut bytes = Vec::new();
    // One byte more than allowed is enough to know that it is too large.
    file.take(limits::FILE_BYTES as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(|error| cannot_read(path, error))?;
    Ok(sources.add(&path.display().to_string(), &bytes)?)
}
