//! The disks of a Linux: files that it sees whole, as block devices.
//!
//! What a guest may write must have no second user meanwhile (`files`). That no other program has it open is seen when
//! the run starts, by a lock.

use std::fs;
use std::path::{Path, PathBuf};

use toml::Spanned;

use super::diagnostic::{Diagnostic, Span, quote};
use super::images::{self, Image};
use super::raw::{self, Keys};

/// Most disks of a partition: each has an interrupt of its own, and the guest's controller has
/// seven that are free, for these and for network interfaces.
pub const DISKS_MAX: usize = 4;
/// Unit of all addresses on a disk, in bytes; virtio's own, whatever the file has.
pub const SECTOR: u64 = 512;

/// A disk of a Linux. The file was there when the partition file was loaded, and its length a whole
/// number of sectors.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Disk {
    /// Absolute path of the file with its contents.
    pub path: PathBuf,
    /// Whether the guest can only read it.
    pub read_only: bool,
    /// Whether its bytes go past the host's page cache.
    pub direct: bool,
}

/// A disk that obeys the rules, with the place that later rules point at.
#[derive(Debug)]
pub struct CheckedDisk {
    pub disk: Disk,
    /// The value of `path`.
    pub path: Span,
}

/// Checks the disks of a partition, in the order of the file.
pub fn check(
    raw: &[Spanned<Keys<raw::Disk>>],
    folder: &Path,
) -> Result<Vec<CheckedDisk>, Diagnostic> {
    if let Some(excess) = raw.get(DISKS_MAX) {
        let found = format!("this is disk {} of {}", DISKS_MAX + 1, raw.len());
        let allowed = format!("at most {DISKS_MAX} tables [[partition.disk]] in a partition");
        return Err(Diagnostic::new(excess.span(), found, allowed));
    }
    let mut checked: Vec<CheckedDisk> = Vec::with_capacity(raw.len());
    for table in raw {
        let Keys(raw) = table.get_ref();
        let Image { span, path } = images::resolve(folder, &raw.path)?;
        if let Some(other) = checked.iter().find(|other| other.disk.path == path) {
            let found = format!("a second disk is made of {}", quote(raw.path.get_ref()));
            return Err(Diagnostic::new(span, found, "a file of its own for each disk")
                .and(other.path.clone(), "the other one"));
        }
        let read_only = raw.read_only.as_ref().is_none_or(|read_only| *read_only.get_ref());
        let direct = raw.direct.as_ref().is_some_and(|direct| *direct.get_ref());
        checked.push(CheckedDisk { disk: Disk { path, read_only, direct }, path: span });
    }
    Ok(checked)
}

/// Points at a disk whose file cannot be one.
pub fn check_file(disk: &CheckedDisk) -> Result<(), Diagnostic> {
    let path = &disk.disk.path;
    let length = images::open(path).and_then(|_| Ok(fs::metadata(path)?.len()));
    let found = match length {
        Ok(bytes) if bytes > 0 && bytes.is_multiple_of(SECTOR) => return Ok(()),
        Ok(bytes) => format!("{} has {bytes} bytes", path.display()),
        Err(error) => format!("{} cannot be read: {error}", path.display()),
    };
    let allowed = format!(
        "a regular file of whole sectors of {SECTOR} bytes; `truncate -s 1G FILE` makes an empty one"
    );
    Err(Diagnostic::new(disk.path.clone(), found, allowed))
}
