//! `takt plc check`: all mistakes of a project in Structured Text, without building it.

use std::path::PathBuf;

use super::structured_text::{Messages, Origin};
use crate::Failure;

/// Arguments of `check`.
#[derive(clap::Args)]
pub struct Check {
    /// Sources, and folders of which all files that end with .st are taken. A folder with a project file
    /// (takt-plc.toml) is taken as a project; without any, the current folder is.
    paths: Vec<PathBuf>,
    #[command(flatten)]
    messages: Messages,
}

impl Check {
    pub fn run(self) -> Result<(), Failure> {
        self.messages.all(&Origin::of(&self.paths, &self.messages)?)
    }
}
