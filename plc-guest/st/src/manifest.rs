//! The project file, `takt-plc.toml`: what belongs to a project, so that commands need no arguments in its folder.

mod reader;

use std::collections::HashSet;
use std::fmt;
use std::path::{Component, Path, PathBuf};

use takt_program::Version;

use crate::diagnostic::{Diagnostic, text};
use crate::files::{self, FilesError, Listed};
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

/// The messages about a project file, with its text.
#[derive(Debug)]
pub struct Mistakes {
    /// The file, alone.
    pub sources: Sources,
    /// What is wrong with it, by place.
    pub diagnostics: Vec<Diagnostic>,
    /// The project with what is understood, if that tells where all its sources are.
    pub project: Option<Box<Project>>,
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
    pub fn read(folder: &Path) -> Result<Self, Box<Mistakes>> {
        // `.` would be in front of all names that are shown.
        let folder: PathBuf =
            folder.components().filter(|part| *part != Component::CurDir).collect();
        let mut sources = Sources::new();
        let Some(file) = files::add(&mut sources, &folder.join(FILE)) else {
            let diagnostics = sources.refused().to_vec();
            return Err(Box::new(Mistakes { sources, diagnostics, project: None }));
        };
        let (project, diagnostics) = reader::project(file, sources.get(file).text(), &folder);
        match project {
            Some(project) if diagnostics.is_empty() => Ok(project),
            project => {
                let project = project.map(Box::new);
                Err(Box::new(Mistakes { sources, diagnostics, project }))
            }
        }
    }

    /// All sources: those of the program and of its tests, then those of its libraries. What cannot be read is a
    /// message of theirs.
    #[must_use]
    pub fn sources(&self) -> Sources {
        let mut sources = Sources::new();
        let (files, refused) = self.listed();
        for (path, library) in files {
            if let Some(file) = files::add(&mut sources, &path)
                && library
            {
                sources.mark_as_library(file);
            }
        }
        files::refuse(&mut sources, &refused);
        sources
    }

    /// The files of [`Project::sources`], each with whether it is of a library.
    ///
    /// # Errors
    ///
    /// If a folder cannot be read.
    pub fn files(&self) -> Result<Vec<(PathBuf, bool)>, FilesError> {
        let (files, refused) = self.listed();
        Listed { files: Vec::new(), refused }.all()?;
        Ok(files)
    }

    fn listed(&self) -> (Vec<(PathBuf, bool)>, Vec<FilesError>) {
        let mut seen = HashSet::new();
        let libraries = files::list(&self.libraries);
        let tests = self.test_files("st");
        let sources = files::list(&self.sources);
        let of_libraries = distinct(libraries.files, &mut seen);
        let mut own = tests.files;
        own.extend(sources.files);
        let mut own = distinct(own, &mut seen);
        own.sort();
        let own = own.into_iter().map(|path| (path, false));
        let files = own.chain(of_libraries.into_iter().map(|path| (path, true))).collect();
        // A folder of tests is often within that of the sources.
        let mut told = HashSet::new();
        let mut refused = sources.refused;
        refused.extend(tests.refused);
        refused.extend(libraries.refused);
        refused.retain(|error| told.insert(error.path().to_owned()));
        (files, refused)
    }

    /// The files in Structured Text that are the author's own, for the formatter: a library is of other projects too.
    ///
    /// # Errors
    ///
    /// As of [`Project::files`].
    pub fn own_files(&self) -> Result<Vec<PathBuf>, FilesError> {
        let own = self.files()?.into_iter().filter(|(_, library)| !library);
        Ok(own.map(|(path, _)| path).collect())
    }

    /// The files and folders that the project file names, in which its sources are.
    pub fn roots(&self) -> impl Iterator<Item = &Path> {
        [&self.sources, &self.tests, &self.libraries].into_iter().flatten().map(PathBuf::as_path)
    }

    /// The tables of tests, in the order of their names.
    ///
    /// # Errors
    ///
    /// If a folder cannot be read.
    pub fn tables(&self) -> Result<Vec<PathBuf>, FilesError> {
        self.test_files("csv").all()
    }

    fn test_files(&self, extension: &str) -> Listed {
        let mut found = Listed::default();
        for path in &self.tests {
            if path.is_dir() {
                let within = files::within(path, extension);
                found.files.extend(within.files);
                found.refused.extend(within.refused);
            } else if files::has_extension(path, extension) {
                found.files.push(path.clone());
            }
        }
        found
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
