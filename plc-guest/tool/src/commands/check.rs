//! `takt plc check`: all mistakes of a project in Structured Text, without building it.

use std::path::PathBuf;

use super::structured_text::Messages;
use crate::Failure;

/// Arguments of `check`.
#[derive(clap::Args)]
pub struct Check {
    /// Sources, and folders of which all files that end with .st are taken.
    #[arg(required = true)]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    messages: Messages,
}

impl Check {
    pub fn run(self) -> Result<(), Failure> {
        self.messages.check("check", &self.paths).map(drop)
    }
}
