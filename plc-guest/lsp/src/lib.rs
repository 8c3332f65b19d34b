//! The language server of Structured Text: what the compiler knows, told to an editor (Language Server Protocol 3.17).
//!
//! The server has one thread that works and one that reads. It takes all messages that have come before it
//! checks anything: of a burst of changes only the last is checked, and no clock is needed for that. An answer
//! always belongs to the text as the messages before the request have made it.
//!
//! [`server::Server`] takes messages and gives messages; it knows no stream, so tests see the same answers each
//! time. [`transport`] bounds what a client can make it read. Text comes from the editor where a file is open, else
//! from the disk; `workspace` says which files belong together.

mod analysis;
mod answers;
mod documents;
mod position;
pub mod server;
pub mod transport;
mod uri;
mod workspace;

use std::io::{BufRead, Write};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};

use server::{Server, Step};
use transport::{Incoming, ReadError};

/// The messages that wait for the server. A client that is faster waits itself.
const QUEUE: usize = 256;

/// How a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// With `shutdown` and `exit`.
    Asked,
    /// With `exit` or the end of the input alone.
    Abrupt,
}

/// Serves one client until it ends the session.
///
/// # Errors
///
/// If what the client sends is no message, or it takes no answer.
pub fn run(
    input: impl BufRead + Send + 'static,
    output: impl Write,
) -> Result<End, Box<dyn std::error::Error>> {
    let (sender, messages) = sync_channel(QUEUE);
    // It is left alone at the end: it may wait for input that never comes.
    std::thread::Builder::new().name("input".to_owned()).spawn(move || {
        let mut input = input;
        loop {
            let one = transport::read(&mut input);
            let last = !matches!(one, Ok(Some(_)));
            if sender.send(one).is_err() || last {
                return;
            }
        }
    })?;
    serve(&messages, output)
}

type Read = Result<Option<Incoming>, ReadError>;

fn serve(
    messages: &Receiver<Read>,
    mut output: impl Write,
) -> Result<End, Box<dyn std::error::Error>> {
    let mut server = Server::new();
    loop {
        let next = match messages.try_recv() {
            Ok(next) => next,
            Err(TryRecvError::Empty) => {
                for message in server.rest() {
                    transport::write(&mut output, &message)?;
                }
                match messages.recv() {
                    Ok(next) => next,
                    Err(_) => return Ok(End::Abrupt),
                }
            }
            Err(TryRecvError::Disconnected) => return Ok(End::Abrupt),
        };
        match next? {
            None => return Ok(End::Abrupt),
            Some(Incoming::Unreadable(answer)) => transport::write_text(&mut output, &answer)?,
            Some(Incoming::Message(message)) => {
                let step = server.take(message);
                for message in server.sent() {
                    transport::write(&mut output, &message)?;
                }
                if let Step::Exit(end) = step {
                    return Ok(end);
                }
            }
        }
    }
}
