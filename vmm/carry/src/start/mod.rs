//! The first process of an appliance that goes on from a snapshot.
//!
//! A kernel takes seconds of a processor to start where each instruction is emulated, and does the same each time. So
//! the scripts keep a snapshot of a machine in which the kernel has started this program, and nothing else, and let each
//! run go on from there (`scripts/common/snapshot.sh`).
//!
//! ```text
//! kernel -> this program: stops the machine | snapshot | goes on, with one device more -> unpacks the run's files -> /init
//! ```
//!
//! The device is only memory, as the line of the control socket is. The archive in it has what a machine that starts
//! from nothing finds in its initial RAM disk, and a file with the words of its command line.

mod archive;
mod memory;
mod mount;

use std::convert::Infallible;
use std::ffi::OsStr;
use std::fs::{self, OpenOptions};
use std::io::{self, Seek, SeekFrom, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use thiserror::Error;

use memory::{MapError, ReadMemory};
use mount::Mounted;

/// The ordinary first process.
const INIT: &str = "/init";
/// In the archive: the words of the command line, each with a NUL behind it.
const WORDS: &str = "/words";
/// The register of QEMU's pvpanic, and what tells it that the machine is to be stopped (QEMU's docs/specs/pvpanic).
const STOP: (u64, u8) = (0x505, 1);

/// Why the run does not begin.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the messages say it")]
pub enum StartError {
    #[error("cannot {what} {}: {source}", path.display())]
    File { what: &'static str, path: PathBuf, source: io::Error },
    #[error(transparent)]
    Map(#[from] MapError),
    #[error("cannot unpack the files of the run: {0}")]
    Unpack(#[from] archive::UnpackError),
}

/// Stops the machine, takes the files of a run from the PCI function at `address` when it goes on, and becomes the
/// ordinary first process.
///
/// # Errors
/// See [`StartError`]. The kernel ends the machine then.
pub fn run(address: &OsStr) -> Result<Infallible, StartError> {
    {
        let _devices = Mounted::new(c"devtmpfs", c"/dev").map_err(cannot("mount", "/dev"))?;
        let _functions = Mounted::new(c"sysfs", c"/sys").map_err(cannot("mount", "/sys"))?;
        write_at("/dev/port", STOP.0, &[STOP.1])?;
        write_at("/sys/bus/pci/rescan", 0, b"1")?;
        let function = Path::new("/sys/bus/pci/devices").join(address);
        write_at(function.join("enable"), 0, b"1")?;
        let mut files = ReadMemory::open(&function.join("resource2"))?;
        archive::unpack(&mut files, Path::new("/"))?;
    }
    let words = fs::read(WORDS).map_err(cannot("read", WORDS))?;
    fs::remove_file(WORDS).map_err(cannot("remove", WORDS))?;
    let (variables, arguments) = split(&words);
    let source = Command::new(INIT).args(arguments).envs(variables).exec();
    Err(cannot("run", INIT)(source))
}

/// The words as the kernel gives them to the first process: its variables, and behind `--` its arguments.
fn split(words: &[u8]) -> (Vec<(&OsStr, &OsStr)>, Vec<&OsStr>) {
    let mut all = words.split(|&byte| byte == 0).filter(|word| !word.is_empty());
    let variables = all.by_ref().take_while(|&word| word != b"--").filter_map(|word| {
        let at = word.iter().position(|&byte| byte == b'=')?;
        let (name, value) = word.split_at(at);
        Some((OsStr::from_bytes(name), OsStr::from_bytes(value.get(1..)?)))
    });
    let variables = variables.collect();
    (variables, all.map(OsStr::from_bytes).collect())
}

fn write_at(path: impl Into<PathBuf>, at: u64, bytes: &[u8]) -> Result<(), StartError> {
    let path = path.into();
    let write = || {
        let mut file = OpenOptions::new().write(true).open(&path)?;
        file.seek(SeekFrom::Start(at))?;
        file.write_all(bytes)
    };
    write().map_err(cannot("write to", &path))
}

fn cannot(what: &'static str, path: impl AsRef<Path>) -> impl FnOnce(io::Error) -> StartError {
    let path = path.as_ref().to_owned();
    move |source| StartError::File { what, path, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_variables_and_behind_two_dashes_arguments() {
        let words = b"TAKT_STEERED=1\0SOCKET=/a b=c\0ignored\0--\0takt\0run\0--for\0a=b\0--\0";
        let (variables, arguments) = split(words);
        let text = |word: &OsStr| word.to_string_lossy().into_owned();
        let variables: Vec<_> =
            variables.into_iter().map(|(name, value)| (text(name), text(value))).collect();
        let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
        assert_eq!(variables, [pair("TAKT_STEERED", "1"), pair("SOCKET", "/a b=c")]);
        assert_eq!(arguments, ["takt", "run", "--for", "a=b", "--"]);
        assert_eq!(split(b""), (vec![], vec![]));
    }
}
