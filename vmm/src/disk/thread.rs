//! The thread that serves a disk.

use std::io::{self, ErrorKind};
use std::sync::Arc;

use takt_devices::disk::Medium;
use takt_devices::disk::server::Server;
use vmm_sys_util::eventfd::EventFd;

use super::DiskError;
use crate::event;
use crate::vcpu::Control;
use crate::vcpu::thread::{self, Place, Ready};

/// A thread that is ready to serve a disk.
pub struct DiskThread {
    /// For stopping it.
    pub control: Arc<Control>,
    /// To be rung once it is to stop: it may be about to wait when the kick comes.
    pub bell: EventFd,
    /// The thread.
    pub thread: Ready<()>,
}

impl DiskThread {
    /// A thread that serves whenever `bell` is rung, and rings `interrupt` when there are answers.
    pub(super) fn new<M: Medium + 'static>(
        number: u32,
        place: Place,
        mut server: Server<M>,
        bell: EventFd,
        interrupt: EventFd,
    ) -> Result<Self, DiskError> {
        let control: Arc<Control> = Arc::default();
        let (own, rung) = (control.clone(), event::clone(&bell)?);
        let run = move |_| {
            while wait(&rung).is_ok() && !own.ending() {
                // Fails only if 2^64 interrupts wait, and then there is one.
                let tell = || drop(interrupt.write(1));
                if server.serve(tell) {
                    tell();
                }
            }
        };
        let name = format!("disk-{number}");
        let thread = thread::plain(&name, place, control.clone(), run)?;
        Ok(Self { control, bell, thread })
    }
}

/// Waits for a ring, or for a signal.
fn wait(bell: &EventFd) -> io::Result<()> {
    match bell.read() {
        Err(error) if error.kind() != ErrorKind::Interrupted => Err(error),
        _ => Ok(()),
    }
}
