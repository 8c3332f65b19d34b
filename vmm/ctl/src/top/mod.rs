//! The screen.
//!
//! One connection serves both: it follows the events and asks for the status twice a second. What
//! happened in between is computed here from two answers, so that the screen costs Takt no more
//! than any other client. If Takt goes, the last picture stays and is said to be old; the screen
//! goes on by itself when there is one again.

mod draw;
#[cfg(test)]
mod tests;
mod view;

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Parser;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use takt_protocol::{Answer, Request};

use crate::command;
use takt_client::{ClientError, Connection};
use view::View;

/// Shows what a running Takt does, twice a second. `q` leaves it.
#[derive(Parser)]
#[command(name = "takt-top", version, after_help = command::AFTER_HELP)]
pub struct Cli {
    /// The partition file that Takt runs, or its control socket.
    #[arg(value_name = "FILE|SOCKET")]
    pub place: PathBuf,
}

/// Time between two questions.
const PERIOD: Duration = Duration::from_millis(500);

/// Shows the screen until the user leaves it.
///
/// # Errors
/// If no Takt answers at the start, or the terminal fails.
pub fn run(socket: &Path) -> Result<(), ClientError> {
    let mut view = View::default();
    // Before the terminal is changed: who finds no Takt sees an ordinary message.
    let first = connect(socket, &mut view)?;
    // Puts the terminal back at a panic, too.
    let mut terminal = ratatui::try_init().map_err(ClientError::Terminal)?;
    let result = show(socket, &mut terminal, &mut view, first);
    ratatui::restore();
    result.map_err(ClientError::Terminal)
}

fn show(
    socket: &Path,
    terminal: &mut DefaultTerminal,
    view: &mut View,
    first: Connection,
) -> io::Result<()> {
    let mut connection = Some(first);
    loop {
        terminal.draw(|frame| draw::screen(frame, view))?;
        let next = Instant::now() + PERIOD;
        while let Some(left) = next.checked_duration_since(Instant::now()) {
            if !event::poll(left)? {
                break;
            }
            match event::read()? {
                Event::Key(key) if leaves(&key) => return Ok(()),
                Event::Resize(..) => break,
                _ => {}
            }
        }
        let updated = match connection.take() {
            Some(mut open) => update(&mut open, view).map(|()| open),
            None => connect(socket, view),
        };
        match updated {
            Ok(open) => connection = Some(open),
            Err(error) => view.lost(error.to_string()),
        }
    }
}

fn leaves(key: &KeyEvent) -> bool {
    let interrupt = key.code == KeyCode::Char('c') && key.modifiers == KeyModifiers::CONTROL;
    let quit = matches!(key.code, KeyCode::Char('q') | KeyCode::Esc);
    key.kind == KeyEventKind::Press && (quit || interrupt)
}

/// Connects, follows the events and asks for the first status.
fn connect(socket: &Path, view: &mut View) -> Result<Connection, ClientError> {
    let mut takt = Connection::open(socket)?;
    takt.send(&Request::Events { follow: true })?;
    update(&mut takt, view)?;
    Ok(takt)
}

/// Asks for the status and for the versions of programs, and takes the events that come in between.
fn update(takt: &mut Connection, view: &mut View) -> Result<(), ClientError> {
    takt.send(&Request::Status)?;
    let status = loop {
        match next(takt, view)? {
            Answer::Status { status } => break status,
            Answer::Error(refusal) => return Err(ClientError::Refused(refusal)),
            // Not asked for.
            _ => {}
        }
    };
    let with_programs = status.partitions.iter().filter(|partition| !partition.programs.is_empty());
    let names: Vec<String> = with_programs.map(|partition| partition.name.clone()).collect();
    view.status(*status);
    for name in names {
        takt.send(&Request::Versions(name.clone()))?;
        let versions = loop {
            match next(takt, view)? {
                Answer::Versions { versions } => break versions,
                // A partition that is being started anew has none.
                Answer::Error(_) => break Vec::new(),
                _ => {}
            }
        };
        view.versions.insert(name, versions);
    }
    Ok(())
}

/// The next answer that is no event.
fn next(takt: &mut Connection, view: &mut View) -> Result<Answer, ClientError> {
    loop {
        match takt.receive()?.1 {
            Answer::Events { events } => view.events(events),
            Answer::Event { event } => view.event(event),
            answer => return Ok(answer),
        }
    }
}
