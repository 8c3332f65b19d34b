//! Files of results, which are opened before the run, since nothing can be opened after its start.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::run_error::RunError;

/// A file of results, opened while files can be.
pub(super) struct Output {
    what: &'static str,
    path: PathBuf,
    file: fs::File,
}

impl Output {
    /// Opens it; what it has stays there until it is written.
    pub(super) fn create(what: &'static str, path: &Path) -> Result<Self, RunError> {
        let failed = |source| RunError::Output { what, path: path.to_owned(), source };
        let mut options = fs::File::options();
        let file = options.write(true).create(true).truncate(false).open(path).map_err(failed)?;
        Ok(Self { what, path: path.to_owned(), file })
    }

    pub(super) fn write(self, json: serde_json::Result<String>) -> Result<(), RunError> {
        let Self { what, path, mut file } = self;
        let failed = |source| RunError::Output { what, path, source };
        let write = || {
            let mut json = json?;
            json.push('\n');
            if file.metadata()?.is_file() {
                file.set_len(0)?;
            }
            file.write_all(json.as_bytes())
        };
        write().map_err(failed)
    }
}
