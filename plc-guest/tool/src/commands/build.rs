//! `takt plc build`: sources in Structured Text, or object files and static libraries, become an image.

use std::io::Write;
use std::path::{Path, PathBuf};

use takt_st::{build, hir, native, stack};

use super::structured_text::{Messages, no_thread};
use super::{image, write};
use crate::{Failure, link};

/// Arguments of `build`.
#[derive(clap::Args)]
pub struct Build {
    /// Files in Structured Text (.st) and folders of which all such files are taken; or object files (.o) and
    /// static libraries (.a).
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// Where to write the image. A program in Structured Text has its name from this file; without it, from the
    /// first input, and the image is written to NAME.plc.
    #[arg(short, long, value_name = "IMAGE")]
    output: Option<PathBuf>,
    /// Print a stage of the compiler for Structured Text instead of writing an image.
    #[arg(long, value_enum, value_name = "STAGE", conflicts_with = "output")]
    emit: Option<Stage>,
    #[command(flatten)]
    messages: Messages,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Stage {
    /// The program with all types, conversions and places written out.
    Types,
    /// The code of each routine as Cranelift gets it.
    Ir,
}

impl Build {
    pub fn run(self) -> Result<(), Failure> {
        let is_text = |input: &&PathBuf| {
            input.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("st"))
                || input.is_dir()
        };
        match self.inputs.iter().filter(is_text).count() {
            0 => self.link(),
            texts if texts == self.inputs.len() => self.compile(),
            _ => Err(Failure::input(
                "found Structured Text and other files; an image is made of one or the other",
            )),
        }
    }

    fn link(&self) -> Result<(), Failure> {
        if self.emit.is_some() {
            return Err(Failure::input("--emit is for Structured Text (.st)"));
        }
        let Some(output) = &self.output else {
            return Err(Failure::input("say where to write the image with -o IMAGE"));
        };
        finish(output, &link::build(&self.inputs).map_err(Failure::input)?)
    }

    fn compile(&self) -> Result<(), Failure> {
        let name = self.name()?;
        let program = self.messages.check(&name, &self.inputs)?;
        match self.emit {
            Some(stage) => {
                let text = stack::with_room(|| match stage {
                    Stage::Types => hir::print(&program),
                    Stage::Ir => native::intermediate(&program),
                });
                // A reader that has seen enough may close its end.
                let _ = std::io::stdout().write_all(text.map_err(no_thread)?.as_bytes());
                Ok(())
            }
            None => {
                let built = stack::with_room(|| build::build(&program)).map_err(no_thread)?;
                let output = self.output.clone().unwrap_or_else(|| format!("{name}.plc").into());
                finish(&output, &built.map_err(Failure::input)?.image)
            }
        }
    }

    /// The name of a program in Structured Text.
    fn name(&self) -> Result<String, Failure> {
        let file = match (&self.output, &self.inputs[0]) {
            (Some(output), _) => output.file_stem().map(ToOwned::to_owned),
            // `.` and `..` have no name of their own.
            (None, input) if input.is_dir() => {
                input.canonicalize().ok().and_then(|path| path.file_name().map(ToOwned::to_owned))
            }
            (None, input) => input.file_stem().map(ToOwned::to_owned),
        };
        let name = file.unwrap_or_default().to_string_lossy().into_owned();
        let good = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        if name.is_empty() || !name.chars().all(good) {
            let allowed = "a program's name has the letters A to Z, digits, _ - and .";
            return Err(Failure::input(format!("found `{name}`; {allowed}: give one with -o")));
        }
        Ok(name)
    }
}

/// Writes the image and says what it is.
fn finish(output: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let image = image(output, bytes)?;
    write(output, bytes)?;
    println!(
        "{}: {} {}, {} bytes of code, {} of constants, {} of state, {} tasks, {} points",
        output.display(),
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
