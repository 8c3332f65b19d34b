//! What of a program outlives its stop, and the file for what outlives a stop of Takt.

use std::path::PathBuf;

use takt_abi::memory::PAGE;
use takt_program::Image;
use takt_retain::{LENGTH_MAX, Layout};
use takt_scheduler::time::Nanos;

use super::diagnostic::Diagnostic;
use super::images;
use super::partition::Surroundings;
use super::raw;
use super::units::Bytes;

/// Most bytes of RETAIN and PERSISTENT variables of a partition: with them, a sample has room for what is watched.
pub const RETAINED_MAX: u64 = 32 << 10;
/// Most separate pieces of memory that they are, for the same reason.
pub const PIECES_MAX: usize = 512;
/// How often they are written where the file does not say.
pub const EVERY_DEFAULT: Nanos = Nanos::from_millis(1000);
const EVERY_LEAST: Nanos = Nanos::from_millis(100);
const EVERY_MOST: Nanos = Nanos::from_millis(3_600_000);

/// Where the retained values of a program are written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RetainFile {
    /// Absolute path, without the endings of the two files.
    pub path: PathBuf,
    /// At most so often.
    pub every: Nanos,
}

/// What the programs of a partition have so far.
#[derive(Default)]
pub struct Sum {
    bytes: u64,
    pieces: usize,
}

impl Sum {
    /// Takes a program. Returns what its block needs of the guest's memory.
    pub fn add(&mut self, raw: &raw::Program, image: &Image<'_>) -> Result<u64, Diagnostic> {
        let bytes = Layout::block_bytes(image);
        self.bytes += bytes;
        if self.bytes > RETAINED_MAX {
            let found =
                format!("up to this program, {} bytes are RETAIN or PERSISTENT", self.bytes);
            let allowed = format!("at most {} in a partition", Bytes(RETAINED_MAX));
            return Err(Diagnostic::new(raw.image.span(), found, allowed));
        }
        let layout = Layout::of(image);
        self.pieces += layout.pieces();
        let refuse =
            |found: String, allowed: String| Err(Diagnostic::new(raw.image.span(), found, allowed));
        if self.pieces > PIECES_MAX {
            let found = format!(
                "up to this program, {} bytes in {} separate pieces of memory are RETAIN or PERSISTENT",
                self.bytes, self.pieces
            );
            let allowed = format!(
                "at most {} in {PIECES_MAX} pieces in a partition; variables that lie side by side are one piece",
                Bytes(RETAINED_MAX)
            );
            return refuse(found, allowed);
        }
        if layout.file_bytes() > LENGTH_MAX {
            let found = format!(
                "with the names of all its parts, what it retains takes {} bytes in a file",
                layout.file_bytes()
            );
            return refuse(
                found,
                format!("at most {}: fewer values, or shorter names", Bytes(LENGTH_MAX)),
            );
        }
        let needed = if raw.retain.is_some() { bytes.max(1) } else { bytes };
        Ok((needed + needed / 4).next_multiple_of(PAGE))
    }
}

/// Reads the keys for the file.
pub fn check(
    raw: &raw::Program,
    around: Surroundings<'_>,
) -> Result<Option<RetainFile>, Diagnostic> {
    let Some(path) = &raw.retain else {
        return raw.retain_every.as_ref().map_or(Ok(None), |every| {
            let found = "`retain_every` without `retain`";
            Err(Diagnostic::new(
                every.span(),
                found,
                "`retain_every` only beside `retain`, which names the file",
            ))
        });
    };
    let path = images::resolve(around.folder, path)?.path;
    let every = match &raw.retain_every {
        None => EVERY_DEFAULT,
        Some(every) if (EVERY_LEAST..=EVERY_MOST).contains(&every.get_ref().0) => every.get_ref().0,
        Some(every) => {
            let found = format!("a `retain_every` of {}", every.get_ref().0);
            let allowed = format!("{EVERY_LEAST} to {EVERY_MOST}");
            return Err(Diagnostic::new(every.span(), found, allowed));
        }
    };
    Ok(Some(RetainFile { path, every }))
}
