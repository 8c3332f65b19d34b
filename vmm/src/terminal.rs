//! The terminal: one keyboard for all guests, and a mode in which it is theirs.
//!
//! What is typed goes to Linux, byte by byte and unchanged, so the terminal is put into raw mode
//! and put back at every end of the run, also at that of a panic. One key is kept back, so that
//! there is always a way out: `Ctrl-]` and then `q` ends the run, `s` asks for the next schedule,
//! and `Ctrl-]` twice types it. What is shown, and how, is [`screen`](crate::screen)'s.
//!
//! A shell that starts Takt in the background, or `timeout`, keeps the terminal for another process group. Takt then neither sets
//! nor reads it. The kernel's answer to both is a signal that stops the whole process, with CPUs taken and outputs as they are.

use std::fmt::Display;
use std::io::{self, Write};
use std::mem::MaybeUninit;
use std::sync::Mutex;

/// The key that is kept back: `Ctrl-]`.
const ESCAPE: u8 = 0x1d;

/// The terminal's settings before it was made raw.
static SAVED: Mutex<Option<libc::termios>> = Mutex::new(None);

/// Writes a line to standard error. If that cannot be written, it is left out: `eprintln!` would end the process instead, with
/// devices still taken.
pub fn tell(line: impl Display) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Makes the use of a terminal from the background an error, or what it would be in the foreground, and no stop of the process:
/// its group can lose the terminal in the middle of a run.
pub fn ignore_job_control() {
    for signal in [libc::SIGTTOU, libc::SIGTTIN] {
        // SAFETY: the signal has no handler that could be lost.
        unsafe { libc::signal(signal, libc::SIG_IGN) };
    }
}

/// Whether no other process group has the terminal on standard input. Only the terminal that controls this process tells
/// groups apart, and neither does what is no terminal.
#[must_use]
pub fn is_ours() -> bool {
    // SAFETY: neither call takes a pointer.
    let (foreground, own) = unsafe { (libc::tcgetpgrp(libc::STDIN_FILENO), libc::getpgrp()) };
    foreground < 0 || foreground == own
}

/// Puts the terminal on standard input into raw mode; does nothing if it is none, or not
/// [ours](is_ours). Returns whether it is raw now.
///
/// # Errors
/// What the terminal says.
pub fn make_raw() -> io::Result<bool> {
    let mut settings = MaybeUninit::<libc::termios>::uninit();
    // SAFETY: isatty and tcgetattr look at descriptor 0; the latter fills in the structure.
    let known = is_ours()
        && unsafe {
            libc::isatty(libc::STDIN_FILENO) == 1
                && libc::tcgetattr(libc::STDIN_FILENO, settings.as_mut_ptr()) == 0
        };
    if !known {
        return Ok(false);
    }
    // SAFETY: tcgetattr succeeded, so it is filled in.
    let saved = unsafe { settings.assume_init() };
    let mut raw = saved;
    // SAFETY: changes a live structure, and then descriptor 0 by it.
    let result = unsafe {
        libc::cfmakeraw(&raw mut raw);
        libc::tcsetattr(libc::STDIN_FILENO, libc::TCSANOW, &raw const raw)
    };
    if result != 0 {
        return Err(io::Error::last_os_error());
    }
    if let Ok(mut slot) = SAVED.lock() {
        *slot = Some(saved);
    }
    let default = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        restore();
        default(panic);
    }));
    Ok(true)
}

/// Puts the terminal back as it was; harmless if it was never changed. It does not wait for what is still
/// to be shown, which is shown as it was written, nor for a lock: safe in a signal handler.
pub fn restore() {
    if let Some(saved) = SAVED.try_lock().ok().and_then(|mut slot| slot.take()) {
        // SAFETY: the structure is the one that tcgetattr filled in. An error leaves a terminal
        // that is gone, and nothing to put back.
        unsafe { libc::tcsetattr(libc::STDIN_FILENO, libc::TCSANOW, &raw const saved) };
    }
}

/// What the keyboard asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// This byte is for the guest.
    Byte(u8),
    /// The run shall end.
    Quit,
    /// The next schedule shall hold.
    NextSchedule,
}

/// Finds the escape in what is typed.
#[derive(Debug, Default)]
pub struct Keyboard {
    escaped: bool,
}

impl Keyboard {
    /// Splits typed bytes into what the guest gets and what Takt does.
    pub fn take(&mut self, typed: &[u8]) -> Vec<Key> {
        let mut keys = Vec::with_capacity(typed.len());
        for &byte in typed {
            match (std::mem::take(&mut self.escaped), byte) {
                (false, ESCAPE) => self.escaped = true,
                (true, b'q') => keys.push(Key::Quit),
                (true, b's') => keys.push(Key::NextSchedule),
                (true, ESCAPE) | (false, _) => keys.push(Key::Byte(byte)),
                (true, _) => keys.extend([ESCAPE, byte].map(Key::Byte)),
            }
        }
        keys
    }
}

