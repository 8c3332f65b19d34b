//! Why nothing can be measured or shown.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why nothing can be measured or shown.
#[derive(Debug, Error)]
pub enum JitterError {
    /// A file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
    /// A file is not what it should be.
    #[error("{} is no {what}: {source}", path.display())]
    Format { path: PathBuf, what: &'static str, source: serde_json::Error },
    /// A file is of another version of Takt, or of none.
    #[error("{} is a {what} of version {found}; this program reads version {known}", path.display())]
    Version { path: PathBuf, what: &'static str, found: u32, known: u32 },
    /// A report and samples do not belong together.
    #[error("{} and {} are not of one run: {text}", report.display(), samples.display())]
    OtherRun { report: PathBuf, samples: PathBuf, text: String },
    /// A file is larger than anything that Takt writes.
    #[error("{} is too large: {most} bytes are the most", path.display())]
    TooLarge { path: PathBuf, most: u64 },
    /// `takt` does not start.
    #[error("cannot run {}: {source}", path.display())]
    Takt { path: PathBuf, source: io::Error },
    /// The drawing library gives up.
    #[error("cannot draw: {0}")]
    Plot(String),
}

/// Makes an error of one of reading `path`.
pub fn reading(path: &Path) -> impl FnOnce(io::Error) -> JitterError {
    |source| JitterError::Read { path: path.to_owned(), source }
}

/// Makes an error of one of writing `path`.
pub fn writing(path: &Path) -> impl FnOnce(io::Error) -> JitterError {
    |source| JitterError::Write { path: path.to_owned(), source }
}
