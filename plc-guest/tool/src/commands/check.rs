//! `takt plc check`: all mistakes of a project in Structured Text, without building it.

use std::path::PathBuf;

use takt_st::diagnostic::{json, text};
use takt_st::{files, project};

use crate::{Failure, status};

/// Arguments of `check`.
#[derive(clap::Args)]
pub struct Check {
    /// Sources, and folders of which all files that end with .st are taken.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    /// How messages are written: text to the standard error, or one JSON object a line to the
    /// standard output.
    #[arg(long, value_name = "FORMAT", default_value = "text")]
    message_format: Format,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Format {
    Text,
    Json,
}

impl Check {
    pub fn run(self) -> Result<(), Failure> {
        let mut sources = files::read(&self.paths).map_err(Failure::input)?;
        let no_thread = |error| Failure {
            status: status::HOST_CANNOT,
            message: format!("cannot start a thread: {error}"),
        };
        let checked = project::check("check", &mut sources).map_err(no_thread)?;
        for one in &checked.diagnostics {
            match self.message_format {
                Format::Text => eprintln!("{}", text::to_string(&sources, one)),
                Format::Json => println!("{}", json::to_string(&sources, one)),
            }
        }
        let errors = checked.diagnostics.iter().filter(|one| one.is_error()).count();
        let warnings = checked.diagnostics.len() - errors;
        if errors > 0 {
            return Err(Failure::input(format!("{errors} errors, {warnings} warnings")));
        }
        if warnings > 0 {
            eprintln!("no error, {warnings} warnings");
        }
        Ok(())
    }
}
