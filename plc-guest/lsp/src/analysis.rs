//! One project as it is now: its texts, what is wrong with them, and what each name means.

use std::fs;
use std::io::Read;

use lsp_types::{Location, Position, Range, Uri};
use takt_st::diagnostic::Diagnostic;
use takt_st::hir::Program;
use takt_st::manifest::Mistakes;
use takt_st::query::Index;
use takt_st::source::{FileId, Sources, Span};
use takt_st::{build, limits, project, stack};

use crate::documents::{Documents, LOST};
use crate::position::Lines;
use crate::uri::Name;
use crate::workspace::{Project, Texts, Workspace};

/// The bytes of all texts of a project that are read.
const PROJECT_BYTES: usize = 64 << 20;

/// The bytes of all texts up to which a project is compiled too after each change: a tenth of a second.
const COMPILED_BYTES: usize = 256 << 10;

/// One text of the project.
#[derive(Debug)]
pub struct File {
    /// What the client calls it, or would.
    pub uri: Uri,
    /// Its state in the editor; none if it is not open.
    pub version: Option<i32>,
    /// Its number in the sources.
    pub id: FileId,
    /// Which text it is.
    pub name: Name,
    lines: Lines,
}

/// A project that was read and checked.
#[derive(Debug)]
pub struct Analysis {
    /// The texts, and those of the library behind them.
    pub sources: Sources,
    /// The texts of the project, in the order of `sources`.
    pub files: Vec<File>,
    /// What each name means.
    pub index: Index,
    /// What is wrong.
    pub diagnostics: Vec<Diagnostic>,
    /// Texts that cannot be sources, with the reason.
    pub left_out: Vec<(Uri, String)>,
    /// Why texts may be missing.
    pub problem: Option<String>,
    /// What is wrong with the project file, if anything is.
    pub mistakes: Option<(Uri, Box<Mistakes>)>,
}

impl Analysis {
    /// Reads and checks a project.
    ///
    /// # Errors
    ///
    /// If the system has no room for a thread.
    pub fn new(
        workspace: &Workspace,
        documents: &Documents,
        project: &Project,
    ) -> std::io::Result<Self> {
        let Texts { names, mut problem, mistakes } = workspace.texts(project, documents);
        let (mut sources, mut files, mut left_out) = (Sources::new(), Vec::new(), Vec::new());
        let mut room = PROJECT_BYTES;
        for (name, library) in names {
            let document = documents.get(&name);
            let Some(uri) = document.map(|open| open.uri.clone()).or_else(|| name.uri()) else {
                problem = Some(format!("{} has no address that an editor knows", name.shown()));
                continue;
            };
            let read = match document {
                Some(open) => open.text.clone().map(String::into_bytes).ok_or(LOST.to_owned()),
                None => on_disk(&name),
            };
            let added = read.and_then(|bytes| {
                room = room.checked_sub(bytes.len()).ok_or_else(|| {
                    format!("left out: the project has more than {PROJECT_BYTES} bytes")
                })?;
                sources.add(&name.shown(), &bytes).map_err(|error| error.to_string())
            });
            match added {
                Ok(id) => {
                    if library {
                        sources.mark_as_library(id);
                    }
                    let lines = Lines::new(sources.get(id).text());
                    let version = document.map(|open| open.version);
                    files.push(File { uri, version, id, name, lines });
                }
                Err(reason) => left_out.push((uri, reason)),
            }
        }
        let checked = project::check_all("check", &mut sources)?;
        let index = Index::new(&sources, files.len())?;
        let mistakes = mistakes.zip(project.file()).map(|(mistakes, uri)| (uri, mistakes));
        let mut diagnostics = checked.diagnostics;
        if let Some(program) = checked.program.filter(|_| PROJECT_BYTES - room <= COMPILED_BYTES) {
            diagnostics.extend(beyond_check(&program, &sources)?);
        }
        Ok(Self { sources, files, index, diagnostics, left_out, problem, mistakes })
    }

    /// Why a part of the project is not seen, if there is one.
    pub fn unseen(&self) -> Option<String> {
        let left_out = self.left_out.first();
        let left_out = left_out.map(|(uri, reason)| format!("{}: {reason}", uri.as_str()));
        left_out.or_else(|| self.problem.clone())
    }

    /// The text of this name.
    pub fn file(&self, name: &Name) -> Option<&File> {
        self.files.iter().find(|file| file.name == *name)
    }

    /// The text that a place is in; none for the library.
    pub fn file_of(&self, span: Span) -> Option<&File> {
        self.files.get(span.file.index())
    }

    /// The byte at a position.
    pub fn offset(&self, file: &File, position: Position) -> u32 {
        file.lines.offset(self.sources.get(file.id).text(), position) as u32
    }

    /// A place in a text, from line and column to line and column.
    pub fn range(&self, file: &File, span: Span) -> Range {
        let text = self.sources.get(file.id).text();
        file.lines.range(text, span.start as usize..span.end as usize)
    }

    /// A place with its file; none in the library.
    pub fn location(&self, span: Span) -> Option<Location> {
        let file = self.file_of(span)?;
        Some(Location { uri: file.uri.clone(), range: self.range(file, span) })
    }
}

/// What only compiling finds, such as a stack that is too large.
fn beyond_check(program: &Program, sources: &Sources) -> std::io::Result<Option<Diagnostic>> {
    let built = stack::with_room(|| build::try_build(program))?;
    Ok(built.err().map(|error| error.diagnostic(program, sources)))
}

/// The bytes of a file that is not open.
fn on_disk(name: &Name) -> Result<Vec<u8>, String> {
    let Name::File(path) = name else { return Err("it is not open".into()) };
    let mut bytes = Vec::new();
    // One byte more than allowed is enough to know that it is too large.
    fs::File::open(path)
        .and_then(|file| file.take(limits::FILE_BYTES as u64 + 1).read_to_end(&mut bytes))
        .map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    Ok(bytes)
}
