//! Files that commands write: what was there stays until the new content takes its place as a whole.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempPath};

use crate::Failure;

/// Writes a file as a whole.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    let cannot = |error: &dyn std::fmt::Display| {
        Failure::input(format!("cannot write {}: {error}", path.display()))
    };
    if path.is_dir() {
        return Err(cannot(&"it is a folder"));
    }
    let written = successor(path).and_then(|successor| match successor {
        Some((mut file, place)) => {
            file.write_all(bytes)?;
            file.persist(place).map(drop).map_err(|error| error.error)
        }
        None => OpenOptions::new().write(true).open(path)?.write_all(bytes),
    });
    written.map_err(|error| cannot(&error))
}

/// A new file beside the one that a path leads to, with its permissions, and the place that it is to take: a link stays
/// one. None if no file can be there, but a device or a pipe is: that is written itself.
pub fn successor(path: &Path) -> io::Result<Option<(NamedTempFile, PathBuf)>> {
    let permissions = match fs::metadata(path) {
        Ok(there) if !there.is_file() => return Ok(None),
        Ok(there) => there.permissions(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => PermissionsExt::from_mode(0o644),
        Err(error) => return Err(error),
    };
    // A file that is not there yet has no real path. Links that lead in a circle were an error before.
    let mut place = path.to_owned();
    while let Ok(target) = fs::read_link(&place) {
        place = folder_of(&place).join(target);
    }
    let file = NamedTempFile::new_in(folder_of(&place))?;
    file.as_file().set_permissions(permissions)?;
    Ok(Some((file, place)))
}

/// A whole file that is to take the place of another.
pub struct Successor {
    new: TempPath,
    place: PathBuf,
}

/// Opens a file that is written bit by bit. What was there stays until the new one is whole and
/// [takes its place](Successor::take_place); what is no file is written itself.
pub fn open(path: &Path) -> io::Result<(File, Option<Successor>)> {
    if path.is_file() {
        // To replace a file asks for no permission to write it.
        OpenOptions::new().write(true).open(path)?;
        let new = match successor(path) {
            // A file may be open for writing and its folder not.
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                Some((NamedTempFile::new()?, fs::canonicalize(path)?))
            }
            new => new?,
        };
        if let Some((file, place)) = new {
            let (file, new) = file.into_parts();
            return Ok((file, Some(Successor { new, place })));
        }
    }
    Ok((File::create(path)?, None))
}

impl Successor {
    /// Puts the file into its place; what goes wrong, and where the file is then. What was there keeps its content up to
    /// the last step: where the folder allows no other file, it is written anew.
    pub fn take_place(self) -> Result<(), (io::Error, Option<PathBuf>)> {
        let Err(refused) = self.new.persist(&self.place) else { return Ok(()) };
        let new = refused.path;
        let copied = File::open(&new).and_then(|mut from| {
            let mut to = OpenOptions::new().write(true).truncate(true).open(&self.place)?;
            io::copy(&mut from, &mut to)
        });
        copied.map(drop).map_err(|error| (error, new.keep().ok()))
    }
}

/// Makes a folder with what `fill` writes there, or none.
pub fn folder(path: &Path, fill: impl FnOnce() -> Result<(), Failure>) -> Result<(), Failure> {
    fs::create_dir(path)
        .map_err(|error| Failure::input(format!("cannot make {}: {error}", path.display())))?;
    // Half of it would be in the way of the next try.
    fill().inspect_err(|_| drop(fs::remove_dir_all(path)))
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}
