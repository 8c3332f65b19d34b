//! From the sources of a project to a program image: all stages one after the other.

use std::sync::Arc;

use thiserror::Error;

use crate::diagnostic::{Code, Diagnostic};
use crate::hir::{Location, Program, Routine, StructureKind};
use crate::native::{self, Most, Native, NativeError};
use crate::source::{Sources, Span};

/// A program that is ready to be loaded.
pub struct Built {
    /// The bytes of the image, unsigned.
    pub image: Vec<u8>,
    /// What the image was made of.
    pub native: Native,
}

/// Why a checked program has no image.
#[derive(Debug, Error)]
pub enum BuildError {
    /// It cannot be compiled.
    #[error(transparent)]
    Native(#[from] NativeError),
    /// It has no task, so nothing of it would ever run.
    #[error("nothing runs a program")]
    NoTask,
    /// The image's rules refuse it.
    #[error("the program image: {0}")]
    Image(takt_program::ImageError),
}

/// Compiles a checked program and makes its image. It may need the room of [`crate::stack`].
///
/// # Errors
/// See [`BuildError`].
pub fn build(program: &Program) -> Result<Built, BuildError> {
    if program.tasks.is_empty() {
        return Err(BuildError::NoTask);
    }
    let native = native::compile(program)?;
    let image = native::image(program, &native).map_err(BuildError::Image)?;
    Ok(Built { image, native })
}

/// Compiles a checked program to see whether it has an image. Without a task it may be a library, so that this is no
/// error here. It may need the room of [`crate::stack`].
///
/// # Errors
/// See [`BuildError`].
pub fn try_build(program: &Program) -> Result<(), BuildError> {
    if program.tasks.is_empty() {
        native::compile(program)?;
        return Ok(());
    }
    build(program).map(drop)
}

impl BuildError {
    /// The message about it, with the place of what takes most or is declared wrong.
    #[must_use]
    pub fn diagnostic(&self, program: &Program, sources: &Sources) -> Diagnostic {
        let at = |location: Location| place(sources, location);
        let tell = |code, location| Diagnostic::new(code, at(location), self.to_string());
        match self {
            Self::NoTask => tell(Code::NoTask, first_program(program))
                .allowed("a CONFIGURATION that says when a program runs")
                .hint(
                    "such as `CONFIGURATION Plant TASK often (INTERVAL := T#10ms, PRIORITY := 1); \
                     PROGRAM one WITH often : Main; END_CONFIGURATION`",
                ),
            Self::Native(NativeError::TooMuch { limit, what, most, .. }) => {
                let Most { name, bytes, location } = most;
                tell(Code::TooLarge, *location)
                    .allowed(format!("at most {limit} bytes of {what}"))
                    .hint(format!("`{name}` takes most: {bytes} bytes"))
            }
            Self::Native(NativeError::TooMuchStack { location, most, variable, .. }) => {
                let Most { name, bytes, location: largest } = most;
                let takes = format!("`{name}` takes most: {bytes} bytes");
                let hint = match variable {
                    Some((name, bytes)) => format!(
                        "{takes}, of which its variable `{name}` has {bytes}; the variables of a \
                         program or function block are not on the stack"
                    ),
                    None => takes,
                };
                tell(Code::StackTooLarge, *location)
                    .allowed(format!("at most {} bytes", takt_program::limit::STACK_BYTES))
                    .hint(hint)
                    .related(at(*largest), format!("`{name}` is declared here"))
            }
            Self::Native(NativeError::SharedOutput { tasks, locations, .. }) => tell(
                Code::AddressConflict,
                locations[1],
            )
            .allowed("one task that writes a variable at `%Q`, and the bytes in which it lies")
            .related(at(locations[0]), format!("the task `{}` writes here", tasks[0]))
            .hint(
                "let each task write a variable of its own, from which one task makes the output",
            ),
            Self::Native(NativeError::ReferredOutput { location, .. }) => {
                tell(Code::AddressConflict, *location)
                    .allowed("one task that assigns through references of this type")
                    .hint(
                        "assign the output by its name, or hand it on as a VAR_IN_OUT: both tell \
                         which task writes it",
                    )
            }
            Self::Native(NativeError::Internal { .. } | NativeError::Thread(_)) => {
                tell(Code::Internal, Location::default())
            }
            Self::Image(error) => {
                // The image sorts its variables, so the number of one says nothing here.
                let index = if error.record == "task" { error.index as usize } else { 0 };
                let location = program.tasks.get(index).map(|task| task.location);
                tell(Code::TooLarge, location.unwrap_or_default())
            }
        }
    }
}

fn first_program(program: &Program) -> Location {
    let kind = |ty| program.types.structure(ty).map(|structure| structure.kind);
    let of_program =
        |routine: &&Arc<Routine>| routine.instance.and_then(kind) == Some(StructureKind::Program);
    program.routines.iter().find(of_program).map(|routine| routine.location).unwrap_or_default()
}

/// A place in the sources; what has none is told at the beginning of the first.
fn place(sources: &Sources, location: Location) -> Span {
    let found = sources.word_at(usize::from(location.file), location.line, location.column);
    let first = || sources.iter().next().map(|(file, _)| Span { file, start: 0, end: 0 });
    found.or_else(first).unwrap_or_else(|| unreachable!("a program was made of sources"))
}
