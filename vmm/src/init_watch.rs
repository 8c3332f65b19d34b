//! Noticing that Linux has started its first process, or that its kernel has panicked.
//!
//! An unmodified guest does not tell Takt so, but it tells its console: every kernel since 5.0
//! prints "Run /init as init process" just before it leaves kernel mode for the first time. That
//! line is watched for in the output, and so is the one that a kernel prints when it panics. They are
//! used only for the report and a message, since a guest can print what it likes.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use takt_devices::output::ConsoleOutput;
use takt_devices::serial::SerialPort;
use takt_scheduler::time::Tsc;

const BEFORE: &[u8] = b"Run /";
const AFTER: &[u8] = b" as init process";
/// `panic` in the kernel's `kernel/panic.c`.
const PANIC: &[u8] = b"Kernel panic - not syncing";
/// Of longer lines only the beginning is looked at, for a panic.
const LINE_MAX: usize = 160;

/// When the line was seen.
#[derive(Clone, Debug, Default)]
pub struct InitSeen(Arc<AtomicU64>);

impl InitSeen {
    /// The instant at which the line was complete; `None` before that.
    #[must_use]
    pub fn instant(&self) -> Option<Tsc> {
        Some(self.0.load(Ordering::Relaxed)).filter(|&tsc| tsc != 0).map(Tsc)
    }
}

/// When the kernel has said that it panics.
#[derive(Clone, Debug, Default)]
pub struct PanicSeen(Arc<AtomicU64>);

impl PanicSeen {
    /// The instant at which it had said so; `None` before that.
    #[must_use]
    pub fn instant(&self) -> Option<Tsc> {
        Some(self.0.load(Ordering::Relaxed)).filter(|&tsc| tsc != 0).map(Tsc)
    }

    /// Another kernel runs now.
    pub fn forget(&self) {
        self.0.store(0, Ordering::Relaxed);
    }
}

/// The serial port of the Linux guest, watched, and through a ring to the supervisor thread.
pub type Console = SerialPort<InitWatch<Box<dyn ConsoleOutput + Send>>>;

/// Passes console output on and watches it.
pub struct InitWatch<W> {
    out: W,
    line: [u8; LINE_MAX],
    length: usize,
    seen: InitSeen,
    panic: PanicSeen,
}

impl<W: Write> InitWatch<W> {
    /// Watches what goes to `out`.
    pub fn new(out: W, seen: InitSeen, panic: PanicSeen) -> Self {
        Self { out, line: [0; LINE_MAX], length: 0, seen, panic }
    }

    fn watch(&mut self, byte: u8) {
        if byte != b'\n' {
            if let Some(slot) = self.line.get_mut(self.length) {
                *slot = byte;
            }
            self.length = self.length.saturating_add(1);
            return;
        }
        let contains = |line: &[u8], part: &[u8]| line.windows(part.len()).any(|w| w == part);
        let beginning = &self.line[..self.length.min(LINE_MAX)];
        if self.panic.instant().is_none() && contains(beginning, PANIC) {
            self.panic.0.store(Tsc::now().0, Ordering::Relaxed);
        }
        let line = self.line.get(..self.length).unwrap_or(&[]).trim_ascii_end();
        self.length = 0;
        if self.seen.instant().is_none() && line.ends_with(AFTER) && contains(line, BEFORE) {
            self.seen.0.store(Tsc::now().0, Ordering::Relaxed);
        }
    }
}

impl<W: ConsoleOutput> ConsoleOutput for InitWatch<W> {
    fn would_wait(&self, bytes: usize) -> bool {
        self.out.would_wait(bytes)
    }

    fn begin_anew(&mut self) {
        self.length = 0;
        self.out.begin_anew();
    }
}

impl<W: Write> Write for InitWatch<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        for &byte in bytes.iter().take(written) {
            self.watch(byte);
        }
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether an init and a panic are seen in a console's output.
    fn both(text: &[u8]) -> (bool, bool) {
        let (seen, panic) = (InitSeen::default(), PanicSeen::default());
        let mut out = Vec::new();
        InitWatch::new(&mut out, seen.clone(), panic.clone()).write_all(text).unwrap();
        assert_eq!(out, text);
        let panicked = panic.instant().is_some();
        panic.forget();
        assert_eq!(panic.instant(), None);
        (seen.instant().is_some(), panicked)
    }

    fn sees(text: &[u8]) -> bool {
        both(text).0
    }

    #[test]
    fn the_kernels_line_is_recognised() {
        assert!(sees(b"[    1.234567] Run /init as init process\r\n"));
        assert!(sees(b"noise\nRun /sbin/init as init process\n"));
    }

    #[test]
    fn a_line_ends_with_the_guest_that_began_it() {
        let panic = PanicSeen::default();
        let mut watch = InitWatch::new(Vec::new(), InitSeen::default(), panic.clone());
        watch.write_all(b"Kernel panic - not syncing: no line end").unwrap();
        watch.begin_anew();
        watch.write_all(b"Linux version 6.1\n").unwrap();
        assert_eq!(panic.instant(), None);
    }

    #[test]
    fn other_lines_are_not() {
        assert!(!sees(b"Run /init as init process"));
        assert!(!sees(b"  with arguments: Run /init as init process x\n"));
        assert!(!sees(b" as init process\n"));
        let mut long = vec![b'x'; 1 << 20];
        long.extend(b"Run /init as init process\n");
        assert!(!sees(&long));
    }

    #[test]
    fn a_panic_is_recognised_also_in_a_long_line() {
        assert_eq!(
            both(b"[    3.2] Kernel panic - not syncing: Fatal exception\r\n"),
            (false, true)
        );
        assert_eq!(both(b"Kernel panic - not syncing: x"), (false, false));
        let mut long = b"[    3.2] Kernel panic - not syncing: ".to_vec();
        long.extend([b'x'; 4096]);
        long.push(b'\n');
        assert_eq!(both(&long), (false, true));
        long.rotate_left(1000);
        assert_eq!(both(&long), (false, false));
    }
}
