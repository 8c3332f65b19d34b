//! `takt plc build`: sources in Structured Text, or object files and static libraries, become an image.

use std::io::Write;
use std::path::{Path, PathBuf};

use takt_st::{hir, layout, manifest, native, stack};

use super::structured_text::{Messages, Origin, is_text, no_thread};
use super::{image, inputs, read, spare, write};
use crate::{Failure, link};

/// Arguments of `build`.
#[derive(clap::Args)]
pub struct Build {
    /// Files in Structured Text (.st) and folders of which all such files are taken; or object files (.o) and static
    /// libraries (.a). A folder with a project file (takt-plc.toml) is taken as a project; without any input, the
    /// current folder is.
    inputs: Vec<PathBuf>,
    /// Where to write the image. A program in Structured Text has its name from this file; without it, from the
    /// first input, and the image is written to NAME.plc.
    #[arg(short, long, value_name = "IMAGE")]
    output: Option<PathBuf>,
    /// The image of the running version, in Structured Text: what has not changed stays at its place, so that an online
    /// change moves nothing. The key `previous` of a project file says the same.
    #[arg(long, value_name = "IMAGE")]
    previous: Option<PathBuf>,
    /// Print a stage of the compiler for Structured Text instead of writing an image.
    #[arg(long, value_enum, value_name = "STAGE", conflicts_with = "output")]
    emit: Option<Stage>,
    #[command(flatten)]
    messages: Messages,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Stage {
    /// The words of each file, each with its place.
    Tokens,
    /// The syntax tree of each file.
    Ast,
    /// The program with all types, conversions and places written out.
    Types,
    /// The code of each routine as Cranelift gets it.
    Ir,
    /// The machine code of each routine.
    Asm,
}

impl Build {
    pub fn run(self) -> Result<(), Failure> {
        match self.inputs.iter().filter(|input| is_text(input)).count() {
            texts if texts == self.inputs.len() => self.compile(),
            texts => {
                let refused = inputs::refused(&self.inputs);
                match texts {
                    _ if !refused.refused().is_empty() => Err(self.messages.refused(&refused)),
                    0 => self.link(),
                    _ => Err(Failure::input(
                        "found Structured Text and other files; an image is made of one or the other",
                    )),
                }
            }
        }
    }

    fn link(&self) -> Result<(), Failure> {
        if self.emit.is_some() || self.previous.is_some() {
            let message = "--emit and --previous are for Structured Text (.st)";
            return Err(Failure::input(message));
        }
        let Some(output) = &self.output else {
            return Err(Failure::input("say where to write the image with -o IMAGE"));
        };
        spare(output, self.inputs.iter().map(PathBuf::as_path))?;
        finish(output, &link::build(&self.inputs).map_err(Failure::input)?)
    }

    fn compile(&self) -> Result<(), Failure> {
        let origin = Origin::of(&self.inputs, &self.messages)?;
        if let Some(stage @ (Stage::Tokens | Stage::Ast)) = self.emit {
            return self.messages.syntax(&origin, matches!(stage, Stage::Ast));
        }
        let name = self.name(&origin)?;
        let mut good = self.messages.program(&name, &origin)?;
        let of_project = origin.project().and_then(|project| project.previous.as_ref());
        let previous = self.previous.as_ref().or(of_project);
        if let Some(path) = previous {
            let bytes = read(path)?;
            layout::keep(&mut good.program, &image(path, &bytes)?);
        }
        match self.emit {
            Some(stage) => {
                let program = &good.program;
                let text = stack::with_room(|| match stage {
                    Stage::Ir => native::intermediate(program),
                    Stage::Asm => native::assembly(program),
                    // Those of the syntax were shown before.
                    Stage::Types | Stage::Tokens | Stage::Ast => hir::print(program),
                });
                // A reader that has seen enough may close its end.
                let _ = std::io::stdout().write_all(text.map_err(no_thread)?.as_bytes());
                Ok(())
            }
            None => {
                let output = self.output.clone().unwrap_or_else(|| format!("{name}.plc").into());
                let files = good.files(&origin);
                let images = self.previous.iter().chain(of_project);
                spare(&output, files.iter().chain(images).map(PathBuf::as_path))?;
                let built = self.messages.build(&good)?;
                finish(&output, &built.image)
            }
        }
    }

    /// The name of a program in Structured Text.
    fn name(&self, origin: &Origin) -> Result<String, Failure> {
        let file = match (&self.output, origin) {
            (_, Origin::Project(project)) => return Ok(project.name.clone()),
            // Nothing is built of it.
            (_, Origin::Broken(_)) => return Ok("broken".to_owned()),
            (Some(output), _) => output.file_stem().map(ToOwned::to_owned),
            (None, Origin::Paths(paths)) => paths.first().and_then(|input| match input.is_dir() {
                // `.` and `..` have no name of their own.
                true => input.canonicalize().ok()?.file_name().map(ToOwned::to_owned),
                false => input.file_stem().map(ToOwned::to_owned),
            }),
        };
        let name = file.unwrap_or_default().to_string_lossy().into_owned();
        if !manifest::is_program_name(&name) {
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
        image.variables().filter(|variable| !variable.is_part()).count(),
    );
    Ok(())
}
