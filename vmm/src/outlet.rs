//! Output to what may not take it: a pipe whose reader has stopped, a slow terminal, a stuck disk.
//!
//! A write to any of these can wait for ever, and a descriptor that others have too, as standard output,
//! must not be made one that never waits: the setting is theirs as well. So each outlet has a thread
//! whose only work is to write, and a bounded queue before it. A thread that puts something into the queue never
//! waits: what finds no room is refused, and the caller counts it.
//!
//! ```text
//! supervisor thread -- push --> queue, bounded by lane --> thread of the outlet -- write --> pipe, file, ...
//! ```
//!
//! The room is divided into lanes, so that one who fills his takes nothing of another's. The order of
//! all that was accepted is kept. The thread is of the ordinary class; nothing waits for it but the end
//! of the run, and that for a bounded time ([`settle`](Outlet::settle)). It is never joined: a thread
//! that hangs in a write does not keep the process from ending.

use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::mem::ManuallyDrop;
use std::os::fd::{AsRawFd, FromRawFd};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::handoff::lock;
use crate::sandbox::{Kind, Mode};
use crate::vcpu::thread::{self, ThreadError};

/// What a piece takes of its lane beside its bytes, so that many small ones are bounded too.
const OVERHEAD: usize = 64;
/// Most bytes of one write to standard output: what a slow reader takes is seen in steps of this.
const STEP: usize = 1024;

/// Where an outlet's thread writes.
pub trait Sink: Send + 'static {
    /// Writes all of a piece, and says how far it has got. May take as long as it takes.
    ///
    /// # Errors
    /// If not all of it is written.
    fn put(&mut self, piece: &[u8], written: &mut dyn FnMut(usize)) -> io::Result<()>;

    /// Whether later pieces make sense when one could not be written.
    fn goes_on(&self) -> bool;
}

/// There is no room in the lane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Full;

/// The entrance of an outlet.
pub struct Outlet {
    sender: Sender<Message>,
    shared: Arc<Shared>,
}

enum Message {
    Piece {
        lane: usize,
        bytes: Vec<u8>,
    },
    /// All that came before has been dealt with.
    Settled(Sender<()>),
}

struct Lane {
    /// Most bytes that may wait, [`OVERHEAD`] included.
    quota: usize,
    waiting: AtomicUsize,
}

struct Shared {
    lanes: Box<[Lane]>,
    /// Bytes that were accepted.
    put: AtomicU64,
    /// Bytes that were written.
    written: AtomicU64,
    /// Pieces that were written whole.
    pieces: AtomicU64,
    /// Set once nothing is written any more.
    ended: AtomicBool,
    /// The first error, until somebody has asked for it.
    error: Mutex<Option<io::Error>>,
}

impl Outlet {
    /// Starts the thread, shut in as one that writes. Each lane has its quota, in bytes.
    ///
    /// # Errors
    /// See [`ThreadError`].
    pub fn start(
        name: &str,
        mode: Mode,
        quotas: &[usize],
        sink: impl Sink,
    ) -> Result<Self, ThreadError> {
        let (outlet, work) = Self::new(quotas, sink);
        thread::detached(name, (Kind::Writer, mode), work)?;
        Ok(outlet)
    }

    /// An outlet, and what its thread has to do.
    pub(crate) fn new<S: Sink>(quotas: &[usize], sink: S) -> (Self, impl FnOnce() + Send + use<S>) {
        let (sender, messages) = channel();
        let lane = |&quota| Lane { quota, waiting: AtomicUsize::new(0) };
        let shared = Arc::new(Shared {
            lanes: quotas.iter().map(lane).collect(),
            put: AtomicU64::new(0),
            written: AtomicU64::new(0),
            pieces: AtomicU64::new(0),
            ended: AtomicBool::new(false),
            error: Mutex::new(None),
        });
        let own = shared.clone();
        (Self { sender, shared }, move || own.serve(&messages, sink))
    }

