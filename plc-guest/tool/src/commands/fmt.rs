//! `takt plc fmt`: formats sources in Structured Text in place.
//!
//! A file that cannot be formatted is left as it is, and the others are formatted all the same: they do
//! not depend on each other.

use std::path::{Path, PathBuf};

use takt_st::diagnostic::text;
use takt_st::files;
use takt_st::format::{self, FormatError};

use super::structured_text::{Messages, Origin};
use super::write;
use crate::{Failure, status};

/// Arguments of `fmt`.
#[derive(clap::Args)]
pub struct Fmt {
    /// Sources, and folders of which all files that end with .st are taken. A folder with a project file
    /// (takt-plc.toml) is taken as a project; without any, the current folder is.
    paths: Vec<PathBuf>,
    /// Write nothing; list the files that would change and exit with 1 if there are any.
    #[arg(long)]
    check: bool,
}

impl Fmt {
    pub fn run(self) -> Result<(), Failure> {
        let (mut changed, mut refused) = (0, 0);
        for path in Origin::of(&self.paths, &Messages::default())?.files()? {
            match self.file(&path) {
                Ok(false) => {}
                Ok(true) => {
                    println!("{}", path.display());
                    changed += 1;
                }
                Err(message) => {
                    tell!("{}", message.trim_end());
                    refused += 1;
                }
            }
        }
        if refused > 0 {
            return Err(Failure::input(format!("{refused} files were left as they are")));
        }
        match changed {
            1.. if self.check => Err(Failure {
                status: status::NOT_AS_EXPECTED,
                message: format!("{changed} files are not formatted"),
            }),
            _ => Ok(()),
        }
    }

    /// Whether the file was not formatted. The error is a message about it.
    fn file(&self, path: &Path) -> Result<bool, String> {
        let sources = files::read(&[path.into()]);
        if let Some(refused) = sources.refused().first() {
            return Err(text::to_string(&sources, refused));
        }
        let Some((file, source)) = sources.iter().next() else { return Ok(false) };
        let formatted = format::format(&sources, file).map_err(|error| match error {
            FormatError::Syntax(errors) => {
                errors.iter().map(|one| text::to_string(&sources, one)).collect()
            }
            FormatError::TooLarge => format!("{}: {error}", path.display()),
            FormatError::Changed(place) => format!("{}:{place}: {error}", path.display()),
        })?;
        let changes = formatted != source.text();
        if changes && !self.check {
            replace(path, formatted.as_bytes())?;
        }
        Ok(changes)
    }
}

/// Writes a file in place, unless it is read-only: to replace it asks for no permission to write it.
fn replace(path: &Path, bytes: &[u8]) -> Result<(), String> {
    let there = path.metadata();
    if there.is_ok_and(|there| there.permissions().readonly()) {
        return Err(format!("{} is read-only", path.display()));
    }
    write(path, bytes).map_err(|failure| failure.message)
}
