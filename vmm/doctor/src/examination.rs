//! What `takt` finds out about KVM, which takes machines.
//!
//! This program links no hypervisor. The machines that have to be made are those of `takt`, in the same
//! folder, which tells what it has found as JSON (`takt probe --json`).

use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;

use takt_host::kvm::{Examination, Found, SCHEMA_VERSION};
use thiserror::Error;

/// There is no answer.
#[derive(Debug, Error)]
pub enum ExaminationError {
    /// It does not run.
    #[error("cannot run {}: {source}", path.display())]
    Run {
        /// The program.
        path: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
    /// It says something else.
    #[error("{} probe --json gives no answer of schema {SCHEMA_VERSION}: it is of another version", path.display())]
    Answer {
        /// The program.
        path: PathBuf,
    },
}

/// Asks the `takt` in the folder of this program.
///
/// # Errors
/// See [`ExaminationError`].
pub fn ask() -> Result<Found, ExaminationError> {
    let own = std::env::current_exe().unwrap_or_default();
    ask_program(&own.with_file_name("takt"), &["probe", "--json"].map(OsStr::new))
}

fn ask_program(path: &Path, arguments: &[&OsStr]) -> Result<Found, ExaminationError> {
    let output = Command::new(path).args(arguments).output();
    let output =
        output.map_err(|source| ExaminationError::Run { path: path.to_owned(), source })?;
    let answer: Option<Examination> = serde_json::from_slice(&output.stdout).ok();
    answer
        .filter(|answer| answer.schema_version == SCHEMA_VERSION)
        .map(|answer| answer.kvm)
        .ok_or_else(|| ExaminationError::Answer { path: path.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn says(text: &str) -> Result<Found, ExaminationError> {
        ask_program(Path::new("/bin/echo"), &["-n", text].map(OsStr::new))
    }

    #[test]
    fn an_answer_of_this_version_is_taken() {
        let closed = r#"{"schema_version":2,"kvm":{"state":"closed","errno":13}}"#;
        assert_eq!(says(closed).unwrap(), Found::Closed { errno: 13 });
    }

    #[test]
    fn anything_else_is_told() {
        for text in
            ["", "{}", "takt 0.1.0", r#"{"schema_version":3,"kvm":{"state":"closed","errno":13}}"#]
        {
            let error = says(text).unwrap_err().to_string();
            assert!(error.contains("another version"), "{error}");
        }
        let error = ask_program(Path::new("/no/takt"), &[]).unwrap_err().to_string();
        assert!(error.starts_with("cannot run /no/takt: "), "{error}");
    }
}
