//! The host's own watchdog, which Takt serves if the file says so.
//!
//! Takt supervises partitions, and somebody has to supervise Takt: if it is killed, hangs, or its
//! kernel stands still, no software is left that could notice. A hardware watchdog restarts the
//! machine then. It is served by the supervisor thread, and only as long as all threads with windows, and
//! those that end windows, get to run: a host whose deadline scheduling has come to a halt is as
//! good as dead, even if the supervisor thread is not.
//!
//! That a thread gets to run is seen in its CPU time, which grows each time it wakes, whatever its
//! guest does. So nothing is added to what the threads do.
//!
//! The interface is the kernel's `Documentation/watchdog/watchdog-api.rst`.

use std::cell::RefCell;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::rc::Rc;
use std::sync::Arc;

use takt_scheduler::time::Nanos;
use thiserror::Error;

use crate::appliance::{self, Role};
use crate::vcpu::Control;

const DEVICE: &str = "/dev/watchdog";
/// `WDIOC_SETTIMEOUT`: `_IOWR('W', 6, int)`, in seconds.
const SET_TIMEOUT: libc::c_ulong = 0xc004_5706;
/// What is written before the device is closed in order; the driver then stops the watchdog.
const STOP: &[u8] = b"V";
/// Any other byte is a heartbeat.
const ALIVE: &[u8] = b"\0";
/// How often one is given.
const INTERVAL: Nanos = Nanos::from_millis(200);
/// A thread that has its turn once in a major frame may be this much later.
const PATIENCE: Nanos = Nanos::from_millis(1_000);

/// The watchdog, which runs from its making to its end.
pub struct HostWatchdog {
    device: File,
    threads: Vec<Thread>,
    patience: Nanos,
    served: Nanos,
}

/// The host's watchdog cannot be served.
#[derive(Debug, Error)]
pub enum WatchdogError {
    /// The host refuses.
    #[error(
        "cannot serve the host's watchdog, /dev/watchdog: {0}; is its driver loaded, and is it free of other users?"
    )]
    Host(#[from] io::Error),
    /// It waits for another time.
    #[error(
        "the host's watchdog, /dev/watchdog, waits for {set}s and not for {wanted}s: its driver cannot have that time; write `watchdog = \"{set}s\"`, or another"
    )]
    Time {
        /// Seconds in the file.
        wanted: i32,
        /// Seconds in the driver.
        set: i32,
    },
}

/// A driver that cannot have a time takes another, and says so by the call alone.
const fn compare(wanted: i32, set: i32) -> Result<(), WatchdogError> {
    if set == wanted { Ok(()) } else { Err(WatchdogError::Time { wanted, set }) }
}

/// The watchdog, for all that keep it running. With the last of them it is stopped.
pub type SharedWatchdog = Rc<RefCell<HostWatchdog>>;

/// A thread that has to get on.
struct Thread {
    control: Arc<Control>,
    cpu_time: Option<Nanos>,
    /// When it was last seen to have got on.
    seen: Nanos,
}

impl HostWatchdog {
    /// Starts the watchdog of this host, so that it restarts the machine after `time` without a sign
    /// of life. The threads are those that wake in each `frame`.
    ///
    /// # Errors
    /// If there is none, somebody else serves it, or it cannot wait for so long.
    pub fn start(
        time: Nanos,
        frame: Nanos,
        threads: Vec<Arc<Control>>,
        role: Role,
    ) -> Result<Self, WatchdogError> {
        appliance::load_watchdog_drivers(role);
        let mut device = OpenOptions::new().write(true).open(DEVICE)?;
        let wanted = i32::try_from(time.0 / 1_000_000_000).unwrap_or(i32::MAX);
        let mut set = wanted;
        // SAFETY: the request reads and writes one int, which is live.
        let result =
            match unsafe { libc::ioctl(device.as_raw_fd(), SET_TIMEOUT as _, &raw mut set) } {
                0 => compare(wanted, set),
                _ => Err(io::Error::last_os_error().into()),
            };
        if let Err(error) = result {
            // It runs since it was opened.
            let _ = device.write_all(STOP);
            return Err(error);
        }
        let thread = |control| Thread { control, cpu_time: None, seen: Nanos::ZERO };
        Ok(Self {
            device,
            threads: threads.into_iter().map(thread).collect(),
            patience: frame.plus(frame).plus(PATIENCE),
            served: Nanos::ZERO,
        })
    }

