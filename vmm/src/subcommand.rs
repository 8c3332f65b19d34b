//! The commands that are programs of their own.
//!
//! What is not needed to start, separate, schedule, connect and supervise partitions does not belong
//! into the process that is trusted with it. Such a command, `takt ctl` say, is the program
//! `takt-ctl` in the folder of `takt`, as the commands of git and cargo are.

use std::ffi::{OsStr, OsString};
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

/// Why there is no such command.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Neither a command of takt nor a program beside it.
    #[error(
        "no command `{}`: there is no program {path}; `takt --help` lists the commands, and in Takt's sources `cargo build --release` \
         builds them", .name.display())]
    Unknown {
        /// The command as it was typed.
        name: OsString,
        /// Where its program would be.
        path: PathBuf,
    },
    /// There is a program, but it does not run.
    #[error("cannot run {path}: {source}")]
    Run {
        /// The program.
        path: PathBuf,
        /// What the kernel said.
        source: io::Error,
    },
}

/// Becomes the program for `words`: the command's name, and its arguments. Returns only if that fails.
pub fn run(words: &[OsString]) -> Error {
    let (name, arguments) = words.split_first().map_or((OsStr::new(""), words), |(n, a)| (n, a));
    let path = program(name);
    let source = Command::new(&path).args(arguments).exec();
    match source.kind() {
        io::ErrorKind::NotFound => Error::Unknown { name: name.into(), path },
        _ => Error::Run { path, source },
    }
}

/// Where the program for `name` is. A name with a slash in it would lead elsewhere.
fn program(name: &OsStr) -> PathBuf {
    let mut file = OsString::from("takt-");
    file.push(OsStr::from_bytes(name.as_bytes().rsplit(|&b| b == b'/').next().unwrap_or_default()));
    std::env::current_exe().unwrap_or_default().with_file_name(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_that_is_nowhere_is_told_where_it_would_be() {
        let error = run(&["no-such".into(), "x".into()]).to_string();
        assert!(error.starts_with("no command `no-such`"), "{error}");
        assert!(error.contains("/takt-no-such"), "{error}");
    }

    #[test]
    fn a_name_leads_to_no_other_folder() {
        let beside = program(OsStr::new("ctl"));
        assert_eq!(program(OsStr::new("x/../../ctl")), beside);
        assert!(beside.ends_with("takt-ctl"));
    }
}
