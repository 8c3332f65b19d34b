//! `takt console`: shows the console of a partition, and types at that of a Linux.
//!
//! ```text
//!  standard input --> thread that reads --queue--> thread that types --type--> Takt
//!                                                        ^ how many were taken  |
//!  standard output <------------------- main thread <----+--console, typed------+
//! ```
//!
//! Takt takes what the guest has room for and says how much that was. The rest is typed again, so nothing of a long text
//! is lost, and no more than one request is under way. The thread that reads never waits for that where a person types:
//! the key that leaves is found also if the guest takes nothing.

mod keyboard;
mod keys;

use std::io::{self, IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};

use clap::Parser;
use ratatui::crossterm::terminal::{disable_raw_mode, enable_raw_mode};
use takt_client::{ClientError, Connection};
use takt_protocol::{Answer, ConsoleOutput, ConsoleStart, Request, from_hex};

use crate::command;
use keyboard::End;

/// Attaches to the console of a partition: shows what it has written last and writes from now on, and types at it.
/// Ctrl-] and then d leaves it; Ctrl-] twice types Ctrl-].
#[derive(Parser)]
#[command(name = "takt-console", version, after_help = command::AFTER_HELP)]
pub struct Cli {
    /// Show only, and go on until the run ends: nothing is typed.
    #[arg(long)]
    follow: bool,
    /// The partition file that Takt runs, or its control socket.
    #[arg(value_name = "FILE|SOCKET")]
    pub place: PathBuf,
    /// The partition's name.
    partition: String,
}

/// Attaches, until the user leaves or the run ends.
///
/// # Errors
/// See [`ClientError`].
pub fn run(cli: &Cli, socket: &Path) -> Result<(), ClientError> {
    let mut takt = Connection::open(socket)?;
    takt.send(&Request::Attach(cli.partition.clone()))?;
    let Answer::Attached { console } = takt.receive()?.1.granted()? else {
        return Err(strange("this is no console"));
    };
    takt.wait_for_ever()?;
    let is_typed = console.terminal && !cli.follow;
    let raw = is_typed && io::stdin().is_terminal() && io::stdout().is_terminal();
    if raw {
        say(&format!("takt-console: attached to {}; Ctrl-] d leaves it", cli.partition));
        enable_raw_mode().map_err(ClientError::Terminal)?;
    }
    let result = attached(&mut takt, cli, &console, is_typed, raw);
    if raw {
        // The terminal may be gone, and then there is none to put back.
        let _ = disable_raw_mode();
        say(&format!("\ntakt-console: detached from {}", cli.partition));
    }
    result
}

/// Tells the user. One whose terminal is gone does not read it, and that is no reason to end otherwise.
fn say(text: &str) {
    let _ = writeln!(io::stderr(), "{text}");
}

fn attached(
    takt: &mut Connection,
    cli: &Cli,
    start: &ConsoleStart,
    is_typed: bool,
    raw: bool,
) -> Result<(), ClientError> {
    let left = Arc::new(AtomicBool::new(false));
    let (tell, told) = channel();
    show(start.terminal, &start.bytes)?;
    if is_typed {
        let ends = || -> Result<_, ClientError> { Ok(End::new(left.clone(), takt.sender()?)) };
        keyboard::start(cli.partition.clone(), raw, (ends()?, ends()?), told);
    } else if !cli.follow {
        return Ok(());
    }
    let shown = listen(takt, start.terminal, &tell);
    // That the user has left is how it should end, whatever the connection says of it.
    if left.load(Ordering::SeqCst) { Ok(()) } else { shown }
}

/// Shows what comes until the connection ends.
fn listen(takt: &mut Connection, terminal: bool, tell: &Sender<u64>) -> Result<(), ClientError> {
    loop {
        match takt.receive()?.1.granted()? {
            Answer::Console { console: ConsoleOutput { missed, bytes, .. } } => {
                if missed > 0 {
                    let mut told = io::stderr();
                    let _ = write!(told, "\r\ntakt-console: {missed} bytes missed\r\n");
                }
                show(terminal, &bytes)?;
            }
            Answer::Typed { taken } => {
                // A keyboard that is gone needs no answer.
                let _ = tell.send(taken);
            }
            _ => {}
        }
    }
}

/// Shows output: a terminal's unchanged, a PLC's without what could play with the user's terminal.
fn show(terminal: bool, digits: &str) -> Result<(), ClientError> {
    let bytes = from_hex(digits).ok_or_else(|| strange("console output has hexadecimal digits"))?;
    let mut out = io::stdout().lock();
    let written = if terminal { out.write_all(&bytes) } else { out.write_all(&plain(&bytes)) };
    written.and_then(|()| out.flush()).map_err(ClientError::Output)
}

fn plain(bytes: &[u8]) -> Vec<u8> {
    let byte = |byte: &u8| match byte {
        b'\n' => vec![b'\n'],
        other => other.escape_ascii().collect(),
    };
    bytes.iter().flat_map(byte).collect()
}

fn strange(what: &str) -> ClientError {
    ClientError::NotUnderstood(what.to_owned())
}