    /// Puts a piece into the queue. Never waits.
    ///
    /// # Errors
    /// If there is no room for all of it; then nothing is taken.
    pub fn push(&self, lane: usize, bytes: &[u8]) -> Result<(), Full> {
        if bytes.is_empty() {
            return Ok(());
        }
        let waiting = &self.shared.lanes.get(lane).ok_or(Full)?.waiting;
        if self.room(lane) < bytes.len() || self.has_ended() {
            return Err(Full);
        }
        waiting.fetch_add(bytes.len() + OVERHEAD, Ordering::SeqCst);
        self.shared.put.fetch_add(bytes.len() as u64, Ordering::SeqCst);
        let message = Message::Piece { lane, bytes: bytes.to_owned() };
        self.sender.send(message).map_err(|_| Full)
    }

    /// Bytes that a piece may have now.
    #[must_use]
    pub fn room(&self, lane: usize) -> usize {
        let Some(lane) = self.shared.lanes.get(lane) else { return 0 };
        let waiting = lane.waiting.load(Ordering::SeqCst);
        lane.quota.saturating_sub(waiting).saturating_sub(OVERHEAD)
    }

    /// Bytes that wait in all lanes, with what keeping them takes.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.shared.lanes.iter().map(|lane| lane.waiting.load(Ordering::SeqCst)).sum()
    }

    /// Bytes that wait, without what keeping them takes, and those that could not be written.
    #[must_use]
    pub fn unwritten(&self) -> u64 {
        let put = self.shared.put.load(Ordering::SeqCst);
        put.saturating_sub(self.written())
    }

    /// Bytes that were written so far: as long as they grow, the reader takes them.
    #[must_use]
    pub fn written(&self) -> u64 {
        self.shared.written.load(Ordering::SeqCst)
    }

    /// Pieces that were written whole.
    #[must_use]
    pub fn pieces(&self) -> u64 {
        self.shared.pieces.load(Ordering::SeqCst)
    }

    /// True once an error has ended all writing.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.shared.ended.load(Ordering::SeqCst)
    }

    /// The first error, once.
    #[must_use]
    pub fn take_error(&self) -> Option<io::Error> {
        lock(&self.shared.error).take()
    }

    /// Waits until all is written that was put in before: for as long as some of it is written within
    /// each `patience`, and no longer than `most`. True if it is.
    pub fn settle(&self, patience: Duration, most: Duration) -> bool {
        let (tell, told) = channel();
        if self.sender.send(Message::Settled(tell)).is_err() {
            return false;
        }
        let begun = Instant::now();
        loop {
            let before = self.written();
            let left = most.saturating_sub(begun.elapsed());
            match told.recv_timeout(patience.min(left)) {
                Ok(()) => return true,
                Err(RecvTimeoutError::Disconnected) => return false,
                Err(RecvTimeoutError::Timeout) => {}
            }
            if self.written() == before || begun.elapsed() >= most {
                return false;
            }
        }
    }
}

impl Shared {
    /// What the thread does, until there is no entrance any more.
    fn serve(&self, messages: &Receiver<Message>, mut sink: impl Sink) {
        for message in messages {
            match message {
                Message::Settled(tell) => {
                    // A sender that has given up waiting needs no answer.
                    let _ = tell.send(());
                }
                Message::Piece { lane, bytes } => {
                    let Some(lane) = self.lanes.get(lane) else { continue };
                    let left = self.write(&mut sink, lane, &bytes);
                    lane.waiting.fetch_sub(left + OVERHEAD, Ordering::SeqCst);
                }
            }
        }
    }

    /// Writes a piece; returns how many of its bytes were not.
    fn write(&self, sink: &mut impl Sink, lane: &Lane, bytes: &[u8]) -> usize {
        let mut left = bytes.len();
        let mut written = |count: usize| {
            let count = count.min(left);
            left -= count;
            lane.waiting.fetch_sub(count, Ordering::SeqCst);
            self.written.fetch_add(count as u64, Ordering::SeqCst);
        };
        let result =
            if self.ended.load(Ordering::SeqCst) { Ok(()) } else { sink.put(bytes, &mut written) };
        if let Err(error) = result {
            lock(&self.error).get_or_insert(error);
            self.ended.store(!sink.goes_on(), Ordering::SeqCst);
        }
        if left == 0 {
            self.pieces.fetch_add(1, Ordering::SeqCst);
        }
        left
    }
}

