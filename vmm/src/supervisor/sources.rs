//! What wakes the supervisor thread.

use std::fs::File;
use std::io::{self, IsTerminal};

use vmm_sys_util::eventfd::EventFd;
use vmm_sys_util::timerfd::TimerFd;

use super::error::{SupervisorError, cannot};
use crate::terminal;

/// What wakes the supervisor thread besides people and devices.
pub struct Sources {
    pub(super) signals: File,
    /// Rung for each end of a guest.
    pub(super) endings: EventFd,
    pub(super) tick: TimerFd,
    pub(super) deadline: TimerFd,
    /// People type at a terminal. Asked here, since the C library's way to ask is not in the thread's list.
    pub(super) typed: bool,
    /// No other process group has the terminal. Asked once: a Takt that gets it later reads no keys.
    pub(super) keys: bool,
}

impl Sources {
    /// Opens what is not open yet.
    ///
    /// # Errors
    /// If the host gives no timers.
    pub fn new(signals: File, endings: EventFd) -> Result<Self, SupervisorError> {
        let timer = || {
            TimerFd::new()
                .map_err(|e| cannot("make a timer")(io::Error::from_raw_os_error(e.errno())))
        };
        let typed = io::stdin().is_terminal();
        let keys = terminal::is_ours();
        Ok(Self { signals, endings, tick: timer()?, deadline: timer()?, typed, keys })
    }
}
