//! A way into a Linux partition that needs no network: `takt shell` and `takt copy`.
//!
//! ```text
//! takt-shell --becomes--> ssh --starts--> takt-shell connect CID 22 --vsock--> guest: sshd
//! ```
//!
//! What is hard about a remote shell (users, keys, terminals, file transfer) ssh has solved, and engineers know it. What
//! it lacks is the way: it asks another program for that (`ProxyCommand`), which is this one again. So
//! Takt needs no program of its own in the guest.
//!
//! It reads the partition file for the number (CID) only. It talks to no Takt, and links no hypervisor.

mod choose;
mod command;
mod connect;
mod error;
mod paths;
mod ssh;

use std::ffi::OsString;
use std::io::{self, Write};
use std::process::ExitCode;

use clap::Parser;
use takt_plan::PartitionFile;

use command::{Copy, Shell};
pub use error::ShellError;

/// Exit status of wrong usage, and of a bad partition file.
const USAGE: u8 = 2;

/// All of `takt-shell`.
#[must_use]
pub fn takt_shell() -> ExitCode {
    let words: Vec<OsString> = std::env::args_os().skip(1).collect();
    if let Some(place) = connect::Place::of(&words) {
        return told("takt-shell", place.connect());
    }
    run("takt-shell", |cli: Shell| {
        let file = load(&cli.file)?;
        let guest = choose::guest(&file, cli.partition.as_deref())?;
        Err(guest.shell(cli.user.as_deref(), &cli.command))
    })
}

/// All of `takt-copy`.
#[must_use]
pub fn takt_copy() -> ExitCode {
    run("takt-copy", |cli: Copy| {
        let file = load(&cli.file)?;
        let (guest, paths) = paths::read(&file, &cli.paths)?;
        Err(guest.copy(cli.user.as_deref(), &paths))
    })
}

/// Which CPUs there are is the business of the Takt that runs the file.
fn load(path: &std::path::Path) -> Result<PartitionFile, ShellError> {
    Ok(takt_plan::load(path, None)?)
}

fn run<C: Parser>(name: &str, run: impl FnOnce(C) -> Result<(), ShellError>) -> ExitCode {
    match C::try_parse() {
        Ok(cli) => told(name, run(cli)),
        Err(answer) => {
            let status = if answer.use_stderr() { USAGE } else { 0 };
            // A terminal that is gone reads no help.
            let _ = answer.print();
            ExitCode::from(status)
        }
    }
}

fn told(name: &str, result: Result<(), ShellError>) -> ExitCode {
    let Err(error) = result else { return ExitCode::SUCCESS };
    // The status tells the same where it cannot be written.
    let _ = match &error {
        // It begins with the file's name, and has several lines.
        ShellError::File(error) => writeln!(io::stderr(), "{error}"),
        error => writeln!(io::stderr(), "{name}: {error}"),
    };
    ExitCode::from(error.status())
}