/// The trace of a run, which goes through an outlet.
pub type Trace = takt_figures::trace::Trace<LaneWriter>;

/// A lane of an outlet as something to write to: each write is a piece, all of it or, as `WouldBlock`,
/// nothing.
pub struct LaneWriter {
    /// The outlet.
    pub outlet: Arc<Outlet>,
    /// The lane.
    pub lane: usize,
}

impl Write for LaneWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.outlet.push(self.lane, bytes) {
            Ok(()) => Ok(bytes.len()),
            Err(Full) => Err(ErrorKind::WouldBlock.into()),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Standard output, whatever that is.
pub struct StandardOutput(ManuallyDrop<File>);

impl StandardOutput {
    /// The descriptor as it was inherited; it is not closed at the end.
    #[must_use]
    pub fn new() -> Self {
        // SAFETY: only writes to descriptor 1, which stays open: it is never dropped. Should it have been
        // closed before the start, a write fails.
        Self(ManuallyDrop::new(unsafe { File::from_raw_fd(libc::STDOUT_FILENO) }))
    }
}

impl Default for StandardOutput {
    fn default() -> Self {
        Self::new()
    }
}

impl Sink for StandardOutput {
    fn put(&mut self, piece: &[u8], written: &mut dyn FnMut(usize)) -> io::Result<()> {
        let mut rest = piece;
        while let Some(step) = rest.get(..rest.len().min(STEP)).filter(|step| !step.is_empty()) {
            match self.0.write(step) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => {
                    written(count);
                    rest = rest.get(count..).unwrap_or_default();
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // Another process has made it a descriptor that never waits.
                Err(error) if error.kind() == ErrorKind::WouldBlock => wait_for_room(&self.0)?,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// A reader may come back. That there is none is no reason to end a run.
    fn goes_on(&self) -> bool {
        true
    }
}

fn wait_for_room(file: &File) -> io::Result<()> {
    has_room(file, -1).map(drop)
}

/// Whether something can be written, after at most so many milliseconds.
fn has_room(file: &impl AsRawFd, at_most: libc::c_int) -> io::Result<bool> {
    let mut entry = libc::pollfd { fd: file.as_raw_fd(), events: libc::POLLOUT, revents: 0 };
    // SAFETY: one live entry.
    match unsafe { libc::poll(&raw mut entry, 1, at_most) } {
        0.. => Ok(entry.revents & libc::POLLOUT != 0),
        _ => Err(io::Error::last_os_error()),
    }
}

/// Whether standard error takes the last words of a process that ends badly. A slow console gets its time, and a reader that takes
/// nothing does not keep the process from its end, for which the guardian waits. Safe in a signal handler.
pub fn takes_last_words() -> bool {
    has_room_within(&io::stderr(), Duration::from_millis(500))
}

/// Whether something can be written within that time, also if the thread gets signals meanwhile: one with windows is kicked at the
/// end of each.
fn has_room_within(file: &impl AsRawFd, most: Duration) -> bool {
    let until = Instant::now() + most;
    loop {
        let rest = until.saturating_duration_since(Instant::now());
        let at_most = libc::c_int::try_from(rest.as_millis()).unwrap_or(libc::c_int::MAX);
        match has_room(file, at_most) {
            Err(error) if error.kind() == ErrorKind::Interrupted && !rest.is_zero() => {}
            room => return room.is_ok_and(|room| room),
        }
    }
}

/// Writes a line of Takt's own past all outlets, once the run is over. It is left out if its reader does not take it at
/// once: what is still to be given back does not wait for that.
pub fn last_line(output: &mut (impl Write + AsRawFd), text: &str) {
    if has_room(output, 0).is_ok_and(|room| room) {
        // The reader may have gone.
        let _ = writeln!(output, "[takt] {text}");
    }
}

/// A file that grows.
impl Sink for File {
    fn put(&mut self, piece: &[u8], written: &mut dyn FnMut(usize)) -> io::Result<()> {
        self.write_all(piece)?;
        written(piece.len());
        Ok(())
    }

    fn goes_on(&self) -> bool {
        false
    }
}

#[cfg(test)]
#[path = "outlet_tests.rs"]
mod tests;
