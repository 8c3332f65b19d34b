//! Waiting: for a doorbell, or for a while.
//!
//! The doorbell of a channel is an interrupt of the function. `uio_pci_generic` counts them, and a
//! file opened on its device becomes readable when the count has changed since the file was opened
//! or last read (kernel, `drivers/uio/uio.c`). A waiter opens it before its owner first looks at the
//! channel, so a ring between that look and the wait ends the wait at once.
//!
//! That driver also disables the function's interrupt in the command register at each one, which
//! user space has to undo. Takt's function ignores the bit, but another host of the same function
//! may not, so it is undone here.
//!
//! A channel without a doorbell, or a guest without the driver, leaves looking again and again.

#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::io::{self, Read};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{FileExt, OpenOptionsExt};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use crate::error::PortsError;

/// Time between two looks where there is no doorbell to wait for.
pub const POLL_INTERVAL: Duration = Duration::from_millis(1);

/// How long a call may wait.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Timeout {
    /// Not at all: the call says at once what there is.
    Zero,
    /// So long, and then TIMED_OUT.
    Within(Duration),
    /// As long as it takes.
    Forever,
}

/// The instant at which a call that begins now gives up.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Deadline {
    Now,
    At(Instant),
    Never,
}

impl Timeout {
    pub(crate) fn deadline(self) -> Deadline {
        match self {
            Self::Zero => Deadline::Now,
            Self::Forever => Deadline::Never,
            // What is too far away for the clock will not come.
            Self::Within(time) => {
                Instant::now().checked_add(time).map_or(Deadline::Never, Deadline::At)
            }
        }
    }
}

/// What ends a wait.
#[derive(Debug)]
pub(crate) struct Waiter {
    doorbell: Option<Doorbell>,
}

#[derive(Debug)]
struct Doorbell {
    uio: File,
    /// The function's configuration space.
    config: Option<File>,
}

impl Waiter {
    /// Looks again after a while.
    pub(crate) fn polling() -> Waiter {
        Waiter { doorbell: None }
    }

    /// Waits for the interrupts of a function, by its UIO device.
    pub(crate) fn listening(uio: &Path, function: &Path) -> Result<Waiter, PortsError> {
        let opened =
            OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK).open(uio);
        let uio = opened.map_err(|source| PortsError::File {
            doing: "open",
            path: uio.to_owned(),
            source,
        })?;
        let config = OpenOptions::new().read(true).write(true).open(function.join("config")).ok();
        let doorbell = Doorbell { uio, config };
        doorbell.enable();
        Ok(Waiter { doorbell: Some(doorbell) })
    }

    /// Waits until there may be something new. `false` if it is too late to wait; otherwise the
    /// caller looks again, whatever it was that ended the wait.
    pub(crate) fn wait(&mut self, deadline: Deadline) -> io::Result<bool> {
        let left = match deadline {
            Deadline::Now => return Ok(false),
            Deadline::Never => None,
            Deadline::At(instant) => match instant.checked_duration_since(Instant::now()) {
                None | Some(Duration::ZERO) => return Ok(false),
                left => left,
            },
        };
        match &mut self.doorbell {
            None => thread::sleep(left.map_or(POLL_INTERVAL, |left| left.min(POLL_INTERVAL))),
            Some(doorbell) => {
                if !doorbell.wait(left)? {
                    // The driver is gone.
                    self.doorbell = None;
                }
            }
        }
        Ok(true)
    }
}

impl Doorbell {
    /// `false` if it can never ring again.
    fn wait(&mut self, left: Option<Duration>) -> io::Result<bool> {
        let mut polled =
            libc::pollfd { fd: self.uio.as_raw_fd(), events: libc::POLLIN, revents: 0 };
        let left = left.map(|left| libc::timespec {
            tv_sec: i64::try_from(left.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: i64::from(left.subsec_nanos()),
        });
        let left = left.as_ref().map_or(std::ptr::null(), std::ptr::from_ref);
        // SAFETY: one `pollfd`, and a time-out that is null or a valid `timespec`; both outlive
        // the call. No signal mask.
        if unsafe { libc::ppoll(&raw mut polled, 1, left, std::ptr::null()) } < 0 {
            let error = io::Error::last_os_error();
            return if error.kind() == io::ErrorKind::Interrupted { Ok(true) } else { Err(error) };
        }
        if polled.revents & libc::POLLIN == 0 {
            return Ok(polled.revents == 0);
        }
        // The count itself says nothing: a doorbell that rings thrice between two looks is one.
        match self.uio.read(&mut [0; 4]) {
            Ok(0) => Ok(false),
            Ok(_) => {
                self.enable();
                Ok(true)
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(true),
            Err(error) => Err(error),
        }
    }

    /// Clears the interrupt-disable bit of the command register (PCI 3.0, section 6.2.2).
    fn enable(&self) {
        const COMMAND: u64 = 4;
        const INTERRUPT_DISABLE: u16 = 1 << 10;
        let Some(config) = &self.config else { return };
        let mut command = [0; 2];
        if config.read_exact_at(&mut command, COMMAND).is_err() {
            return;
        }
        let value = u16::from_le_bytes(command);
        if value & INTERRUPT_DISABLE != 0 {
            // Takt's function rings all the same, so a failure changes nothing there.
            let _ = config.write_all_at(&(value & !INTERRUPT_DISABLE).to_le_bytes(), COMMAND);
        }
    }
}

#[cfg(test)]
#[path = "wait_tests.rs"]
mod tests;