/// Cuts a PLC's output into lines, however its writes were cut.
#[derive(Debug, Default)]
pub struct Lines {
    partial: Vec<u8>,
}

/// A line longer than this is shown in pieces, so that a guest cannot make it grow.
const LINE_MAX: usize = 512;

impl Lines {
    /// Adds output and calls `show` with each line that is complete. Bytes that are no printable
    /// text are shown escaped: a guest cannot play with the terminal.
    pub fn add(&mut self, bytes: &[u8], mut show: impl FnMut(&str)) {
        for &byte in bytes {
            if byte != b'\n' {
                self.partial.push(byte);
            }
            if byte == b'\n' || self.partial.len() >= LINE_MAX {
                self.flush(&mut show);
            }
        }
    }

    /// Shows what is left of an unfinished line.
    pub fn finish(&mut self, mut show: impl FnMut(&str)) {
        if !self.partial.is_empty() {
            self.flush(&mut show);
        }
    }

    fn flush(&mut self, show: &mut impl FnMut(&str)) {
        let line = self.partial.strip_suffix(b"\r").unwrap_or(&self.partial);
        show(&line.escape_ascii().to_string());
        self.partial.clear();
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::CommandExt;
    use std::process::Command;
    use std::ptr;

    use super::*;

    /// Only in a session of its own can a process group lose the terminal, so this is done by a process of its own.
    #[test]
    fn a_terminal_that_another_process_group_has_is_left_as_it_is() {
        const OWN_PROCESS: &str = "TAKT_TEST_TERMINAL";
        const NAME: &str =
            "terminal::tests::a_terminal_that_another_process_group_has_is_left_as_it_is";
        if std::env::var_os(OWN_PROCESS).is_none() {
            let mut own = Command::new(std::env::current_exe().unwrap());
            let output = own.args(["--exact", NAME]).env(OWN_PROCESS, "1").output().unwrap();
            assert!(output.status.success(), "{output:?}");
            return;
        }
        let (mut other_end, mut terminal) = (-1, -1);
        // SAFETY: the calls fill in two live descriptors, and put one of them in the place of standard input.
        unsafe {
            let (ends, none) = ((&raw mut other_end, &raw mut terminal), ptr::null_mut());
            assert_eq!(libc::openpty(ends.0, ends.1, none, ptr::null(), ptr::null()), 0);
            assert!(libc::setsid() > 0);
            assert_eq!(libc::dup2(terminal, libc::STDIN_FILENO), libc::STDIN_FILENO);
        }
        assert!(is_ours(), "it controls no process yet");
        // SAFETY: takes numbers only.
        assert_eq!(unsafe { libc::ioctl(libc::STDIN_FILENO, libc::TIOCSCTTY, 0) }, 0);
        ignore_job_control();
        assert!(is_ours() && make_raw().unwrap());
        restore();
        let mut other = Command::new("sleep").arg("100").process_group(0).spawn().unwrap();
        // SAFETY: takes numbers only.
        assert_eq!(unsafe { libc::tcsetpgrp(libc::STDIN_FILENO, other.id() as libc::pid_t) }, 0);
        let is_left = !is_ours() && !make_raw().unwrap();
        other.kill().and_then(|()| other.wait()).unwrap();
        assert!(is_left);
    }

    #[test]
    fn the_escape_is_for_takt_and_can_be_typed() {
        let bytes = |text: &[u8]| text.iter().copied().map(Key::Byte).collect::<Vec<_>>();
        let mut keyboard = Keyboard::default();
        assert_eq!(keyboard.take(b"ls\x1d"), bytes(b"ls"));
        assert_eq!(keyboard.take(b"\x1d-\x1dx"), bytes(b"\x1d-\x1dx"));
        assert_eq!(keyboard.take(b"qs"), bytes(b"qs"));
        assert_eq!(keyboard.take(b"\x1dsa"), [Key::NextSchedule, Key::Byte(b'a')]);
        assert_eq!(keyboard.take(b"a\x1dqb"), [Key::Byte(b'a'), Key::Quit, Key::Byte(b'b')]);
    }

    #[test]
    fn lines_are_whole_bounded_and_harmless() {
        let mut lines = Lines::default();
        let mut shown = Vec::new();
        lines.add(b"hel", |l| shown.push(l.to_owned()));
        lines.add(b"lo\r\n\x1b[2Jgone\n", |l| shown.push(l.to_owned()));
        lines.add(&[b'x'; LINE_MAX + 1], |l| shown.push(l.to_owned()));
        lines.finish(|l| shown.push(l.to_owned()));
        assert_eq!(shown[..2], ["hello", "\\x1b[2Jgone"]);
        assert_eq!((shown[2].len(), shown[3].as_str()), (LINE_MAX, "x"));
    }
}
