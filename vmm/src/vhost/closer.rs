//! Closing the kernel's devices at the end of a run, on a thread of its own.
//!
//! The kernel closes a device when the worker of that device is done, and vhost-vsock's worker may have to wait for a program of
//! the host: it needs the lock of a socket, and the program can keep that lock in a system call for as long as it likes. No signal
//! ends the wait. The end of a run has more to do than that, so it waits for this thread only for a bounded time.
//!
//! What is open then is closed when the program lets go. Until then the process does not come to its end, and keeps the guest's
//! memory, which the worker may write to. A start that fails closes its devices here too, and no guest has run then.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use takt_devices::virtio::carried::Link;

use crate::handoff::{Giver, handoff};
use crate::sandbox::Kind;
use crate::vcpu::thread::{Spawn, ThreadError};

/// How long the end of a run waits for what only a program of the host can hold up. Without one it takes some ms.
pub const PATIENCE: Duration = Duration::from_secs(1);

/// Closes the devices of a Linux when it is dropped, or before.
pub struct Closer {
    /// Dropped, it is the word to close.
    open: Option<Giver<Infallible>>,
    /// Its other end goes when all are closed.
    closed: Receiver<Infallible>,
    held_up: bool,
}

impl Closer {
    /// For these devices.
    ///
    /// # Errors
    /// If there is no thread for it.
    pub fn start(links: Vec<Arc<Link>>, spawn: Spawn<'_>) -> Result<Self, ThreadError> {
        let (open, mut word) = handoff::<Infallible>(1);
        let (closing, closed) = channel::<Infallible>();
        let work = move || {
            while word.wait(None).is_ok() {}
            links.into_iter().for_each(|link| link.end());
            drop(closing);
        };
        spawn("closer", Kind::Closer, Box::new(work))?;
        Ok(Self { open: Some(open), closed, held_up: false })
    }

    /// Closes them, if that has not been attempted before. If it is held up the thread is left to it.
    pub fn close(&mut self) {
        if let Some(open) = self.open.take() {
            drop(open);
            self.held_up = self.closed.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout);
        }
    }

    /// Whether some were still open when the time was over.
    #[must_use]
    pub fn is_held_up(&self) -> bool {
        self.held_up
    }
}

impl Drop for Closer {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use takt_devices::virtio::carried::{Carrier, QUEUES, Ring};

    use super::*;

    /// A device whose closing waits for a word.
    struct Slow(Receiver<()>);

    impl Carrier for Slow {
        fn features(&self) -> u64 {
            0
        }

        fn start(&mut self, _: u64, _: [Ring; QUEUES]) -> io::Result<()> {
            Ok(())
        }

        fn stop(&mut self) {}
    }

    impl Drop for Slow {
        fn drop(&mut self) {
            let _ = self.0.recv();
        }
    }

    fn spawn(_: &str, _: Kind, work: Box<dyn FnOnce() + Send>) -> Result<(), ThreadError> {
        std::thread::spawn(work);
        Ok(())
    }

    #[test]
    fn devices_are_closed_before_the_end_goes_on() {
        let (go, word) = channel();
        let link = Arc::new(Link::new(Slow(word)));
        let mut closer = Closer::start(vec![link.clone()], &spawn).unwrap();
        drop(go);
        closer.close();
        // The thread has let go of it.
        assert_eq!((closer.is_held_up(), Arc::strong_count(&link)), (false, 1));
    }

    #[test]
    fn one_whose_closing_is_held_up_is_waited_for_once_and_not_for_ever() {
        let (go, word) = channel();
        let link = Arc::new(Link::new(Slow(word)));
        let mut closer = Closer::start(vec![link], &spawn).unwrap();
        closer.close();
        assert!(closer.is_held_up());
        drop(closer);
        go.send(()).unwrap();
    }
}
