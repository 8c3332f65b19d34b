//! Two files that take turns.
//!
//! A generation is written over the older of two, whole, and is then made durable. If that is cut short by a loss of
//! power, its checksum is wrong and the one before it is still whole in the other file. Renaming a new file into place would
//! do as well, but takes calls that a shut-in thread has no use for otherwise, and changes the folder each time.

use std::ffi::OsString;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::generation::{Damage, Generation, LENGTH_MAX};
use crate::layout::Layout;

/// What both files are called behind the name that was given.
const ENDINGS: [&str; 2] = [".a", ".b"];

/// Where the generations of a program are written.
#[derive(Debug)]
pub struct Store {
    files: [File; 2],
    /// The file that may be written over.
    next: usize,
    /// The last generation that is whole.
    number: u64,
}

/// What both files had.
#[derive(Debug, Default)]
pub struct Found {
    /// The newest whole generation.
    pub newest: Option<Generation>,
    /// Files that have none, but should.
    pub damaged: Vec<(PathBuf, Damage)>,
}

impl Store {
    /// The paths of both files.
    #[must_use]
    pub fn paths(path: &Path) -> [PathBuf; 2] {
        ENDINGS.map(|ending| {
            let mut name = OsString::from(path);
            name.push(ending);
            PathBuf::from(name)
        })
    }

    /// Opens both files, or makes them, for one process at a time, and reads what they have.
    ///
    /// # Errors
    /// If a file cannot be opened or locked, or if one cannot be read and the other has no whole generation: the
    /// values may be in the first. What is wrong in a file that can be read is no error.
    pub fn open(path: &Path) -> io::Result<(Self, Found)> {
        let paths = Self::paths(path);
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let files = [options.open(&paths[0])?, options.open(&paths[1])?];
        files[0].try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => {
                io::Error::new(io::ErrorKind::WouldBlock, "another process has it open")
            }
            TryLockError::Error(error) => error,
        })?;
        // That the files are there must outlive a loss of power, too.
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        File::open(folder.unwrap_or(Path::new(".")))?.sync_all()?;
        let (found, next) = choose(&paths, [contents(&files[0]), contents(&files[1])])?;
        let number = found.newest.as_ref().map_or(0, |newest| newest.number);
        Ok((Self { files, next, number }, found))
    }

    /// Writes a block, and returns when it is durable. May take as long as the disk takes.
    ///
    /// # Errors
    /// If it is not written; the generation before it is whole all the same.
    pub fn save(&mut self, cycle: u64, layout: &Layout, block: &[u8]) -> io::Result<u64> {
        // The highest number is no generation's.
        let number = self.number.saturating_add(1);
        if number == u64::MAX {
            return Err(io::Error::from(io::ErrorKind::QuotaExceeded));
        }
        let bytes = Generation::encode(number, cycle, layout, block)
            .ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        let file = &self.files[self.next];
        file.write_all_at(&bytes, 0)?;
        file.set_len(bytes.len() as u64)?;
        file.sync_data()?;
        (self.number, self.next) = (number, 1 - self.next);
        Ok(number)
    }
}

fn contents(file: &File) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(LENGTH_MAX + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The newest whole generation, and the file that may be written over. An error if a file that could not be read may
/// have the only one.
fn choose(paths: &[PathBuf; 2], read: [io::Result<Vec<u8>>; 2]) -> io::Result<(Found, usize)> {
    let empty = read.each_ref().map(|read| read.as_ref().is_ok_and(Vec::is_empty));
    let decoded = read.map(|read| match read {
        Ok(bytes) => Generation::decode(&bytes),
        Err(error) => Err(Damage::Unreadable(error.to_string())),
    });
    let number = |slot: usize| decoded[slot].as_ref().map_or(0, |generation| generation.number);
    let newest = usize::from(number(1) > number(0));
    let mut damaged = Vec::new();
    for (slot, result) in decoded.iter().enumerate() {
        let Err(damage) = result else { continue };
        match (empty[slot], damage, number(1 - slot)) {
            (_, Damage::Unreadable(why), 0) => return Err(io::Error::other(why.clone())),
            // Nothing was written to it yet.
            (true, _, 0 | 1) => {}
            (true, ..) => damaged.push((paths[slot].clone(), Damage::Empty)),
            (false, ..) => damaged.push((paths[slot].clone(), damage.clone())),
        }
    }
    let next = if number(newest) == 0 { 0 } else { 1 - newest };
    let newest = decoded.into_iter().nth(newest).and_then(Result::ok);
    Ok((Found { newest, damaged }, next))
}
