//! From files in Structured Text to a checked program, for the commands that begin with it.

use std::io::Write;
use std::path::{Path, PathBuf};

use takt_st::build::{self, BuildError, Built};
use takt_st::diagnostic::{Code, Diagnostic, Diagnostics, json, text};
use takt_st::hir::Program;
use takt_st::manifest::{self, Mistakes, Project};
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
    /// A folder with a project file that has mistakes, which have been shown.
    Broken(Box<Mistakes>),
    /// Files, and folders of which all sources are taken.
    Paths(Vec<PathBuf>),
}

/// A program without an error, with its sources.
pub struct Good {
    pub program: Program,
    pub sources: Sources,
}

impl Good {
    /// The files that it is made of, which no output may replace.
    pub fn files(&self, origin: &Origin) -> Vec<PathBuf> {
        let project = origin.project().map(|project| project.folder.join(manifest::FILE));
        let sources = self.sources.iter().map(|(_, source)| PathBuf::from(source.name()));
        project.into_iter().chain(sources).collect()
    }
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
            return Ok(match Project::read(folder) {
                Ok(project) => Self::Project(Box::new(project)),
                Err(mistakes) => {
                    messages.show(&mistakes.sources, &mistakes.diagnostics);
                    Self::Broken(mistakes)
                }
            });
        }
        match paths {
            [] => {
                let mut none = Sources::new();
                none.refuse(".", None, |span| {
                    let found = format!("found no {} in this folder", manifest::FILE);
                    Diagnostic::new(Code::NoSource, span, found)
                        .allowed("files and folders as arguments, or a project in this folder")
                        .hint("begin a project with `takt plc new NAME --lang st`")
                });
                Err(messages.refused(&none))
            }
            paths => Ok(Self::Paths(paths.to_vec())),
        }
    }

    /// The project, if it is one without a mistake in its file.
    pub fn project(&self) -> Option<&Project> {
        match self {
            Self::Project(project) => Some(project),
            Self::Broken(_) | Self::Paths(_) => None,
        }
    }

    /// How many mistakes the project file has.
    fn mistakes(&self) -> usize {
        match self {
            Self::Broken(mistakes) => mistakes.diagnostics.len(),
            Self::Project(_) | Self::Paths(_) => 0,
        }
    }

    /// All sources, as far as it is known where they are.
    fn sources(&self) -> Result<Sources, Failure> {
        match self {
            Self::Project(project) => Ok(project.sources()),
            Self::Broken(mistakes) => match &mistakes.project {
                Some(project) => Ok(project.sources()),
                None => Err(self.broken()),
            },
            Self::Paths(paths) => Ok(files::read(paths)),
        }
    }

    fn broken(&self) -> Failure {
        Failure::input(format!("{} in the project file", counted(self.mistakes(), "error")))
    }

    /// The files that the user writes.
    pub fn files(&self) -> Result<Vec<PathBuf>, Failure> {
        match self {
            Self::Project(project) => project.own_files(),
            Self::Broken(_) => return Err(self.broken()),
            Self::Paths(paths) => files::list(paths).all(),
        }
        .map_err(Failure::input)
    }
}

impl Messages {
    /// Checks the program of a project, which has this name if the project file gives it none, and shows what is
    /// wrong with it.
    pub fn program(&self, name: &str, origin: &Origin) -> Result<Good, Failure> {
        let mut sources = origin.sources()?;
        let checked = project::check(name, &mut sources).map_err(no_thread)?;
        self.show(&sources, &checked.diagnostics);
        let program = finish(origin, checked.program, &checked.diagnostics)?;
        Ok(Good { program, sources })
    }

    /// The same with tests.
    pub fn tests(&self, name: &str, origin: &Origin) -> Result<Good, Failure> {
        let mut sources = origin.sources()?;
        let checked = project::check_tests(name, &mut sources).map_err(no_thread)?;
        self.show(&sources, &checked.diagnostics);
        let program = finish(origin, checked.program, &checked.diagnostics)?;
        Ok(Good { program, sources })
    }

    /// Checks the program, and if that is good, whether it can be built; and if there are tests, all once more with
    /// them: the program must do without what the files of tests declare.
    pub fn all(&self, origin: &Origin) -> Result<(), Failure> {
        let mut sources = origin.sources()?;
        let checked = project::check("check", &mut sources).map_err(no_thread)?;
        if let Some(program) = &checked.program {
            let built = stack::with_room(|| build::try_build(program)).map_err(no_thread)?;
            if let Err(error) = built {
                self.show(&sources, &checked.diagnostics);
                return Err(self.not_built(program, &sources, &error));
            }
            if checked.tests {
                return self.tests("check", origin).map(drop);
            }
        }
        self.show(&sources, &checked.diagnostics);
        finish(origin, checked.program, &checked.diagnostics).map(drop)
    }

    /// Compiles a program and makes its image.
    pub fn build(&self, good: &Good) -> Result<Built, Failure> {
        let built = stack::with_room(|| build::build(&good.program)).map_err(no_thread)?;
        built.map_err(|error| self.not_built(&good.program, &good.sources, &error))
    }

    fn not_built(&self, program: &Program, sources: &Sources, error: &BuildError) -> Failure {
        self.show(sources, &[error.diagnostic(program, sources)]);
        Failure::input("1 error: no image")
    }

    /// Shows what is no source.
    pub fn refused(&self, sources: &Sources) -> Failure {
        self.show(sources, sources.refused());
        Failure::input(counted(sources.refused().len(), "error"))
    }

    /// Prints what the first stages make of the files: words, or trees.
    pub fn syntax(&self, origin: &Origin, trees: bool) -> Result<(), Failure> {
        let sources = origin.sources()?;
        let mut diagnostics = Diagnostics::new();
        sources.refused().iter().for_each(|one| diagnostics.push(one.clone()));
        let text = stack::with_room(|| {
            let mut text = String::new();
            for (file, source) in sources.iter().filter(|(_, source)| source.is_read()) {
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
            errors => Err(Failure::input(counted(errors, "error"))),
        }
    }

    fn show(&self, sources: &Sources, diagnostics: &[Diagnostic]) {
        for one in diagnostics {
            match self.message_format {
                Format::Text => tell!("{}", text::to_string(sources, one)),
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
    let errors = errors + origin.mistakes();
    let Some(mut program) = program.filter(|_| errors == 0) else {
        let (errors, warnings) = (counted(errors, "error"), counted(warnings, "warning"));
        return Err(Failure::input(format!("{errors}, {warnings}")));
    };
    if warnings > 0 {
        tell!("no error, {}", counted(warnings, "warning"));
    }
    if let Some(project) = origin.project() {
        program.name.clone_from(&project.name);
        (program.version, program.category) = (project.version, project.category);
    }
    Ok(program)
}

/// A number of things, such as `1 error`, `2 errors`.
fn counted(number: usize, thing: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {thing}{plural}")
}

/// This machine has no room for a thread.
pub fn no_thread(error: std::io::Error) -> Failure {
    Failure { status: status::HOST_CANNOT, message: format!("cannot start a thread: {error}") }
}
