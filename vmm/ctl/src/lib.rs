//! Clients of Takt's control socket: `takt-ctl`, which asks and orders, `takt-top`, a screen, and `takt-console`, the
//! console of a partition.
//!
//! They are programs of their own so that what they need (a terminal library and sixty crates below
//! it) is no part of `takt`, which runs as root and keeps partitions apart. All that they can do goes
//! through the control socket, as for everybody else. `takt ctl`, `takt top` and `takt console` run them.

mod channels;
mod command;
mod console;
mod programs;
mod text;
mod top;
mod trace;

use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;

use clap::Parser;
use takt_client::{ClientError, error, socket};

/// What a shell tells of a process that the signal SIGPIPE ended.
const READER_GONE: u8 = 128 + 13;

/// All of `takt-ctl`.
#[must_use]
pub fn takt_ctl() -> ExitCode {
    run_with("takt-ctl", command::run)
}

/// All of `takt-top`.
#[must_use]
pub fn takt_top() -> ExitCode {
    run_with("takt-top", |cli: top::Cli| top::run(&cli))
}

/// All of `takt-console`.
#[must_use]
pub fn takt_console() -> ExitCode {
    run_with("takt-console", |cli: console::Cli| console::run(&cli, &socket(&cli.place)?))
}

fn run_with<C: Parser>(name: &str, run: impl FnOnce(C) -> Result<(), ClientError>) -> ExitCode {
    let cli = match C::try_parse() {
        Ok(cli) => cli,
        Err(answer) => {
            let status = if answer.use_stderr() { error::USAGE } else { 0 };
            let _ = answer.print();
            return ExitCode::from(status);
        }
    };
    match run(cli) {
        Ok(()) => ExitCode::SUCCESS,
        // As in `takt ctl FILE events --follow | head`.
        Err(ClientError::Output(error)) if error.kind() == ErrorKind::BrokenPipe => {
            ExitCode::from(READER_GONE)
        }
        Err(error) => {
            let text = match &error {
                // It begins with the file's name, and has several lines.
                ClientError::File(error) => error.to_string(),
                error => format!("{name}: {error}"),
            };
            // Without a reader, the status still tells.
            let _ = writeln!(io::stderr(), "{text}");
            ExitCode::from(error.status())
        }
    }
}
