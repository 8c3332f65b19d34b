//! `takt plc keep`: what runs becomes what the next start begins with.
//!
//! Takt reads the images of its partition file when it starts. A version that was entered while the PLC ran is lost by
//! the next start unless its image takes the place of the old one. This command does that, when the version has proved
//! itself, and leaves the old image beside it. The file has one whole image or the other at each instant, also if the
//! power fails.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use takt_points::Connected;
use takt_program::Image;
use takt_protocol::ImageVersion;

use super::live::print;
use super::versions::{find, versions};
use super::{hex, image, read};
use crate::live::Which;
use crate::{Failure, status};

/// How long a trial is waited for.
const PATIENCE: Duration = Duration::from_secs(10);
/// The ends of the names of files beside an image: the next one while it is written, and the last one.
const NEXT: &str = "next";
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
        let previous = replace(&program.path, &bytes).map_err(|error| {
            Failure::input(format!("cannot replace {}: {error}", program.path.display()))
        })?;
        print(&format!(
            "{} is version {} now; the one before it is {}",
            program.path.display(),
            shown(&image),
            previous.display()
        ))
    }
}

fn shown(image: &Image<'_>) -> String {
    format!("{} ({})", image.version(), hex(&image.hash()[..4]))
}

/// The version of a program that runs, when it is not on trial any more.
fn proved(connected: &mut Connected<'_>, program: &str) -> Result<ImageVersion, Failure> {
    let end = Instant::now() + PATIENCE;
    loop {
        let all = versions(connected)?;
        let Some(version) = all.into_iter().find(|version| version.program == program) else {
            return Err(Failure::input(format!("the Takt that answers runs no program {program}")));
        };
        match version.phase.as_str() {
            "trial" | "committing" | "rolling-back" if Instant::now() < end => {}
            phase @ ("trial" | "committing" | "rolling-back") => {
                let message = format!(
                    "{program} is still {phase} after {} s, so it is not certain which version stays; ask again when `takt plc \
                     versions` shows it held",
                    PATIENCE.as_secs()
                );
                return Err(Failure { status: status::REFUSED, message });
            }
            _ => return Ok(version.running),
        }
    }
}

/// Puts `bytes` in the place of a file, whose content stays beside it under the returned name. Each step leaves whole
/// files only, and is on the disk before the next one.
fn replace(path: &Path, bytes: &[u8]) -> io::Result<PathBuf> {
    // A link stays a link.
    let path = fs::canonicalize(path)?;
    let folder = File::open(path.parent().unwrap_or(Path::new("/")))?;
    let beside = |end: &str| {
        let name = [path.as_os_str(), OsStr::new("."), OsStr::new(end)];
        PathBuf::from(name.into_iter().collect::<std::ffi::OsString>())
    };
    let (next, previous) = (beside(NEXT), beside(PREVIOUS));

    // A second name for the old content, which takes the place of an older one in one step.
    remove(&next)?;
    fs::hard_link(&path, &next)?;
    fs::rename(&next, &previous)?;
    // If both are names of one file already, as an attempt that was broken off leaves them, the rename does nothing.
    remove(&next)?;
    folder.sync_all()?;

    let mut file = File::create_new(&next)?;
    io::Write::write_all(&mut file, bytes)?;
    file.set_permissions(fs::metadata(&path)?.permissions())?;
    file.sync_all()?;
    fs::rename(&next, &path)?;
    folder.sync_all()?;
    Ok(previous)
}

/// Removes what an earlier attempt may have left.
fn remove(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
#[path = "keep_tests.rs"]
mod tests;
