//! What is typed, on its way to the guest: bounded, whether a person or a program types.
//!
//! A guest takes what it likes, and a program can type without end. So no more than [`PER_TICK`] is read
//! in a tick, and no more than [`PENDING`] is kept. What happens then depends on who types. A program
//! behind a pipe can wait: nothing is read until there is room, and nothing is lost. At a terminal the
//! keys that are Takt's own must be found, above all by one whose guest hangs; so it is read on, and what
//! there is no room for is dropped, counted and told of.

use std::fs::File;
use std::io::Read;
use std::mem::ManuallyDrop;
use std::os::fd::FromRawFd;

use crate::terminal::{Key, Keyboard};

/// Most bytes that are read in a tick: what the serial port keeps, and more than any person types.
const PER_TICK: usize = 4096;
/// Most bytes that are kept for a guest that does not take them: a long text that somebody pastes while
/// it boots.
const PENDING: usize = 64 << 10;

/// Standard input, and what of it the guest has not taken.
pub(super) struct Typing<R = Keys> {
    input: R,
    /// Bytes that were read since the last tick.
    read: usize,
    keyboard: Keyboard,
    pending: Vec<u8>,
    is_terminal: bool,
    /// Bytes that found no room, and were not told of.
    dropped: u64,
}

/// Standard input without a buffer: what is read is what an event has announced, and all of it.
pub(super) struct Keys(ManuallyDrop<File>);

impl Read for Keys {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Typing {
    /// Of standard input; whether that is a terminal decides what happens when there is no room.
    pub fn new(is_terminal: bool) -> Self {
        // SAFETY: only reads from descriptor 0, which stays open: it is never dropped. Should it have been
        // closed before the start, a read fails.
        let input = Keys(ManuallyDrop::new(unsafe { File::from_raw_fd(libc::STDIN_FILENO) }));
        Self::of(input, is_terminal)
    }
}

impl<R: Read> Typing<R> {
    fn of(input: R, is_terminal: bool) -> Self {
        let (keyboard, pending) = (Keyboard::default(), Vec::new());
        Self { input, read: 0, keyboard, pending, is_terminal, dropped: 0 }
    }

    /// Whether input that waits may be read now.
    pub fn may_read(&self) -> bool {
        let has_room = self.pending.len() + PER_TICK <= PENDING;
        self.read < PER_TICK && (has_room || self.is_terminal)
    }

    /// Reads what waits, once; `None` if there will never be more, as where another process group has got the terminal (`EIO`).
    pub fn take(&mut self) -> Option<Vec<Key>> {
        let mut buffer = [0; PER_TICK];
        let most = PER_TICK - self.read;
        let read = self.input.read(buffer.get_mut(..most)?).ok().filter(|read| *read > 0)?;
        self.read += read;
        Some(self.keyboard.take(buffer.get(..read)?))
    }

    /// Keeps a byte for the guest.
    pub fn keep(&mut self, byte: u8) {
        if self.pending.len() < PENDING {
            self.pending.push(byte);
        } else {
            self.dropped += 1;
        }
    }

    /// Brings what is kept to the guest, which takes as much as it says.
    pub fn deliver(&mut self, guest: impl FnOnce(&[u8]) -> usize) {
        let taken = guest(&self.pending).min(self.pending.len());
        self.pending.drain(..taken);
    }

    /// A tick has passed. Returns how many bytes were dropped since this was told, once there is room
    /// again.
    pub fn tick(&mut self) -> Option<u64> {
        self.read = 0;
        let tells = self.dropped > 0 && self.pending.len() < PENDING;
        tells.then(|| std::mem::take(&mut self.dropped))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As `yes` does.
    struct Yes;

    impl Read for Yes {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            buffer.fill(b'y');
            Ok(buffer.len())
        }
    }

    /// What the supervisor thread does in a tick, with a guest that takes so much of it. Returns what was read.
    fn turn<R: Read>(typing: &mut Typing<R>, taken: usize) -> usize {
        let mut read = 0;
        while typing.may_read() {
            for key in typing.take().unwrap() {
                read += 1;
                if let Key::Byte(byte) = key {
                    typing.keep(byte);
                }
            }
            typing.deliver(|bytes| bytes.len().min(taken));
        }
        read
    }

    #[test]
    fn a_program_that_types_without_end_waits_for_the_guest() {
        let mut typing = Typing::of(Yes, false);
        let mut all = 0;
        for _ in 0..1_000 {
            all += turn(&mut typing, 0);
            assert_eq!(typing.tick(), None);
        }
        assert_eq!((all, typing.pending.len()), (PENDING, PENDING));
        assert!(typing.pending.capacity() <= 2 * PENDING);
        // It goes on as the guest takes it, and nothing is lost.
        typing.deliver(|_| PER_TICK);
        assert_eq!(turn(&mut typing, 0), PER_TICK);
        assert_eq!(typing.tick(), None);
    }

    #[test]
    fn without_a_guest_to_type_to_no_more_is_read_than_in_a_tick() {
        let mut typing = Typing::of(Yes, false);
        for _ in 0..100 {
            assert_eq!(turn(&mut typing, usize::MAX), PER_TICK);
            assert!(!typing.may_read() && typing.pending.is_empty());
            typing.tick();
        }
    }

    #[test]
    fn at_a_terminal_the_way_out_is_found_behind_any_flood() {
        let mut typing = Typing::of(Yes.take(200_000).chain(&b"\x1dq"[..]), true);
        let mut ticks = 0;
        let found = loop {
            ticks += 1;
            assert!(ticks < 100);
            typing.tick();
            let keys = typing.take().unwrap();
            if keys.contains(&Key::Quit) {
                break ticks;
            }
            for key in keys {
                if let Key::Byte(byte) = key {
                    typing.keep(byte);
                }
            }
        };
        assert!(found >= 200_000 / PER_TICK);
        assert_eq!(typing.pending.len(), PENDING);
        assert_eq!(typing.tick(), None, "it is told before there is room");
        typing.deliver(|_| 1);
        assert_eq!(typing.tick(), Some(200_000 - PENDING as u64));
        assert_eq!(typing.tick(), None);
    }
}
