//! Which files have one use only.
//!
//! What is written to must have no other use: a log that is appended to an image damages it, and the next start is
//! refused. What is only read may be named again. All paths of the file come together here, so that each is compared
//! with every other.
//!
//! Files that are there are compared by device and inode, so that links are seen. A file that is still to be made is
//! compared by its folder and its name. A link that leads to no file yet counts as a file of its own.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ffi::OsString;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use takt_retain::Store;
use toml::Spanned;

use super::channels::Channel;
use super::diagnostic::{Diagnostic, Span, quote};
use super::host_ports;
use super::partition::Checked;
use super::programs::CheckedProgram;
use super::raw::{self, Keys};

/// What makes two paths one file.
#[derive(PartialEq, Eq, Hash)]
enum Identity {
    File { device: u64, inode: u64 },
    Place { device: u64, folder: u64, name: OsString },
    Path(PathBuf),
}

impl Identity {
    fn of(path: &Path) -> Self {
        if let Ok(file) = fs::metadata(path) {
            return Self::File { device: file.dev(), inode: file.ino() };
        }
        let folder = path.parent().and_then(|folder| fs::metadata(folder).ok());
        match (folder, path.file_name()) {
            (Some(folder), Some(name)) => {
                Self::Place { device: folder.dev(), folder: folder.ino(), name: name.into() }
            }
            _ => Self::Path(path.into()),
        }
    }
}

/// What a path is for.
struct Use {
    path: PathBuf,
    /// That of the partition file, which does not name itself, is empty.
    span: Span,
    what: String,
    /// Only read, as others may do too.
    shared: bool,
}

#[derive(Default)]
struct Uses(HashMap<Identity, Use>);

impl Uses {
    fn add(
        &mut self,
        path: &Path,
        span: &Span,
        what: String,
        shared: bool,
    ) -> Result<(), Diagnostic> {
        let next = Use { path: path.into(), span: span.clone(), what, shared };
        match self.0.entry(Identity::of(path)) {
            Entry::Vacant(place) => {
                place.insert(next);
                Ok(())
            }
            Entry::Occupied(other) if shared && other.get().shared => Ok(()),
            Entry::Occupied(other) => Err(twice(other.remove(), next)),
        }
    }
}

/// Checks that nothing is written to a file that has another use in the partition file `file`.
pub fn check<'a>(
    file: &Path,
    control: Option<(&Path, &Spanned<String>)>,
    partitions: &[Checked],
    channels: impl Iterator<Item = (&'a Channel, &'a Spanned<Keys<raw::Channel>>)>,
) -> Result<(), Diagnostic> {
    let mut uses = Uses::default();
    uses.add(file, &(0..0), "the partition file".to_owned(), true)?;
    if let Some((path, text)) = control {
        uses.add(path, &text.span(), "the control socket".to_owned(), false)?;
    }
    for checked in partitions {
        let partition = format!("partition {}", quote(&checked.partition.name));
        for image in &checked.images {
            uses.add(&image.path, &image.span, format!("an image of {partition}"), true)?;
        }
        for disk in &checked.disks {
            let what = format!("a disk of {partition}");
            uses.add(&disk.disk.path, &disk.path, what, disk.disk.read_only)?;
        }
        for CheckedProgram { program, span, retain, .. } in &checked.programs {
            let of = format!("program {} of {partition}", quote(&program.name));
            uses.add(&program.path, span, format!("the image of {of}"), true)?;
            for (retain, span) in program.retain.iter().zip(retain) {
                for path in Store::paths(&retain.path) {
                    uses.add(&path, span, format!("a retain file of {of}"), false)?;
                }
            }
        }
        if let Some(log) = &checked.console_log {
            let what = format!("the console's file of {partition}");
            uses.add(&log.path, &log.span, what, false)?;
        }
    }
    for (channel, table) in channels {
        if let (Some(port), Some(key)) = (&channel.host, host_ports::key(&table.get_ref().0)) {
            let what = format!("the end of channel {} on the host", quote(&channel.name));
            uses.add(port.path(), &key.span(), what, false)?;
        }
    }
    Ok(())
}

fn twice(first: Use, second: Use) -> Diagnostic {
    // What is read is more likely meant than what would be written over it.
    let (wrong, other) = if second.shared { (first, second) } else { (second, first) };
    let found = format!("{} is also {}", wrong.path.display(), other.what);
    let allowed =
        "a path of its own; only images, and disks that are only read, may be named twice";
    let error = Diagnostic::new(wrong.span, found, allowed);
    if other.span.is_empty() { error } else { error.and(other.span, "the other one") }
}
