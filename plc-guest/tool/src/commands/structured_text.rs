//! From files in Structured Text to a checked program, for the commands that begin with it.

use std::path::PathBuf;

use takt_st::diagnostic::{json, text};
use takt_st::hir::Program;
use takt_st::{files, project};

use crate::{Failure, status};

/// How messages about sources are written.
#[derive(clap::Args)]
pub struct Messages {
    /// How messages about Structured Text are written: text to the standard error, or one JSON
    /// object a line to the standard output.
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    message_format: Format,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Format {
    Text,
    Json,
}

impl Messages {
    /// Checks all files of a project whose image has this name, and shows what is wrong with them.
    pub fn check(&self, name: &str, paths: &[PathBuf]) -> Result<Program, Failure> {
        let mut sources = files::read(paths).map_err(Failure::input)?;
        let checked = project::check(name, &mut sources).map_err(no_thread)?;
        for one in &checked.diagnostics {
            match self.message_format {
                Format::Text => eprintln!("{}", text::to_string(&sources, one)),
                Format::Json => println!("{}", json::to_string(&sources, one)),
            }
        }
        let errors = checked.diagnostics.iter().filter(|one| one.is_error()).count();
        let warnings = checked.diagnostics.len() - errors;
        let Some(program) = checked.program else {
            return Err(Failure::input(format!("{errors} errors, {warnings} warnings")));
        };
        if warnings > 0 {
            eprintln!("no error, {warnings} warnings");
        }
        Ok(program)
    }
}

/// This machine has no room for a thread.
pub fn no_thread(error: std::io::Error) -> Failure {
    Failure { status: status::HOST_CANNOT, message: format!("cannot start a thread: {error}") }
}
