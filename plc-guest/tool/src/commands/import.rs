//! `takt plc import`: the Structured Text of a PLCopen XML project.

use std::path::PathBuf;

use super::output::folder;
use super::{read, write};
use crate::{Failure, status};

/// Arguments of `import`.
#[derive(clap::Args)]
pub struct Import {
    /// The project, as another tool exported it.
    project: PathBuf,
    /// The folder that the source files go to; it is made, and must not be there yet.
    folder: PathBuf,
}

impl Import {
    pub fn run(self) -> Result<(), Failure> {
        let project = self.project.display();
        let text = String::from_utf8(read(&self.project)?)
            .map_err(|error| Failure::input(format!("{project} is no text: {error}")))?;
        let import = takt_plcopen::import(&text)
            .map_err(|error| Failure::input(format!("{project}: {error}")))?;
        if import.files.is_empty() && import.refused.is_empty() {
            let message = format!("{project}: found no types, units, variables or configurations");
            return Err(Failure::input(message));
        }
        let paths = || import.files.iter().map(|file| self.folder.join(&file.name));
        // It is a new one: nothing of what is there can be lost.
        folder(&self.folder, || {
            let mut files = paths().zip(&import.files);
            files.try_for_each(|(path, file)| write(&path, file.text.as_bytes()))
        })?;
        paths().for_each(|path| println!("{}", path.display()));
        for name in &import.ignored {
            tell!("takt plc: {project}: ignored: {}", name.escape_debug());
        }
        for defect in &import.refused {
            tell!("takt plc: {project}:{defect}");
        }
        if import.further > 0 {
            tell!("takt plc: {project}: {} parts more were refused", import.further);
        }
        match import.refused.len() + import.further {
            0 => Ok(()),
            refused => Err(Failure {
                status: status::NOT_AS_EXPECTED,
                message: format!(
                    "{project}: {refused} parts were refused, the rest is in {}",
                    self.folder.display()
                ),
            }),
        }
    }
}
