//! `takt plc keep`: what runs becomes what the next start begins with.
//!
//! Takt reads the images of its partition file when it starts. A version that was entered while the PLC ran is lost by
//! the next start unless its image takes the place of the old one. This command does that, when the version has proved
//! itself, and leaves the old image beside it. `commit` and `rollback` do the same with what `load` has left there. The
//! file has one whole image or the other at each instant, also if the power fails.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{MetadataExt, fchown};
use std::path::{Path, PathBuf};
use std::process;

use takt_plan::Program;
use takt_points::{Connected, Plc};
use takt_program::Image;
use takt_protocol::{ImageVersion, VersionStatus};
use tempfile::NamedTempFile;
use thiserror::Error;

use super::live::print;
use super::versions::{PATIENCE, find, outlast};
use super::{hex, image, next_start, read};
use crate::live::Which;
use crate::{Failure, status};

/// The ends of the names of files beside an image: one that was loaded, and the last one.
const LOADED: &str = "loaded";
const PREVIOUS: &str = "previous";

/// Arguments of `keep`.
#[derive(clap::Args)]
pub struct Keep {
    #[command(flatten)]
    which: Which,
    /// The program's name in the partition file.
    program: String,
    /// The image of the version that runs, as it was loaded.
    image: PathBuf,
}

impl Keep {
    /// Puts the image in the place of the partition file's.
    pub fn run(self) -> Result<(), Failure> {
        let bytes = read(&self.image)?;
        let image = image(&self.image, &bytes)?;
        let plc = self.which.load()?;
        let program = find(&plc, &self.program)?;
        let trusted = |keys: &Vec<_>| image.key().is_some_and(|key| keys.contains(&key));
        if !program.keys.as_ref().is_none_or(trusted) {
            let text =
                "is signed by none of the keys of the partition file, so no start would take it";
            return Err(Failure::input(format!("{} {text}", self.image.display())));
        }
        let mut connected = plc.reach()?;
        let running = proved(&mut connected, &self.program)?;
        if running.hash != hex(&image.hash()) {
            return Err(Failure::input(format!(
                "{} is version {}, and version {} ({}) of {} runs: what runs is kept, so `takt plc load` and `commit` come first",
                self.image.display(),
                shown(&image),
                takt_client::plain(&running.version),
                &takt_client::plain(&running.hash).chars().take(8).collect::<String>(),
                self.program
            )));
        }
        if program.bytes() == bytes {
            return print(&format!(
                "{} is version {} already",
                program.path.display(),
                shown(&image)
            ));
        }
        put(&plc, program, &image, &bytes)
    }
}

/// Leaves the image of a version that was loaded beside that of the partition file, where [`keep_running`] finds it. The
/// version can be entered without that, so it is told and is no failure. Nor is it one if no start could begin with the
/// version: the partition file can be changed until the commit.
pub fn set_aside(plc: &Plc, program: &Program, bytes: &[u8]) -> Result<(), Failure> {
    let whole = || {
        let path = fs::canonicalize(&program.path)?;
        let loaded = beside(&path, LOADED);
        write_next(&path, bytes)?.persist(loaded).map_err(|error| error.error)?;
        Ok::<_, Unwritten>(())
    };
    if let Err(error) = whole() {
        print(&format!(
            "no start can begin with it yet, since it cannot be written beside {}: {error}",
            program.path.display()
        ))?;
    }
    next_start::check(plc, program, bytes)
        .or_else(|error| print(&format!("the next start cannot begin with it: {error}")))
}

/// Refuses a version that is prepared and with which no start could begin, while nothing is ordered yet.
pub fn check_prepared(
    plc: &Plc,
    program: &Program,
    version: &VersionStatus,
) -> Result<(), Failure> {
    let prepared = version.other.as_ref().filter(|_| version.phase == "prepared");
    let Some(found) = prepared.and_then(|other| image_of(program, &other.hash)) else {
        // Takt refuses the order, or what is missing is told when the version has proved itself.
        return Ok(());
    };
    next_start::check(plc, program, &found.bytes).map_err(|error| {
        let message = format!(
            "nothing is ordered, since the next start cannot begin with the version that is prepared: {error}\n`takt plc commit \
             --until-restart` enters it, and leaves {} as it is",
            program.path.display()
        );
        Failure { status: status::REFUSED, message }
    })
}

/// An image in the place of the partition file's, or beside it.
pub struct Found {
    pub path: PathBuf,
    pub bytes: Vec<u8>,
    /// It is that of the partition file.
    pub is_in_place: bool,
}

/// The image of the version with this hash.
pub fn image_of(program: &Program, hash: &str) -> Option<Found> {
    let place = fs::canonicalize(&program.path).unwrap_or_else(|_| program.path.clone());
    let others = [LOADED, PREVIOUS].map(|end| (beside(&place, end), false));
    [(place, true)].into_iter().chain(others).find_map(|(path, is_in_place)| {
        let bytes = fs::read(&path).ok()?;
        let is_it = Image::verify(&bytes).is_ok_and(|image| hex(&image.hash()) == hash);
        is_it.then_some(Found { path, bytes, is_in_place })
    })
}

