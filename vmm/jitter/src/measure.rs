//! Running `takt` beside this program.
//!
//! Its console is taken from it, so that there is room for the progress; what Takt itself says is
//! shown, and what a load says is kept. A signal from the keyboard goes to both, which ends the run,
//! and this program shows what there is. If this program dies the kernel ends Takt.

use std::fs::{self, DirBuilder};
use std::io::{self, IsTerminal, Read, Write};
use std::os::unix::fs::DirBuilderExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use takt_figures::load::{Lines, Word};
use takt_scheduler::time::Nanos;
use vmm_sys_util::signal::register_signal_handler;

use crate::error::{JitterError, writing};
use crate::load::Load;
use crate::status;

/// How often the progress is shown on a terminal, and elsewhere.
const TICK: Duration = Duration::from_secs(1);
const TICK_IN_FILE: Duration = Duration::from_secs(10);
/// What Takt's own lines on the console begin with.
const OWN: &str = "[takt] ";

/// What is to be run.
pub struct Order<'a> {
    /// The partition file.
    pub file: &'a Path,
    /// For how long.
    pub duration: Option<Nanos>,
    /// Under which load.
    pub load: Load,
    /// Where the report goes.
    pub report: &'a Path,
    /// Where the samples go.
    pub samples: &'a Path,
    /// Further options.
    pub more: &'a [String],
}

/// How it went.
#[derive(Debug)]
pub struct Measured {
    /// Exit status of Takt.
    pub status: u8,
}

impl Measured {
    /// True if Takt leaves figures with this status.
    pub fn has_figures(&self) -> bool {
        matches!(self.status, 0 | 4)
    }
}

/// A folder for the files in between; gone when this is dropped.
pub struct Folder(PathBuf);

impl Folder {
    /// A new one, for this user only.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn new() -> Result<Self, JitterError> {
        let path = std::env::temp_dir().join(format!("takt-jitter-{}", std::process::id()));
        // Fails if there is one: another user may have prepared it.
        DirBuilder::new().mode(0o700).create(&path).map_err(writing(&path))?;
        Ok(Self(path))
    }

    /// A file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // Left behind it does no harm.
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Runs Takt until it ends.
///
/// # Errors
/// If it does not start.
pub fn run(order: &Order<'_>) -> Result<Measured, JitterError> {
    let takt = std::env::current_exe().unwrap_or_default().with_file_name("takt");
    let failed = |source| JitterError::Takt { path: takt.clone(), source };
    keep_running_on_interrupt().map_err(failed)?;
    let mut child = start(&takt, order).map_err(failed)?;
    if let Some(console) = child.stdout.take() {
        watch(console, order.duration);
    }
    let status = child.wait().map_err(failed)?;
    let status = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(Measured { status: status.unwrap_or(status::HOST_CANNOT) })
}

fn start(takt: &Path, order: &Order<'_>) -> io::Result<Child> {
    let mut command = Command::new(takt);
    command.arg("run").arg(order.file).arg("--report").arg(order.report);
    command.arg("--samples").arg(order.samples);
    if let Some(duration) = order.duration {
        command.arg("--for").arg(duration.to_string());
    }
    if let Some(parameter) = order.load.parameter() {
        command.arg("--append").arg(parameter);
    }
    command.args(order.more).stdin(Stdio::null()).stdout(Stdio::piped());
    // SAFETY: between fork and exec only a system call is made, which takes no pointers.
    unsafe {
        command.pre_exec(|| {
            if libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGTERM) == 0 {
                Ok(())
            } else {
                Err(io::Error::last_os_error())
            }
        });
    }
    command.spawn()
}

/// Takt takes the signal for the end of the run; here it has nothing to do. A handler, unlike an
/// ignored signal, is not passed on to Takt.
fn keep_running_on_interrupt() -> io::Result<()> {
    extern "C" fn nothing(_: libc::c_int, _: *mut libc::siginfo_t, _: *mut libc::c_void) {}
    register_signal_handler(libc::SIGINT, nothing)
        .map_err(|e| io::Error::from_raw_os_error(e.errno()))
}

/// Shows how far it is until the console ends.
fn watch(console: ChildStdout, duration: Option<Nanos>) {
    let (sender, lines) = channel();
    let reader = thread::spawn(move || read(console, &sender));
    follow(&lines, duration);
    // It has ended: that is why there are no more lines. A panic of it is no reason to lose them.
    let _ = reader.join();
}

/// Passes the console's lines on.
fn read(mut console: ChildStdout, lines: &Sender<String>) {
    let (mut buffer, mut cut) = ([0; 4096], Lines::default());
    loop {
        match console.read(&mut buffer) {
            Ok(0) => return,
            Ok(read) => cut.add(&buffer[..read], |line| {
                // The receiver may be gone: then the console is only emptied.
                let _ = lines.send(String::from_utf8_lossy(line).into_owned());
            }),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => return,
        }
    }
}

fn follow(lines: &Receiver<String>, duration: Option<Nanos>) {
    let start = Instant::now();
    let on_terminal = io::stderr().is_terminal();
    let tick = if on_terminal { TICK } else { TICK_IN_FILE };
    let (mut done, mut next) = (None, start + tick);
    loop {
        match lines.recv_timeout(next.saturating_duration_since(Instant::now())) {
            Ok(line) => {
                if line.starts_with(OWN) {
                    show(on_terminal, &printable(&line), "\n");
                }
                done = Word::of(line.as_bytes()).map(|word| words(&word)).or(done);
            }
            Err(RecvTimeoutError::Timeout) => {
                let end = if on_terminal { "" } else { "\n" };
                show(on_terminal, &position(start.elapsed(), duration, done.as_deref()), end);
                next += tick;
            }
            Err(RecvTimeoutError::Disconnected) => {
                show(on_terminal, "", "");
                return;
            }
        }
    }
}

/// Shows a line over the one before.
fn show(on_terminal: bool, text: &str, end: &str) {
    let clear = if on_terminal { "\r\x1b[K" } else { "" };
    let mut out = io::stderr().lock();
    let _ = write!(out, "{clear}{text}{end}").and_then(|()| out.flush());
}

fn printable(line: &str) -> String {
    line.chars().map(|c| if c.is_control() { '?' } else { c }).collect()
}

fn words(word: &Word<'_>) -> String {
    format!("{}: {} {}", word.load, word.count, word.unit)
}

fn position(elapsed: Duration, duration: Option<Nanos>, done: Option<&str>) -> String {
    let mut text = format!("takt-jitter: {} s", elapsed.as_secs());
    if let Some(duration) = duration {
        text += &format!(" of {duration}");
    }
    if let Some(done) = done {
        text += &format!("; {done}");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_position_is_told_as_far_as_it_is_known() {
        let done = words(&Word { load: "cpu", count: 3, unit: "rounds" });
        let at = Duration::from_millis(12_900);
        assert_eq!(position(at, None, None), "takt-jitter: 12 s");
        let whole = position(at, Some(Nanos(60_000_000_000)), Some(&done));
        assert_eq!(whole, "takt-jitter: 12 s of 60s; cpu: 3 rounds");
    }

    #[test]
    fn the_folder_in_between_is_gone_afterwards() {
        let folder = Folder::new().unwrap();
        let path = folder.path("x");
        fs::write(&path, "x").unwrap();
        assert!(Folder::new().is_err());
        drop(folder);
        assert!(!path.exists());
    }
}
