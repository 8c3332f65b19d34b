//! The terminal is put back, and a signal ends the run cleanly.
//!
//! One test in a process of its own: it replaces standard input by a terminal.

use std::io::{self, Read, Write};
use std::mem::MaybeUninit;
use std::os::fd::FromRawFd;
use std::sync::Arc;

use takt::outlet::{Outlet, StandardOutput};
use takt::sandbox::Mode;
use takt::schedule_requests::ScheduleRequests;
use takt::screen::{self, Screen};
use takt::supervisor::{Sources, Supervisor, take_signals};
use takt::terminal;
use takt_scheduler::switch::ScheduleState;
use takt_scheduler::time::{Nanos, Timebase, Tsc, TscFrequency};
use vmm_sys_util::eventfd::EventFd;

/// A pseudo-terminal whose slave is standard input from here on; returns its master.
fn terminal_on_stdin() -> std::fs::File {
    let (mut master, mut slave) = (-1, -1);
    // SAFETY: fills in two descriptors; the other arguments ask for defaults.
    let opened = unsafe {
        libc::openpty(
            &raw mut master,
            &raw mut slave,
            std::ptr::null_mut(),
            std::ptr::null_mut(),
            std::ptr::null_mut(),
        )
    };
    assert_eq!(opened, 0);
    // SAFETY: both are open; standard input is this test's alone.
    assert_eq!(unsafe { libc::dup2(slave, libc::STDIN_FILENO) }, libc::STDIN_FILENO);
    // SAFETY: the descriptor is new and has no other owner.
    unsafe { std::fs::File::from_raw_fd(master) }
}

fn local_flags() -> libc::tcflag_t {
    let mut settings = MaybeUninit::<libc::termios>::uninit();
    // SAFETY: fills in the structure, which the assertion checks before it is used.
    let known = unsafe { libc::tcgetattr(libc::STDIN_FILENO, settings.as_mut_ptr()) };
    assert_eq!(known, 0);
    // SAFETY: filled in by the successful call.
    unsafe { settings.assume_init() }.c_lflag
}

#[test]
fn a_signal_and_the_escape_end_a_run_and_the_terminal_is_put_back() {
    let mut master = terminal_on_stdin();
    let before = local_flags();
    assert_ne!(before & (libc::ICANON | libc::ECHO), 0, "a new terminal is not raw");

    assert!(terminal::make_raw().unwrap());
    assert_eq!(local_flags() & (libc::ICANON | libc::ECHO | libc::ISIG), 0);

    let supervisor = || {
        let output = StandardOutput::new();
        let outlet = Outlet::start("console", Mode::Enforce, &screen::quotas(0), output).unwrap();
        let screen = Screen::new(Arc::new(outlet), true, 0);
        let signals = take_signals().unwrap();
        let bell = EventFd::new(0).unwrap();
        let frequency = TscFrequency::from_khz(1_000_000).unwrap();
        let base = Timebase { epoch: Tsc::now(), frequency };
        let board = Arc::new(ScheduleState::new(Nanos::from_millis(1), 1));
        let desk = ScheduleRequests::new(board, &["only".to_owned()], base);
        let sources = Sources::new(signals, bell).unwrap();
        Supervisor::new(Vec::new(), desk, None, screen, None, sources)
    };
    // With neither a duration nor a partition, only the signal can end this.
    let waiting = supervisor();
    // SAFETY: sends a signal, which `take_signals` has blocked in this thread.
    unsafe { libc::pthread_kill(libc::pthread_self(), libc::SIGTERM) };
    waiting.supervise(None).unwrap();

    // And only the escape can end this.
    let waiting = supervisor();
    master.write_all(b"typed\x1dq").unwrap();
    waiting.supervise(None).unwrap();

    terminal::restore();
    assert_eq!(local_flags(), before);
    // Nothing was echoed: what is typed belongs to the guest.
    let mut echoed = [0; 64];
    // SAFETY: makes reads of the open master return at once.
    unsafe {
        libc::fcntl(std::os::fd::AsRawFd::as_raw_fd(&master), libc::F_SETFL, libc::O_NONBLOCK)
    };
    assert!(matches!(master.read(&mut echoed), Err(e) if e.kind() == io::ErrorKind::WouldBlock));
}