    /// Writes a heartbeat, if it is time and no thread is stuck. `now` counts from the epoch.
    pub fn serve(&mut self, now: Nanos) {
        if now.less(self.served) < INTERVAL {
            return;
        }
        let patience = self.patience;
        let stuck = |thread: &mut Thread| {
            let cpu_time = thread.control.cpu_time();
            thread.is_stuck(cpu_time, now, patience)
        };
        // Each has to be looked at.
        let stuck = self.threads.iter_mut().map(stuck).fold(false, |any, stuck| any | stuck);
        if !stuck {
            self.served = now;
            // If this fails, the watchdog will have the last word.
            let _ = self.device.write_all(ALIVE);
        }
    }
}

impl Thread {
    /// True if it has not got on for too long. One that is gone has ended, and told of that.
    fn is_stuck(&mut self, cpu_time: Option<Nanos>, now: Nanos, patience: Nanos) -> bool {
        if cpu_time.is_none() || cpu_time != self.cpu_time {
            (self.cpu_time, self.seen) = (cpu_time, now);
        }
        now.less(self.seen) > patience
    }
}

impl Drop for HostWatchdog {
    fn drop(&mut self) {
        // A driver without the magic close goes on, and restarts the machine: it was told not to let
        // anybody stop it.
        let _ = self.device.write_all(STOP);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_whose_time_stands_still_is_stuck_and_one_that_has_ended_is_not() {
        let mut thread = Thread { control: Arc::default(), cpu_time: None, seen: Nanos::ZERO };
        let patience = Nanos(100);
        let mut at = |cpu, now| thread.is_stuck(cpu, Nanos(now), patience);
        assert!(!at(Some(Nanos(5)), 10));
        assert!(!at(Some(Nanos(5)), 110));
        assert!(at(Some(Nanos(5)), 111));
        assert!(at(Some(Nanos(5)), 1_000));
        assert!(!at(Some(Nanos(6)), 1_001));
        assert!(!at(None, 2_000));
        assert!(!at(None, 3_000));
    }

    /// A pipe in the place of the device.
    fn served() -> (HostWatchdog, std::io::PipeReader) {
        let (reader, writer) = io::pipe().unwrap();
        let device = File::from(std::os::fd::OwnedFd::from(writer));
        let thread = Thread { control: Arc::default(), cpu_time: None, seen: Nanos::ZERO };
        let threads = vec![thread];
        (HostWatchdog { device, threads, patience: PATIENCE, served: Nanos::ZERO }, reader)
    }

    #[test]
    fn signs_of_life_come_at_intervals_and_the_end_stops_the_watchdog() {
        use std::io::Read;
        let (mut watchdog, mut reader) = served();
        for ms in (0..1_000).step_by(20) {
            watchdog.serve(Nanos::from_millis(ms));
        }
        drop(watchdog);
        let mut written = Vec::new();
        reader.read_to_end(&mut written).unwrap();
        assert_eq!(written, b"\0\0\0\0V");
    }

    #[test]
    fn it_runs_until_the_last_that_keeps_it_is_gone() {
        use std::io::Read;
        let (watchdog, mut reader) = served();
        let of_the_run: SharedWatchdog = Rc::new(RefCell::new(watchdog));
        let of_the_supervisor = of_the_run.clone();
        of_the_supervisor.borrow_mut().serve(INTERVAL);
        drop(of_the_supervisor);
        let mut written = [0xff; 2];
        assert_eq!((reader.read(&mut written).unwrap(), written), (1, [0, 0xff]));
        drop(of_the_run);
        assert_eq!((reader.read(&mut written).unwrap(), written[0]), (1, b'V'));
    }

    #[test]
    fn a_time_that_the_driver_has_not_taken_is_refused_with_both() {
        assert!(compare(10, 10).is_ok());
        let error = compare(1_000, 613).unwrap_err().to_string();
        assert!(error.contains("waits for 613s and not for 1000s"), "{error}");
    }
}
