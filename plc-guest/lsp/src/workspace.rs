//! Which texts belong to one project.
//!
//! A folder with a project file (`takt-plc.toml`) is a project of the files that this file names. Of what is left, a
//! folder that the editor has opened is a project with all files below it that end with `.st`: both are as `takt plc
//! check FOLDER` takes them. Any other file, also one that a project file leaves out, is a project with the files beside
//! it, and a text that is no file is alone.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use lsp_types::Uri;
use takt_st::files::{self, FilesError};
use takt_st::manifest::{self, Mistakes};

use crate::documents::Documents;
use crate::uri::{self, Name};

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
    /// As messages show it.
    pub fn shown(&self) -> String {
        match self {
            Self::Described(folder) | Self::Tree(folder) | Self::Folder(folder) => {
                folder.display().to_string()
            }
            Self::Text(text) => text.clone(),
        }
    }

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

    /// The project of a text: that of the nearest project file above it which takes it, else of the innermost folder.
    pub fn project_of(&self, name: &Name) -> Project {
        let path = match name {
            Name::Other(text) => return Project::Text(text.clone()),
            Name::File(path) => path,
        };
        let described = || path.ancestors().skip(1).filter(|one| manifest::Project::is_in(one));
        if let Some(folder) = described().find(|folder| takes(folder, path)) {
            return Project::Described(folder.to_owned());
        }
        // What a project file leaves out is not of the folders around it either.
        let around = self.folders.iter().filter(|folder| {
            path.starts_with(folder) && !described().any(|inner| inner.starts_with(folder))
        });
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
        let (mut problem, mut mistakes) = (None, None);
        let listed = match project {
            Project::Described(folder) => match manifest::Project::read(folder) {
                Ok(project) => described(&project),
                Err(found) => {
                    problem = Some(found.to_string());
                    let known = found.project.as_deref().map_or_else(|| Ok(Vec::new()), described);
                    mistakes = Some(found);
                    known
                }
            },
            Project::Tree(folder) => {
                files::list(std::slice::from_ref(folder)).all().map(without_libraries)
            }
            Project::Folder(folder) => Ok(without_libraries(beside(folder))),
            Project::Text(_) => Ok(Vec::new()),
        };
        let whole = matches!(project, Project::Described(_));
        match listed {
            Ok(paths) => {
                let names = paths.into_iter().map(|(path, library)| (Name::File(path), library));
                // A file of a folder within may be of another project.
                texts.extend(names.filter(|(name, _)| whole || ours(name)));
            }
            Err(FilesError::Empty { .. }) if !whole => {}
            Err(error) => problem = problem.or_else(|| Some(error.to_string())),
        }
        let mut names: Vec<(Name, bool)> = texts.into_iter().collect();
        names.sort_by_key(|(_, library)| *library);
        Texts { names, problem, mistakes }
    }
}

/// Whether the project file of a folder takes a file: as a source, or as one that is not saved yet. A project file that
/// does not tell where its sources are leaves nothing out.
fn takes(folder: &Path, path: &Path) -> bool {
    let project = match manifest::Project::read(folder) {
        Ok(project) => project,
        Err(mistakes) => match mistakes.project {
            Some(project) => *project,
            None => return true,
        },
    };
    let is_source = files::has_extension(path, "st");
    let mut roots = project.roots().map(called);
    roots.any(|root| path == root || is_source && path.starts_with(root))
}

/// The files that a project file names, each with whether it is of a library.
fn described(project: &manifest::Project) -> Result<Vec<(PathBuf, bool)>, FilesError> {
    let files = project.files()?.into_iter();
    Ok(files.map(|(path, library)| (called(&path), library)).collect())
}

/// What an editor calls a path. Behind a link, `..` leads elsewhere than the words say.
fn called(path: &Path) -> PathBuf {
    let short = uri::normal(path);
    if !path.components().any(|part| part == Component::ParentDir) {
        return short;
    }
    match path.canonicalize() {
        Ok(real) if short.canonicalize().ok().as_ref() != Some(&real) => real,
        _ => short,
    }
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
