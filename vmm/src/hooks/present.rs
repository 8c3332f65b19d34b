//! The hooks of a build for tests.

use std::cell::Cell;
use std::io;
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use takt_scheduler::table::Cpu;
use takt_scheduler::time::Nanos;

use super::forbidden_call;
use crate::account::Account;
use crate::prepare::WindowEnforcer;
use crate::run::duration;
use crate::run_error::RunError;
use crate::sandbox::{self, Mode};

/// How much later the wake-up comes that a test wants late: than any guard in the tests, and than
/// any wake-up in the lab.
const LATE: Nanos = Nanos::from_micros(100);
/// A word of the kernel's command line, which it hands to process 1: a test steers the clock.
const STEERED: &str = "TAKT_STEERED";

/// What a test asks for on the command line.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct Hooks {
    /// Do not end windows by kicks, so that only SCHED_DEADLINE is left.
    #[arg(long)]
    without_kick: bool,
    /// Panic after this time.
    #[arg(long, value_name = "DURATION", value_parser = duration)]
    panic_after: Option<Duration>,
    /// Let the wake-ups for the release of this number come late.
    #[arg(long, value_name = "RELEASE")]
    late_wake_up: Option<u64>,
    /// Have this thread make a forbidden call after a second (a partition, `kicker`, or `main`).
    #[arg(long, value_name = "THREAD")]
    provoke_syscall: Option<String>,
    /// Give each Linux as many processors more, on the CPU of its first: the lab has one CPU.
    #[arg(long, value_name = "COUNT", default_value_t = 0)]
    more_processors: usize,
    /// Let the timers of each Linux go off where it sets them, also in windows.
    #[arg(long)]
    loud_windows: bool,
    /// Fail after this step of the start.
    #[arg(long, value_name = "STEP")]
    fail_at: Option<u32>,
}

/// The release whose wake-ups are made late, if there is one.
#[derive(Clone, Copy, Debug, Default)]
pub struct LateWakeUp(Option<u64>);

/// The steps of the start, one of which a test may let fail: all that was taken until then must go
/// back.
#[derive(Debug)]
pub struct Steps {
    left: Cell<Option<u32>>,
}

impl Hooks {
    /// The steps of a start.
    #[must_use]
    pub fn steps(&self) -> Steps {
        Steps { left: Cell::new(self.fail_at) }
    }

    /// Whether windows are ended by kicks.
    #[must_use]
    pub fn kicks(&self) -> bool {
        !self.without_kick
    }

    /// The CPUs of a Linux's processors, by what the file says of them.
    #[must_use]
    pub fn processors(&self, cpus: Vec<Cpu>) -> Vec<Cpu> {
        let first = cpus.first().copied().into_iter();
        let more = first.cycle().take(self.more_processors);
        cpus.iter().copied().chain(more).collect()
    }

    /// Whether the timers of a Linux are kept out of windows.
    #[must_use]
    pub fn quiet(&self) -> bool {
        !self.loud_windows
    }

    /// Which wake-up is made late.
    #[must_use]
    pub fn late_wake_up(&self) -> LateWakeUp {
        LateWakeUp(self.late_wake_up)
    }

    /// Lets the thread that a test names make a call that it may not make: that of a partition, the first window
    /// enforcer, or else the process's first.
    ///
    /// # Errors
    /// What the kernel says of a timer.
    pub fn arm(&self, accounts: &[Account], enforcers: &[WindowEnforcer]) -> Result<(), RunError> {
        let Some(name) = &self.provoke_syscall else { return Ok(()) };
        let (owner, processor) = name.split_once('.').unwrap_or((name, "0"));
        let account = accounts.iter().find(|account| account.name == owner);
        let control = match name.as_str() {
            "kicker" => enforcers.first().map(|enforcer| &enforcer.control),
            _ => account.and_then(|account| {
                let mut all = [&account.control].into_iter().chain(&account.further);
                all.nth(processor.parse().ok()?)
            }),
        };
        // Any other name means the process itself: its first thread has its number.
        let thread = control.map_or(std::process::id() as i32, |control| control.thread());
        forbidden_call::arm(thread)
            .map_err(|source| RunError::Host { what: "set up the test's timer", source })
    }

    /// Starts the thread that panics, as any other might, in a sandbox as narrow as any; if a test wants that.
    ///
    /// # Errors
    /// If the thread does not start, or does not get into its sandbox.
    pub fn start_panicking(&self, mode: Mode) -> Result<(), RunError> {
        const NAME: &str = "panic";
        let Some(time) = self.panic_after else { return Ok(()) };
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

    /// What people who look on are told.
    #[must_use]
    pub fn told(&self) -> Vec<String> {
        let kick = self.without_kick.then(|| "TEST: windows are not ended by kicks".to_owned());
        let late = self
            .late_wake_up
            .map(|release| format!("TEST: the wake-up for release {release} comes late"));
        kick.into_iter().chain(late).collect()
    }
}

impl LateWakeUp {
    /// How much later the wake-up for this release comes.
    #[must_use]
    pub fn delay(self, release: u64) -> Nanos {
        if self.0 == Some(release) { LATE } else { Nanos::ZERO }
    }
}

impl Steps {
    /// A step is done.
    ///
    /// # Errors
    /// [`RunError::Provoked`] after the step that a test names.
    pub fn pass(&self) -> Result<(), RunError> {
        self.left.set(self.left.get().map(|left| left.saturating_sub(1)));
        if self.left.get() == Some(0) { Err(RunError::Provoked) } else { Ok(()) }
    }
}

/// Whether a test steers the appliance's clock.
#[must_use]
pub fn clock_may_be_steered() -> bool {
    std::env::var_os(STEERED).is_some()
}
