//! Which texts belong to one project.
//!
//! A folder with a project file (`takt-plc.toml`) is a project of the files that this file names. Of what is left, a
//! folder that the editor has opened is a project with all files below it that end with `.st`: both are as `takt plc
//! check FOLDER` takes them. Any other file is a project with the files beside it, and a text that is no file is alone.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use lsp_types::Uri;
use takt_st::files::{self, FilesError};
use takt_st::manifest::{self, Mistakes};

use crate::documents::Documents;
use crate::uri::Name;

/// A project.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Project {
    /// A folder with a project file.
    Described(PathBuf),
    /// A folder of the editor, and those within it.
    Tree(PathBuf),
    /// A folder without those within it.
    Folder(PathBuf),
    /// A text that is no file.
    Text(String),
}

impl Project {
    /// The project file, if it has one.
    pub fn file(&self) -> Option<Uri> {
        match self {
            Self::Described(folder) => Name::File(folder.join(manifest::FILE)).uri(),
            _ => None,
        }
    }
}

/// The texts of a project.
#[derive(Debug, Default)]
pub struct Texts {
    /// Each with whether it is of a library.
    pub names: Vec<(Name, bool)>,
    /// Why others may be missing.
    pub problem: Option<String>,
    /// What is wrong with the project file.
    pub mistakes: Option<Box<Mistakes>>,
}

/// The folders that the editor has opened.
#[derive(Debug, Default)]
pub struct Workspace {
    folders: Vec<PathBuf>,
}

impl Workspace {
    /// Adds a folder.
    pub fn add(&mut self, name: &Name) {
        if let Name::File(path) = name
            && !self.folders.contains(path)
        {
            self.folders.push(path.clone());
        }
    }

    /// Removes a folder.
    pub fn remove(&mut self, name: &Name) {
        self.folders.retain(|folder| Name::File(folder.clone()) != *name);
    }

    /// The projects of all folders.
    pub fn projects(&self) -> impl Iterator<Item = Project> {
        self.folders.iter().map(|folder| match manifest::Project::is_in(folder) {
            true => Project::Described(folder.clone()),
            false => Project::Tree(folder.clone()),
        })
    }

    /// The project of a text: that of the nearest project file above it, else of the innermost folder.
    pub fn project_of(&self, name: &Name) -> Project {
        let path = match name {
            Name::Other(text) => return Project::Text(text.clone()),
            Name::File(path) => path,
        };
        let above = path.ancestors().skip(1);
        if let Some(folder) = above.into_iter().find(|folder| manifest::Project::is_in(folder)) {
            return Project::Described(folder.to_owned());
        }
        let around = self.folders.iter().filter(|folder| path.starts_with(folder));
        match around.max_by_key(|folder| folder.components().count()) {
            Some(folder) => Project::Tree(folder.clone()),
            None => Project::Folder(path.parent().unwrap_or(Path::new("/")).to_owned()),
        }
    }

    /// The texts of a project: its own in the order of their names, then those of its libraries.
    pub fn texts(&self, project: &Project, documents: &Documents) -> Texts {
        let ours = |name: &Name| self.project_of(name) == *project;
        let open = documents.names().filter(|name| ours(name)).cloned();
        let mut texts: BTreeMap<Name, bool> = open.map(|name| (name, false)).collect();
        let mut mistakes = None;
        let listed = match project {
            Project::Described(folder) => described(folder, &mut mistakes),
            Project::Tree(folder) => {
                let all = files::list(std::slice::from_ref(folder));
                all.all().map(without_libraries).map_err(|error| match error {
                    FilesError::Empty { .. } => String::new(),
                    error => error.to_string(),
                })
            }
            Project::Folder(folder) => Ok(without_libraries(beside(folder))),
            Project::Text(_) => Ok(Vec::new()),
        };
        let problem = match listed {
            Ok(paths) => {
                let whole = matches!(project, Project::Described(_));
                let names = paths.into_iter().map(|(path, library)| (Name::File(path), library));
                // A file of a folder within may be of another project.
                texts.extend(names.filter(|(name, _)| whole || ours(name)));
                None
            }
            Err(problem) => Some(problem).filter(|problem| !problem.is_empty()),
        };
        let mut names: Vec<(Name, bool)> = texts.into_iter().collect();
        names.sort_by_key(|(_, library)| *library);
        Texts { names, problem, mistakes }
    }
}

/// The files that a project file names. What is wrong with it is told at its places too.
fn described(
    folder: &Path,
    mistakes: &mut Option<Box<Mistakes>>,
) -> Result<Vec<(PathBuf, bool)>, String> {
    let project = manifest::Project::read(folder).map_err(|found| {
        let text = found.to_string();
        *mistakes = Some(found);
        text
    })?;
    let files = project.files().map_err(|error| error.to_string())?;
    Ok(files.into_iter().map(|(path, library)| (crate::uri::normal(&path), library)).collect())
}

fn without_libraries(paths: Vec<PathBuf>) -> Vec<(PathBuf, bool)> {
    paths.into_iter().map(|path| (path, false)).collect()
}

/// The sources of a folder that can be read.
fn beside(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let paths = entries.map(|entry| entry.path());
    paths.filter(|path| files::has_extension(path, "st") && path.is_file()).collect()
}
