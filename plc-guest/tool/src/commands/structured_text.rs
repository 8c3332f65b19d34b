//! From files in Structured Text to a checked program, for the commands that begin with it.

use std::io::Write;
use std::path::{Path, PathBuf};

use takt_st::diagnostic::{Diagnostic, Diagnostics, json, text};
use takt_st::hir::Program;
use takt_st::manifest::{self, Project, ProjectError};
use takt_st::source::Sources;
use takt_st::syntax::lexer::Lexer;
use takt_st::syntax::parser;
use takt_st::syntax::token::TokenKind;
use takt_st::{files, project, stack};

use crate::{Failure, status};

/// Where sources come from.
pub enum Origin {
    /// A folder with a project file.
    Project(Box<Project>),
    /// Files, and folders of which all sources are taken.
    Paths(Vec<PathBuf>),
}

/// How messages about sources are written.
#[derive(Default, clap::Args)]
pub struct Messages {
    /// How messages about Structured Text are written: text to the standard error, or one JSON
    /// object a line to the standard output.
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    message_format: Format,
}

#[derive(Clone, Copy, Default, clap::ValueEnum)]
enum Format {
    #[default]
    Text,
    Json,
}

/// Whether a path is one of Structured Text: a folder or a file that ends with `.st`.
pub fn is_text(path: &Path) -> bool {
    files::has_extension(path, "st") || path.is_dir()
}

impl Origin {
    /// What these arguments mean: none is the project in the current folder. Mistakes in its project file are shown
    /// like those in sources.
    pub fn of(paths: &[PathBuf], messages: &Messages) -> Result<Self, Failure> {
        let folder = match paths {
            [] => Path::new(""),
            [one] if one.is_dir() => one,
            _ => return Ok(Self::Paths(paths.to_vec())),
        };
        if Project::is_in(folder) {
            return match Project::read(folder) {
                Ok(project) => Ok(Self::Project(Box::new(project))),
                Err(ProjectError::Manifest(mistakes)) => {
                    messages.show(&mistakes.sources, &mistakes.diagnostics);
                    let errors = mistakes.diagnostics.len();
                    Err(Failure::input(format!("{errors} errors in the project file")))
                }
                Err(error) => Err(Failure::input(error)),
            };
        }
        match paths {
            [] => Err(Failure::input(format!(
                "found no {} in this folder; name files or folders, or begin a project with \
                 `takt plc new NAME --lang st`",
                manifest::FILE
            ))),
            paths => Ok(Self::Paths(paths.to_vec())),
        }
    }

    /// The project, if it is one.
    pub fn project(&self) -> Option<&Project> {
        match self {
            Self::Project(project) => Some(project),
            Self::Paths(_) => None,
        }
    }

    /// All sources.
    fn sources(&self) -> Result<Sources, Failure> {
        match self {
            Self::Project(project) => project.sources(),
            Self::Paths(paths) => files::read(paths),
        }
        .map_err(Failure::input)
    }

    /// The files that the user writes.
    pub fn files(&self) -> Result<Vec<PathBuf>, Failure> {
        match self {
            Self::Project(project) => project.own_files(),
            Self::Paths(paths) => files::list(paths),
        }
        .map_err(Failure::input)
    }
}

impl Messages {
    /// Checks the program of a project, which has this name if the project file gives it none, and shows what is
    /// wrong with it.
    pub fn program(&self, name: &str, origin: &Origin) -> Result<Program, Failure> {
        let mut sources = origin.sources()?;
        let checked = project::check(name, &mut sources).map_err(no_thread)?;
        self.show(&sources, &checked.diagnostics);
        finish(origin, checked.program, &checked.diagnostics)
    }

    /// The same with tests.
    pub fn tests(&self, name: &str, origin: &Origin) -> Result<Program, Failure> {
        let mut sources = origin.sources()?;
        let checked = project::check_tests(name, &mut sources).map_err(no_thread)?;
        self.show(&sources, &checked.diagnostics);
        finish(origin, checked.program, &checked.diagnostics)
    }

    /// Checks the program, and if that is good and there are tests, all once more with the tests: the program must do
    /// without what the files of tests declare.
    pub fn all(&self, origin: &Origin) -> Result<(), Failure> {
        let mut sources = origin.sources()?;
        let checked = project::check("check", &mut sources).map_err(no_thread)?;
        if checked.program.is_some() && checked.tests {
            return self.tests("check", origin).map(drop);
        }
        self.show(&sources, &checked.diagnostics);
        finish(origin, checked.program, &checked.diagnostics).map(drop)
    }

    /// Prints what the first stages make of the files: words, or trees.
    pub fn syntax(&self, origin: &Origin, trees: bool) -> Result<(), Failure> {
        let sources = origin.sources()?;
        let mut diagnostics = Diagnostics::new();
        let text = stack::with_room(|| {
            let mut text = String::new();
            for (file, source) in sources.iter() {
                text.push_str(&format!("// {}\n", source.name()));
                if trees {
                    let tree = parser::parse(file, &sources, &mut diagnostics);
                    text.push_str(&format!("{tree:#?}\n"));
                    continue;
                }
                let mut lexer = Lexer::new(file, source);
                loop {
                    let token = lexer.next_token(&mut diagnostics);
                    if token.kind == TokenKind::End {
                        break;
                    }
                    let (place, word) = (sources.position(token.span), sources.text(token.span));
                    text.push_str(&format!("{place} {:?} {}\n", token.kind, word.escape_debug()));
                }
            }
            text
        });
        // A reader that has seen enough may close its end.
        let _ = std::io::stdout().write_all(text.map_err(no_thread)?.as_bytes());
        let diagnostics = diagnostics.sorted();
        self.show(&sources, &diagnostics);
        match diagnostics.iter().filter(|one| one.is_error()).count() {
            0 => Ok(()),
            errors => Err(Failure::input(format!("{errors} errors"))),
        }
    }

    fn show(&self, sources: &Sources, diagnostics: &[Diagnostic]) {
        for one in diagnostics {
            match self.message_format {
                Format::Text => eprintln!("{}", text::to_string(sources, one)),
                Format::Json => println!("{}", json::to_string(sources, one)),
            }
        }
    }
}

fn finish(
    origin: &Origin,
    program: Option<Program>,
    diagnostics: &[Diagnostic],
) -> Result<Program, Failure> {
    let errors = diagnostics.iter().filter(|one| one.is_error()).count();
    let warnings = diagnostics.len() - errors;
    let Some(mut program) = program else {
        return Err(Failure::input(format!("{errors} errors, {warnings} warnings")));
    };
    if warnings > 0 {
        eprintln!("no error, {warnings} warnings");
    }
    if let Some(project) = origin.project() {
        program.name.clone_from(&project.name);
        (program.version, program.category) = (project.version, project.category);
    }
    Ok(program)
}

/// This machine has no room for a thread.
pub fn no_thread(error: std::io::Error) -> Failure {
    Failure { status: status::HOST_CANNOT, message: format!("cannot start a thread: {error}") }
}
