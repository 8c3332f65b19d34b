//! From the sources of a project to a program image: all stages one after the other.

use thiserror::Error;

use crate::hir::Program;
use crate::native::{self, Native, NativeError};

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
    #[error(
        "nothing runs a program. Declare when, such as: CONFIGURATION Plant TASK often (INTERVAL := T#10ms, PRIORITY := 1); \
         PROGRAM one WITH often : Main; END_CONFIGURATION"
    )]
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
