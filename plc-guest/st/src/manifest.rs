//! The project file, `takt-plc.toml`: what belongs to a project, so that commands need no arguments in its folder.

use std::collections::HashSet;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};

use serde::Deserialize;
use takt_program::Version;
use toml::Spanned;

use crate::diagnostic::{Code, Diagnostic, text};
use crate::files::{self, FilesError};
use crate::source::{FileId, Sources, Span};

/// Its name in the project's folder.
pub const FILE: &str = "takt-plc.toml";

const KEYS: &str = "name, version, category, sources, libraries, tests, previous";

/// As it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Raw {
    name: Spanned<String>,
    version: Option<Spanned<String>>,
    category: Option<Spanned<i64>>,
    sources: Option<Vec<Spanned<String>>>,
    libraries: Option<Vec<Spanned<String>>>,
    tests: Option<Vec<Spanned<String>>>,
    previous: Option<Spanned<String>>,
}

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
    /// The project file has a mistake; this is the message about it.
    #[error("{0}")]
    Manifest(String),
    /// A file of the project cannot be read.
    #[error(transparent)]
    Files(#[from] FilesError),
}

/// The file while it is read.
struct Reader<'a> {
    file: FileId,
    folder: &'a Path,
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
    /// If it cannot be read, or at its first mistake.
    pub fn read(folder: &Path) -> Result<Self, ProjectError> {
        // `.` would be in front of all names that are shown.
        let folder: PathBuf =
            folder.components().filter(|part| *part != Component::CurDir).collect();
        let mut sources = Sources::new();
        files::add(&mut sources, &folder.join(FILE))?;
        let Some((file, source)) = sources.iter().next() else { unreachable!("a file was added") };
        let reader = Reader { file, folder: &folder };
        reader.project(source.text()).map_err(|one| {
            ProjectError::Manifest(text::to_string(&sources, &one).trim_end().to_owned())
        })
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

impl Reader<'_> {
    fn project(&self, text: &str) -> Result<Project, Diagnostic> {
        let raw: Raw = toml::from_str(text).map_err(|error| {
            let one = self.wrong(error.span().unwrap_or(0..0), plain(error.message()));
            one.allowed(format!("TOML with the keys {KEYS}"))
        })?;
        let paths = |list: Option<Vec<Spanned<String>>>| -> Result<Vec<PathBuf>, Diagnostic> {
            list.unwrap_or_default().iter().map(|path| self.path(path)).collect()
        };
        let everything = || vec![self.folder.to_owned()];
        let tests = self.folder.join("tests");
        Ok(Project {
            folder: self.folder.to_owned(),
            name: self.name(&raw.name)?,
            version: raw.version.as_ref().map_or(Ok(Version::default()), |it| self.version(it))?,
            category: raw.category.as_ref().map_or(Ok(0), |it| self.category(it))?,
            previous: raw.previous.as_ref().map(|it| self.path(it)).transpose()?,
            sources: if raw.sources.is_some() { paths(raw.sources)? } else { everything() },
            libraries: paths(raw.libraries)?,
            tests: match raw.tests {
                Some(tests) => paths(Some(tests))?,
                None if tests.is_dir() => vec![tests],
                None => Vec::new(),
            },
        })
    }

    fn wrong(&self, at: Range<usize>, found: impl Into<String>) -> Diagnostic {
        let span = Span { file: self.file, start: at.start as u32, end: at.end as u32 };
        Diagnostic::new(Code::ProjectFile, span, found)
    }

    fn name(&self, name: &Spanned<String>) -> Result<String, Diagnostic> {
        let text = name.get_ref();
        if is_program_name(text) {
            return Ok(text.clone());
        }
        let one = self.wrong(name.span(), format!("the name `{}`", text.escape_debug()));
        Err(one.allowed("letters A to Z, digits, _ - and ."))
    }

    fn version(&self, version: &Spanned<String>) -> Result<Version, Diagnostic> {
        let numbers: Option<Vec<u16>> =
            version.get_ref().split('.').map(|number| number.parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[major, minor, patch]) => Ok(Version { major, minor, patch }),
            _ => {
                let found = format!("the version `{}`", version.get_ref().escape_debug());
                let one = self.wrong(version.span(), found);
                Err(one.allowed("three numbers up to 65535, such as `\"1.2.0\"`"))
            }
        }
    }

    fn category(&self, category: &Spanned<i64>) -> Result<u32, Diagnostic> {
        u32::try_from(*category.get_ref()).map_err(|_| {
            let one = self.wrong(category.span(), format!("the category {}", category.get_ref()));
            one.allowed("0 to 4294967295")
        })
    }

    /// A path from the project's folder to something that is there.
    fn path(&self, path: &Spanned<String>) -> Result<PathBuf, Diagnostic> {
        let text = path.get_ref();
        let shown = text.escape_debug();
        if Path::new(text).is_absolute() || text.is_empty() {
            let one = self.wrong(path.span(), format!("the path `{shown}`"));
            return Err(one.allowed("a path from the folder of this file"));
        }
        let whole: PathBuf = self.folder.join(text);
        let whole: PathBuf = whole.components().filter(|part| *part != Component::CurDir).collect();
        // The project's own folder is the current one if nothing is left.
        let there = if whole.as_os_str().is_empty() { Path::new(".") } else { &whole };
        if !there.exists() {
            let one = self.wrong(path.span(), format!("there is no `{shown}` in this folder"));
            return Err(one.allowed("a file or a folder that is there"));
        }
        Ok(whole)
    }
}

/// Whether a program can have this name.
#[must_use]
pub fn is_program_name(name: &str) -> bool {
    let good = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
    !name.is_empty() && name.len() <= 64 && name.chars().all(good)
}

/// What the parser of TOML says, in the words of the file's author.
fn plain(message: &str) -> String {
    let message = message.lines().next().unwrap_or(message);
    message
        .replace("unknown field", "unknown key")
        .replace("missing field", "missing key")
        .replace("invalid type: ", "")
        .replace("a sequence", "a list in square brackets")
        .replace(" i64", " a whole number")
}

#[cfg(test)]
#[path = "manifest_tests.rs"]
mod tests;
