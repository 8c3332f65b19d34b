//! Which texts belong to one project.
//!
//! A folder that the editor has opened is a project with all files below it that end with `.st`, as
//! `takt plc check FOLDER` takes them. A file outside of such folders is a project with the files beside it. A text that
//! is no file is alone.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use takt_st::files::{self, FilesError};

use crate::documents::Documents;
use crate::uri::Name;

/// A project.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Project {
    /// A folder of the editor, and those within it.
    Tree(PathBuf),
    /// A folder without those within it.
    Folder(PathBuf),
    /// A text that is no file.
    Text(String),
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
        self.folders.iter().map(|folder| Project::Tree(folder.clone()))
    }

    /// The project of a text: of folders within each other the innermost.
    pub fn project_of(&self, name: &Name) -> Project {
        let path = match name {
            Name::Other(text) => return Project::Text(text.clone()),
            Name::File(path) => path,
        };
        let around = self.folders.iter().filter(|folder| path.starts_with(folder));
        match around.max_by_key(|folder| folder.components().count()) {
            Some(folder) => Project::Tree(folder.clone()),
            None => Project::Folder(path.parent().unwrap_or(Path::new("/")).to_owned()),
        }
    }

    /// The texts of a project in the order of their names, and why others may be missing.
    pub fn texts(&self, project: &Project, documents: &Documents) -> (Vec<Name>, Option<String>) {
        let open = documents.names().filter(|name| self.project_of(name) == *project).cloned();
        let mut texts: BTreeSet<Name> = open.collect();
        let listed = match project {
            Project::Tree(folder) => files::list(std::slice::from_ref(folder)),
            Project::Folder(folder) => Ok(beside(folder)),
            Project::Text(_) => Ok(Vec::new()),
        };
        let problem = match listed {
            Ok(paths) => {
                // A file of a folder within may be of another project.
                let names = paths.into_iter().map(Name::File);
                texts.extend(names.filter(|name| self.project_of(name) == *project));
                None
            }
            Err(FilesError::Empty { .. }) => None,
            Err(error) => Some(error.to_string()),
        };
        (texts.into_iter().collect(), problem)
    }
}

/// The sources of a folder that can be read.
fn beside(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let paths = entries.map(|entry| entry.path());
    let is_source = |path: &PathBuf| {
        path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("st"))
            && path.is_file()
    };
    paths.filter(is_source).collect()
}
