//! From standard input to the guest.

use std::io::{self, Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::Duration;

use takt_client::RequestSender;
use takt_protocol::{Request, TYPED_MAX};

use super::keys::Keys;

/// Pieces of at most [`TYPED_MAX`] bytes that wait for the guest: a long text that somebody pastes while it boots.
const WAITING: usize = 64;
/// How long to wait before a guest that has no room is tried again.
const AGAIN: Duration = Duration::from_millis(20);

/// What ends the connection because the user wants it.
pub struct End {
    left: Arc<AtomicBool>,
    takt: RequestSender,
}

impl End {
    /// Ends this connection, after it has said so in `left`.
    pub fn new(left: Arc<AtomicBool>, takt: RequestSender) -> Self {
        Self { left, takt }
    }

    fn end(&self) {
        self.left.store(true, Ordering::SeqCst);
        self.takt.end();
    }
}

/// Starts both threads. At a terminal (`raw`) the keys of this program are found, and what there is no room for is
/// dropped; a program behind a pipe waits. `told` says how many bytes of each request were taken.
pub fn start(partition: String, raw: bool, ends: (End, End), told: Receiver<u64>) {
    let (reader, typist) = ends;
    let (queue, pieces) = sync_channel(WAITING);
    thread::spawn(move || read(raw, &reader, &queue));
    let mut typist = Typist { partition, end: typist, told };
    thread::spawn(move || typist.serve(&pieces));
}

fn read(raw: bool, end: &End, queue: &SyncSender<Vec<u8>>) {
    let (mut input, mut keys) = (io::stdin().lock(), Keys::default());
    let mut buffer = [0; TYPED_MAX / 2];
    while let Ok(count @ 1..) = input.read(&mut buffer) {
        let typed = buffer.get(..count).unwrap_or_default();
        // A program that types has no keys of its own.
        let (bytes, leaves) = if raw { keys.take(typed) } else { (typed.to_vec(), false) };
        let count = bytes.len();
        match queue.try_send(bytes) {
            Err(TrySendError::Full(bytes)) if !raw => {
                if queue.send(bytes).is_err() {
                    return;
                }
            }
            Err(TrySendError::Full(_)) => {
                let mut told = io::stderr();
                let text = format!("{count} bytes dropped: the guest takes none");
                let _ = write!(told, "\r\ntakt-console: {text}\r\n");
            }
            Err(TrySendError::Disconnected(_)) => return,
            Ok(()) => {}
        }
        if leaves {
            end.end();
            return;
        }
    }
}

struct Typist {
    partition: String,
    end: End,
    told: Receiver<u64>,
}

impl Typist {
    /// Types all pieces; then the input has ended, and so does the connection.
    fn serve(&mut self, pieces: &Receiver<Vec<u8>>) {
        for piece in pieces {
            if self.type_all(&piece).is_none() {
                return;
            }
        }
        self.end.end();
    }

    /// Types all of it, however often that takes; `None` if the connection is lost.
    fn type_all(&mut self, mut bytes: &[u8]) -> Option<()> {
        while !bytes.is_empty() {
            let piece = bytes.get(..bytes.len().min(TYPED_MAX))?;
            self.end.takt.send(&Request::Type(self.partition.clone(), piece.to_vec())).ok()?;
            let taken = usize::try_from(self.told.recv().ok()?).ok()?;
            bytes = bytes.get(taken..)?;
            if !bytes.is_empty() {
                thread::sleep(AGAIN);
            }
        }
        Some(())
    }
}
