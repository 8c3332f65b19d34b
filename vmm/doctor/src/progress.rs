//! Progress on standard error, which a report's reader never sees.
//!
//! On a terminal one line changes in place; elsewhere each step is told once, without its time.

use std::cell::RefCell;
use std::io::{self, IsTerminal, Write};

/// Where it is said, and what was said last.
#[derive(Debug)]
pub struct Progress {
    terminal: bool,
    last: RefCell<String>,
}

impl Progress {
    /// On standard error.
    #[must_use]
    pub fn new() -> Self {
        Self { terminal: io::stderr().is_terminal(), last: RefCell::default() }
    }

    /// What is being done. The part behind a colon changes while it is.
    pub fn say(&self, text: &str) {
        let mut err = io::stderr().lock();
        // An error is ignored: the findings do not depend on a reader of the progress.
        if self.terminal {
            let _ = write!(err, "\r\x1b[Ktakt-doctor: {text}");
            let _ = err.flush();
            return;
        }
        let step = text.split(':').next().unwrap_or(text);
        if *self.last.borrow() != step {
            let _ = writeln!(err, "takt-doctor: {step}");
            step.clone_into(&mut self.last.borrow_mut());
        }
    }

    /// Nothing more will be done: the line goes.
    pub fn done(&self) {
        if self.terminal {
            let _ = write!(io::stderr().lock(), "\r\x1b[K");
        }
    }
}
