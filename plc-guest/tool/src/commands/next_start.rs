//! Whether the next start of Takt could begin with another image of a program.
//!
//! A start checks the partition file with all of its images. A version that the running Takt has taken can be one with which
//! the file does not pass: an input that a `[[partition.io]]` connects is gone, or the memory is too small. In the place of the file's
//! image it would keep Takt from starting. So it is tried before the image is put there.

use std::fs;
use std::path::{Path, PathBuf};

use takt_plan::{FileError, Program, Replacement, load_with};
use takt_points::Plc;
use thiserror::Error;

/// Why no start could begin with an image, or none as it should.
#[derive(Debug, Error)]
pub enum Unfit {
    /// Another program has the same file.
    #[error("{} is the image of {other} too, which would also begin with the version: copy the file, so that each program has its \
        own, and name the copy in the partition file", path.display())]
    Shared {
        /// The file.
        path: PathBuf,
        /// The other program, with its partition.
        other: String,
    },
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
    // The other program may be of another version now, and has not been tried with this one.
    if let Some(other) = sharer(plc, program).filter(|_| program.bytes() != bytes) {
        return Err(Unfit::Shared { path: path.clone(), other });
    }
    let file = load_with(plc.file().path(), None, Replacement { path, bytes })?;
    let partitions = file.partitions().iter().filter(|partition| partition.name() == plc.name());
    let programs = partitions.flat_map(|partition| partition.programs());
    let mut named = programs.filter(|next| next.path == *path && next.bytes() == bytes).peekable();
    let Some(first) = named.peek().copied() else {
        return Err(Unfit::NotNamed(path.clone()));
    };
    if named.any(|next| next.name == program.name) {
        return Ok(());
    }
    Err(Unfit::Renamed { name: program.name.clone(), found: first.name.clone() })
}

/// Another program of the partition file whose image is the same file, perhaps by a link.
fn sharer(plc: &Plc, program: &Program) -> Option<String> {
    let place = |path: &Path| fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let own = place(&program.path);
    plc.file().partitions().iter().find_map(|partition| {
        let is_own = |other: &Program| partition.name() == plc.name() && other.name == program.name;
        let mut others = partition.programs().iter().filter(|other| !is_own(other));
        let other = others.find(|other| place(&other.path) == own)?;
        Some(format!("{} in the partition {}", other.name, partition.name()))
    })
}
