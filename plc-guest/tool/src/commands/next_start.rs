//! Whether the next start of Takt could begin with another image of a program.
//!
//! A start checks the partition file with all of its images. A version that the running Takt has taken can be one with which
//! the file does not pass: an input that a `[[partition.io]]` connects is gone, or the memory is too small. In the place of the file's
//! image it would keep Takt from starting. So it is tried before the image is put there.

use std::path::PathBuf;

use takt_plan::{FileError, Program, Replacement, load_with};
use takt_points::Plc;
use thiserror::Error;

/// Why no start could begin with an image, or none as it should.
#[derive(Debug, Error)]
pub enum Unfit {
    /// The partition file does not pass with it.
    #[error(transparent)]
    File(#[from] FileError),
    /// The program would have another name, by which orders and the file do not know it.
    #[error(
        "the program would be named {found} then, as in its image: `name = \"{name}\"` in its [[partition.program]] keeps its name"
    )]
    Renamed {
        /// As it is named.
        name: String,
        /// As it would be.
        found: String,
    },
    /// The file was changed since the command has read it.
    #[error("the partition file does not name {} any more", .0.display())]
    NotNamed(PathBuf),
}

/// Checks the partition file with this image of the program.
pub fn check(plc: &Plc, program: &Program, bytes: &[u8]) -> Result<(), Unfit> {
    let path = &program.path;
    let file = load_with(plc.file().path(), None, Replacement { path, bytes })?;
    let partitions = file.partitions().iter().filter(|partition| partition.name() == plc.name());
    let mut programs = partitions.flat_map(|partition| partition.programs());
    match programs.find(|next| next.path == *path && next.bytes() == bytes) {
        Some(next) if next.name == program.name => Ok(()),
        Some(next) => Err(Unfit::Renamed { name: program.name.clone(), found: next.name.clone() }),
        None => Err(Unfit::NotNamed(path.clone())),
    }
}
