//! From what the user has named to the socket.

use std::fs;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

use takt_plan::{self as config, PartitionFile};

use crate::error::ClientError;

/// The control socket that a partition file names; or the path itself, if it is no such file.
///
/// # Errors
/// If the partition file is wrong or has no control socket.
pub fn socket(place: &Path) -> Result<PathBuf, ClientError> {
    let is_file = match fs::metadata(place) {
        Ok(file) => !file.file_type().is_socket(),
        // Then it is either a misspelt file or the socket of a Takt that does not run.
        Err(_) => place.extension().is_some_and(|extension| extension == "toml"),
    };
    if !is_file {
        return Ok(place.to_owned());
    }
    // Which CPUs there are is the business of the Takt that runs it.
    let file = config::load(place, None)?;
    given(&file)
}

/// The control socket of a partition file that has been read.
///
/// # Errors
/// If it has none.
pub fn given(file: &PartitionFile) -> Result<PathBuf, ClientError> {
    let none = || ClientError::NoControl(file.path().to_owned());
    file.control().map(Path::to_owned).ok_or_else(none)
}
