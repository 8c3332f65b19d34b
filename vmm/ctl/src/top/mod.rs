//! The screen.
//!
//! One connection serves both: it follows the events and asks for the status twice a second. What
//! happened in between is computed here from two answers, so that the screen costs Takt no more
//! than any other client. If Takt goes, the last picture stays and is said to be old; the screen
//! goes on by itself when there is one again.

mod draw;
#[cfg(test)]
mod tests;
mod values_page;
#[cfg(test)]
mod values_page_tests;
mod view;
mod watcher;
#[cfg(test)]
mod watcher_tests;

use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::Parser;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use takt_protocol::{Answer, Request};

use crate::command;
use takt_client::{ClientError, Connection};
use view::{Page, View};
use watcher::Watcher;

/// Shows what a running Takt does, twice a second. `q` leaves it. Tab shows the values that --watch names, and the
/// overview again; arrows, PageUp, PageDown, Home and End move through the values.
#[derive(Parser)]
#[command(name = "takt-top", version, after_help = command::AFTER_HELP)]
pub struct Cli {
    /// The partition file that Takt runs, or its control socket.
    #[arg(value_name = "FILE|SOCKET")]
    pub place: PathBuf,
    /// Show these values of the PLCs' programs on a page of their own, which comes first: names of variables or of parts of
    /// them, such as tank.level; `*` is any text. Needs the partition file.
    #[arg(long, value_name = "NAME")]
    pub watch: Vec<String>,
    /// The control socket, if it is not that of the file.
    #[arg(long, value_name = "SOCKET")]
    pub control: Option<PathBuf>,
}

/// Time between two questions.
const PERIOD: Duration = Duration::from_millis(500);

/// Shows the screen until the user leaves it.
///
/// # Errors
/// If no Takt answers at the start, or the terminal fails.
pub fn run(cli: &Cli) -> Result<(), ClientError> {
    let socket = match &cli.control {
        Some(control) => control.clone(),
        None => takt_client::socket(&cli.place)?,
    };
    let mut view = View::default();
    let mut watcher = watcher(cli, &socket, &mut view)?;
    let socket = &*socket;
    // Before the terminal is changed: who finds no Takt sees an ordinary message.
    let first = connect(socket, &mut view)?;
    // Puts the terminal back at a panic, too.
    let mut terminal = ratatui::try_init().map_err(ClientError::Terminal)?;
    let result = show(socket, &mut terminal, &mut view, first, watcher.as_mut());
    ratatui::restore();
    result.map_err(ClientError::Terminal)
}

/// What fetches the values that the user has named, if there are any.
fn watcher(cli: &Cli, socket: &Path, view: &mut View) -> Result<Option<Watcher>, ClientError> {
    if cli.watch.is_empty() {
        return Ok(None);
    }
    if socket == cli.place {
        let message = "--watch takes the partition file instead of its control socket: names are those of the \
                       images in the file; if Takt was started with --control PATH, give that with --control, too";
        return Err(ClientError::Usage(message.to_owned()));
    }
    let watcher = Watcher::new(&cli.place, &cli.watch, PERIOD)?;
    view.watched = watcher.watched();
    view.page = Page::Values;
    Ok(Some(watcher))
}

fn show(
    socket: &Path,
    terminal: &mut DefaultTerminal,
    view: &mut View,
    first: Connection,
    mut watcher: Option<&mut Watcher>,
) -> io::Result<()> {
    let mut connection = Some(first);
    loop {
        if let Some(watcher) = watcher.as_deref_mut() {
            fetch(socket, watcher, view);
        }
        terminal.draw(|frame| draw::screen(frame, view))?;
        let next = Instant::now() + PERIOD;
        while let Some(left) = next.checked_duration_since(Instant::now()) {
            if !event::poll(left)? {
                break;
            }
            match event::read()? {
                Event::Key(key) if leaves(&key) => return Ok(()),
                Event::Key(key) if turns(&key) => {
                    view.turn();
                    break;
                }
                Event::Key(key) if view.page == Page::Values => {
                    let rows = usize::from(terminal.size()?.height);
                    scroll(view, &key, rows);
                    terminal.draw(|frame| draw::screen(frame, view))?;
                }
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

fn turns(key: &KeyEvent) -> bool {
    key.kind == KeyEventKind::Press && key.code == KeyCode::Tab
}

/// Moves through the values, on a screen of so many rows.
fn scroll(view: &mut View, key: &KeyEvent, rows: usize) {
    // The head has two; of two pages one row is the same.
    let (room, at) = (rows.saturating_sub(2), view.scrolled);
    let last = values_page::lines(&view.watched).saturating_sub(room);
    let to = match key.code {
        KeyCode::Up => at.saturating_sub(1),
        KeyCode::Down => at.saturating_add(1),
        KeyCode::PageUp => at.saturating_sub(room.saturating_sub(1)),
        KeyCode::PageDown => at.saturating_add(room.saturating_sub(1)),
        KeyCode::Home => 0,
        KeyCode::End => last,
        _ => at,
    };
    view.scrolled = to.min(last);
}

/// Takes the latest values if they are shown.
fn fetch(socket: &Path, watcher: &mut Watcher, view: &mut View) {
    if view.page != Page::Values {
        watcher.rest();
        return;
    }
    let updated = watcher.update(socket, &mut view.watched);
    view.values_problem = updated.err().map(|error| error.to_string());
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