/// Has the next start begin with the version that runs. Its image is that of the partition file, or lies beside it.
pub fn keep_running(plc: &Plc, program: &Program, running: &ImageVersion) -> Result<(), Failure> {
    match image_of(program, &running.hash) {
        Some(Found { is_in_place: true, .. }) => return Ok(()),
        Some(Found { path, bytes, .. }) => {
            return put(plc, program, &image(&path, &bytes)?, &bytes);
        }
        None => {}
    }
    let message = format!(
        "version {} of {} runs, but the next start begins with {}, since no image of that version is beside it. `takt plc keep` \
         puts the image that you give it there",
        takt_client::plain(&running.version),
        program.name,
        program.path.display()
    );
    Err(Failure { status: status::REFUSED, message })
}

/// Puts an image in the place of the partition file's, and tells it.
fn put(plc: &Plc, program: &Program, image: &Image<'_>, bytes: &[u8]) -> Result<(), Failure> {
    let path = program.path.display();
    if let Err(error) = next_start::check(plc, program, bytes) {
        let message = format!(
            "version {} of {} runs until the next start, and {path} stays as it was, since that start cannot begin with \
             the version: {error}",
            shown(image),
            program.name
        );
        return Err(Failure { status: status::REFUSED, message });
    }
    let previous = replace(&program.path, bytes)
        .map_err(|error| Failure::input(format!("cannot replace {path}: {error}")))?;
    let (version, previous) = (shown(image), previous.display());
    print(&format!("{path} is version {version} now; the one before it is {previous}"))
}

fn shown(image: &Image<'_>) -> String {
    format!("{} ({})", image.version(), hex(&image.hash()[..4]))
}

/// The version of a program that runs, when it is not on trial any more.
fn proved(connected: &mut Connected<'_>, program: &str) -> Result<ImageVersion, Failure> {
    let uncertain = ["trial", "committing", "rolling-back"];
    let version = outlast(connected, program, &uncertain)?;
    let phase = version.phase.as_str();
    if !uncertain.contains(&phase) {
        return Ok(version.running);
    }
    let message = format!(
        "{program} is still {phase}, and has had no job for {} s, so it is not certain which version stays; ask again when `takt plc \
         versions` shows it held",
        PATIENCE.as_secs()
    );
    Err(Failure { status: status::REFUSED, message })
}

/// Puts `bytes` in the place of a file, whose content stays beside it under the returned name. Each step leaves whole
/// files only, and is on the disk before the next one.
fn replace(path: &Path, bytes: &[u8]) -> Result<PathBuf, Unwritten> {
    // A link stays a link.
    let path = fs::canonicalize(path)?;
    let folder = File::open(folder_of(&path))?;
    let previous = beside(&path, PREVIOUS);
    let next = write_next(&path, bytes)?;

    // A second name for the old content, which takes the place of an older one in one step.
    let name = name_of_next(&path);
    let mut second = tempfile::Builder::new();
    let second =
        second.prefix(&name).make_in(folder_of(&path), |second| fs::hard_link(&path, second))?;
    fs::rename(second.path(), &previous)?;
    // If both are names of one file already, as an attempt that was broken off leaves them, the rename does nothing.
    drop(second);
    folder.sync_all()?;

    next.persist(&path).map_err(|error| error.error)?;
    folder.sync_all()?;
    Ok(previous)
}

fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new("/"))
}

fn beside(path: &Path, end: &str) -> PathBuf {
    let name = [path.as_os_str(), OsStr::new("."), OsStr::new(end)];
    PathBuf::from(name.into_iter().collect::<OsString>())
}

/// Why an image gets into no place.
#[derive(Debug, Error)]
enum Unwritten {
    /// The system refuses a step.
    #[error(transparent)]
    Step(#[from] io::Error),
    /// Takt, or a colleague, could perhaps not read it any more.
    #[error(
        "it would not belong to user {user} and group {group} any more: {source}. Root, or that user, can do it"
    )]
    Owner {
        /// The number of the user who owns the old one.
        user: u32,
        /// That of the group.
        group: u32,
        /// What the kernel says.
        source: io::Error,
    },
}

/// Writes what is to take the place of `path` or of a file beside it, with the same owner and permissions. The file is
/// removed unless it gets there.
fn write_next(path: &Path, bytes: &[u8]) -> Result<NamedTempFile, Unwritten> {
    let name = name_of_next(path);
    let mut file = tempfile::Builder::new().prefix(&name).tempfile_in(folder_of(path))?;
    io::Write::write_all(&mut file, bytes)?;
    let (old, new) = (fs::metadata(path)?, file.as_file().metadata()?);
    let (user, group) = (old.uid(), old.gid());
    if (user, group) != (new.uid(), new.gid()) {
        fchown(&file, Some(user), Some(group)).map_err(|source| Unwritten::Owner {
            user,
            group,
            source,
        })?;
    }
    // Last, since the kernel takes bits away with the owner. Until then only this user can read it.
    file.as_file().set_permissions(old.permissions())?;
    file.as_file().sync_all()?;
    Ok(file)
}

/// How the names of files begin that are to take another place. Each has a name of its own: what one command writes is
/// moved by no other, and one that was killed leaves only such a file.
fn name_of_next(path: &Path) -> OsString {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(format!(".next-{}-", process::id()));
    name
}

#[cfg(test)]
#[path = "keep_tests.rs"]
mod tests;
