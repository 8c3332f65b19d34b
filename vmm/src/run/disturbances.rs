//! What tests do to a run: a start that fails, a thread that panics, a call that is forbidden.

use std::cell::Cell;
use std::io;
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use crate::account::Account;
use crate::prepare::WindowEnforcer;
use crate::run_error::RunError;
use crate::sandbox;

/// The steps of the start, one of which a test may let fail: all that was taken until then must go
/// back.
#[derive(Debug)]
pub(super) struct Steps {
    left: Cell<Option<u32>>,
}

impl Steps {
    pub(super) fn new(fail_at: Option<u32>) -> Self {
        Self { left: Cell::new(fail_at) }
    }

    /// A step is done.
    pub(super) fn pass(&self) -> Result<(), RunError> {
        self.left.set(self.left.get().map(|left| left.saturating_sub(1)));
        if self.left.get() == Some(0) { Err(RunError::Provoked) } else { Ok(()) }
    }
}

/// Lets a thread make a call that it may not make: that of a partition, the first kicker, or else the
/// process's first.
pub(super) fn provoke(
    name: &str,
    accounts: &[Account],
    kickers: &[WindowEnforcer],
) -> Result<(), RunError> {
    let account = accounts.iter().find(|account| account.name == name);
    let control = match name {
        "kicker" => kickers.first().map(|kicker| &kicker.control),
        _ => account.map(|account| &account.control),
    };
    // Any other name means the process itself: its first thread has its number.
    let thread = control.map_or(std::process::id() as i32, |control| control.thread());
    sandbox::provoke::arm(thread)
        .map_err(|source| RunError::Host { what: "set up the test's timer", source })
}

/// Starts a thread that panics, as any other might, behind doors as narrow as any.
pub(super) fn panic_after(time: Duration, mode: sandbox::Mode) -> Result<(), RunError> {
    const NAME: &str = "panic";
    let (report, reported) = channel();
    let body = move || {
        let entered = sandbox::enter(sandbox::Kind::WindowEnforcer, mode, NAME, &[]);
        let failed = entered.is_err();
        if report.send(entered.map(drop)).is_ok() && !failed {
            thread::sleep(time);
            panic!("asked for, as a test");
        }
    };
    let host = |source| RunError::Host { what: "start a thread that panics", source };
    thread::Builder::new().name(NAME.to_owned()).spawn(body).map_err(host)?;
    reported.recv().map_err(|_| host(io::Error::other("it has died")))??;
    Ok(())
}
