//! `takt-port`: the ports of a Linux partition for the shell.
//!
//! Each call is a process of its own that takes a port, does one thing and ends. Calls that follow each
//! other are one end of the channel, since each attaches to what the last one has left; so a loop
//! in a shell sends and receives without loss. `--open` begins anew instead.

#![forbid(unsafe_code)]

mod arguments;
mod commands;
mod failure;
mod format;
mod layout;
mod overview;

use std::process::ExitCode;

use arguments::Arguments;
use clap::Parser;
use failure::USAGE;

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Help goes to the standard output, a mistake to the other; neither can fail better.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { USAGE } else { 0 });
        }
    };
    match commands::run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("takt-port: {failure}");
            ExitCode::from(failure.status())
        }
    }
}
