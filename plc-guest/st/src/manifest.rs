//! The project file, `takt-plc.toml`: what belongs to a project, so that commands need no arguments in its folder.

mod reader;

use std::collections::HashSet;
use std::fmt;
use std::path::{Component, Path, PathBuf};

use takt_program::Version;

use crate::diagnostic::{Diagnostic, text};
use crate::files::{self, FilesError};
use crate::source::Sources;

/// Its name in the project's folder.
pub const FILE: &str = "takt-plc.toml";

/// A project whose file is good. All paths begin with that of the project's folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Project {
    /// The folder that the file is in; empty for the current one.
    pub folder: PathBuf,
    /// The program's name.
    pub name: String,
    /// The author's version of it.
    pub version: Version,
    /// Its category, a number of the author's choice.
    pub category: u32,
    /// The image whose places of variables are kept.
    pub previous: Option<PathBuf>,
    sources: Vec<PathBuf>,
    libraries: Vec<PathBuf>,
    tests: Vec<PathBuf>,
}

/// Why a project cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ProjectError {
    /// The project file has mistakes.
    #[error("{0}")]
    Manifest(Box<Mistakes>),
    /// A file of the project cannot be read.
    #[error(transparent)]
    Files(#[from] FilesError),
}

/// The messages about a project file, with its text.
#[derive(Debug)]
pub struct Mistakes {
    /// The file, alone.
    pub sources: Sources,
    /// What is wrong with it, by place.
    pub diagnostics: Vec<Diagnostic>,
}

impl fmt::Display for Mistakes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, one) in self.diagnostics.iter().enumerate() {
            let text = text::to_string(&self.sources, one);
            let between = if at > 0 { "\n\n" } else { "" };
            write!(f, "{between}{}", text.trim_end())?;
        }
        Ok(())
    }
}

impl Project {
    /// Whether a folder has a project file.
    #[must_use]
    pub fn is_in(folder: &Path) -> bool {
        folder.join(FILE).is_file()
    }

    /// Reads the project file of a folder.
    ///
    /// # Errors
    ///
    /// If it cannot be read, or has mistakes: all of them.
    pub fn read(folder: &Path) -> Result<Self, ProjectError> {
        // `.` would be in front of all names that are shown.
        let folder: PathBuf =
            folder.components().filter(|part| *part != Component::CurDir).collect();
        let mut sources = Sources::new();
        files::add(&mut sources, &folder.join(FILE))?;
        let Some((file, source)) = sources.iter().next() else { unreachable!("a file was added") };
        match reader::project(file, source.text(), &folder) {
            Ok(project) => Ok(project),
            Err(diagnostics) => {
                Err(ProjectError::Manifest(Box::new(Mistakes { sources, diagnostics })))
            }
        }
    }

    /// All sources: those of the program and of its tests, then those of its libraries.
    ///
    /// # Errors
    ///
    /// At the first that cannot be a source.
    pub fn sources(&self) -> Result<Sources, FilesError> {
        let mut sources = Sources::new();
        for (path, library) in self.files()? {
            let file = files::add(&mut sources, &path)?;
            if library {
                sources.mark_as_library(file);
            }
        }
        Ok(sources)
    }

    /// The files of [`Project::sources`], each with whether it is of a library.
    ///
    /// # Errors
    ///
    /// If a folder cannot be read.
    pub fn files(&self) -> Result<Vec<(PathBuf, bool)>, FilesError> {
        let mut seen = HashSet::new();
        let libraries = distinct(files::list(&self.libraries)?, &mut seen);
        let mut own = self.test_files("st")?;
        own.extend(files::list(&self.sources)?);
        let mut own = distinct(own, &mut seen);
        own.sort();
        let own = own.into_iter().map(|path| (path, false));
        Ok(own.chain(libraries.into_iter().map(|path| (path, true))).collect())
    }

    /// The files in Structured Text that are the author's own, for the formatter.
    ///
    /// # Errors
    ///
    /// As of [`Project::sources`].
    pub fn own_files(&self) -> Result<Vec<PathBuf>, FilesError> {
        let mut seen = HashSet::new();
        let mut own = files::list(&self.sources)?;
        own.extend(self.test_files("st")?);
        own.extend(files::list(&self.libraries)?);
        Ok(distinct(own, &mut seen))
    }

    /// The tables of tests, in the order of their names.
    ///
    /// # Errors
    ///
    /// If a folder cannot be read.
    pub fn tables(&self) -> Result<Vec<PathBuf>, FilesError> {
        self.test_files("csv")
    }

    fn test_files(&self, extension: &str) -> Result<Vec<PathBuf>, FilesError> {
        let mut found = Vec::new();
        for path in &self.tests {
            if path.is_dir() {
                found.extend(files::within(path, extension)?);
            } else if files::has_extension(path, extension) {
                found.push(path.clone());
            }
        }
        Ok(found)
    }
}

/// The paths that lead to files which no other path before them leads to.
fn distinct(paths: Vec<PathBuf>, seen: &mut HashSet<PathBuf>) -> Vec<PathBuf> {
    let real = |path: &PathBuf| path.canonicalize().unwrap_or_else(|_| path.clone());
    paths.into_iter().filter(|path| seen.insert(real(path))).collect()
}

/// Whether a program can have this name.
#[must_use]
pub fn is_program_name(name: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    !name.is_empty() && name.len() <= 64 && name.chars().all(good)
}

#[cfg(test)]
#[path = "manifest_tests.rs"]
mod tests;
