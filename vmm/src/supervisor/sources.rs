//! What wakes the event thread.

use std::fs::File;
use std::io;
use std::sync::mpsc::Receiver;

use takt_scheduler::table::PartitionId;
use vmm_sys_util::eventfd::EventFd;
use vmm_sys_util::timerfd::TimerFd;

use super::error::{SupervisorError, cannot};
use crate::account::Finished;

/// How guests' ends become known.
pub struct Endings {
    /// Rung for each.
    pub bell: EventFd,
    /// Which partition's, and how.
    pub ends: Receiver<(PartitionId, Finished)>,
}

/// What wakes the event thread besides people and devices.
pub struct Sources {
    pub(super) signals: File,
    pub(super) endings: Endings,
    pub(super) tick: TimerFd,
    pub(super) deadline: TimerFd,
}

impl Sources {
    /// Opens what is not open yet.
    ///
    /// # Errors
    /// If the host gives no timers.
    pub fn new(signals: File, endings: Endings) -> Result<Self, SupervisorError> {
        let timer = || {
            TimerFd::new()
                .map_err(|e| cannot("make a timer")(io::Error::from_raw_os_error(e.errno())))
        };
        Ok(Self { signals, endings, tick: timer()?, deadline: timer()? })
    }
}
