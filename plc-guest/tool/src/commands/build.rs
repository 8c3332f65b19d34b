//! `takt plc build`: object files and static libraries become an image.

use std::path::PathBuf;

use super::{image, write};
use crate::{Failure, link};

/// Arguments of `build`.
#[derive(clap::Args)]
pub struct Build {
    /// Object files (.o) and static libraries (.a).
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Where to write the image.
    #[arg(short, long, value_name = "IMAGE")]
    output: PathBuf,
}

impl Build {
    pub fn run(self) -> Result<(), Failure> {
        let structured_text = self.inputs.iter().find(|input| {
            input.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("st"))
        });
        if let Some(path) = structured_text {
            let what = "this takt plc has no compiler for Structured Text";
            return Err(Failure::input(format!("{}: {what}", path.display())));
        }
        let bytes = link::build(&self.inputs).map_err(Failure::input)?;
        let image = image(&self.output, &bytes)?;
        write(&self.output, &bytes)?;
        println!(
            "{}: {} {}, {} bytes of code, {} of constants, {} of state, {} tasks, {} points",
            self.output.display(),
            image.name(),
            image.version(),
            image.code().len(),
            image.constants().len(),
            image.state_bytes(),
            image.tasks().len(),
            image.variables().len(),
        );
        Ok(())
    }
}
