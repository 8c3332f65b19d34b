//! Starting a guest anew.
//!
//! Clearing and loading memory takes longer than a window, and stopping a device that writes to it may take
//! longer still: longer than the supervisor thread may be away from its rings and from the host's watchdog. So
//! each partition has a thread of its own for that, of the ordinary class, which waits from the start on: a
//! run starts no threads later. The partition's thread only sets registers, or takes over another processor.
//!
//! That of a Linux is bound to the Linux's first CPU. With the old machine go mappings, and what a processor of the host had
//! loaded of it. The kernel interrupts other CPUs for that (`docs/timing.md`), and no window of this one is open meanwhile.
//!
//! Even that is time, and a deadline thread that is woken for it at some instant takes it from
//! the window of another partition. So a thread with windows is not woken: it looks for the word in each
//! of its own windows ([`Windowed::next_window`](crate::vcpu::windowed::Windowed::next_window)).
//!
//! Before Linux 6.13 that of a Linux does not keep to them: its first `KVM_RUN` waits for an RCU grace period, since the loader
//! has run the vCPU before it (see [`touch`](crate::boot::touch)), and it wakes at any instant. The loader cannot leave that
//! out: a kernel that starts a worker at the first `KVM_RUN` refuses it to a deadline thread, and versions do not tell which
//! does.

mod linux;
mod plc;

use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use thiserror::Error;

use crate::boot::Start;
use crate::boot::long_mode::StartError;
use crate::boot::plc::PlcImageError;
use crate::boot::programs::ProgramError;
use crate::channels::ChannelError;
use crate::handoff::{Giver, Taker, handoff, lock};
use crate::life::Starts;
use crate::linux_machine::LinuxMachineError;
use crate::passthrough::error::DeviceError;
use crate::sandbox::Kind;
use crate::vcpu::kick::Kickable;
use crate::vcpu::thread::{Spawn, ThreadError};

pub use linux::LinuxLoader;
pub use plc::PlcLoader;

/// The word to a partition's thread that its guest has been loaded: what it has to do itself, which
/// is false if it failed.
pub type Revival<G> = Box<dyn FnOnce(&mut Kickable, &mut G) -> bool + Send>;

/// Where a partition's thread gets the word. It may be a deadline thread, so it never waits here.
pub type Revivals<G> = Taker<Revival<G>>;

/// A guest could not be loaded anew.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "each wraps the error of the module that its name says")]
pub enum LoadError {
    #[error(transparent)]
    Linux(#[from] LinuxMachineError),
    #[error(transparent)]
    Plc(#[from] PlcImageError),
    #[error(transparent)]
    Program(#[from] ProgramError),
    #[error(transparent)]
    Channel(#[from] ChannelError),
    #[error(transparent)]
    Start(#[from] StartError),
    #[error(transparent)]
    Device(#[from] DeviceError),
}

type Failure = Arc<Mutex<Option<LoadError>>>;

/// What loads a guest anew, on a thread of its own.
pub trait Loader: Send + 'static {
    /// The guest, as its thread knows it.
    type Guest: 'static;
    /// Name and kind of the thread.
    const THREAD: (&str, Kind);
    /// Which starts a guest can have. One that retains nothing has no warm start.
    const STARTS: Starts;

    /// Loads the guest, and gives its thread the word. The guest must not run any more.
    ///
    /// # Errors
    /// See [`LoadError`]. Then there was no word.
    fn load(
        &mut self,
        start: Start,
        thread: &mut Giver<Revival<Self::Guest>>,
    ) -> Result<(), LoadError>;
}

/// What is needed to start a guest anew. When it is dropped, the thread that loads comes to its end.
pub struct Restart {
    orders: Giver<Start>,
    failure: Failure,
    starts: Starts,
    loading: Loading,
}

/// A thread that loads, on its way to its end.
pub struct Loading(Receiver<()>);

impl Loading {
    /// Waits until the thread holds nothing any more, no longer than `most`; whether that is so.
    pub fn wait_within(&self, most: Duration) -> bool {
        // Nothing is ever sent.
        matches!(self.0.recv_timeout(most), Err(RecvTimeoutError::Disconnected))
    }
}

impl Restart {
    /// By a loader, whose thread is started by `spawn`; the other part is for the partition's thread.
    ///
    /// # Errors
    /// If there is no such thread.
    pub fn new<L: Loader>(
        mut loader: L,
        spawn: Spawn<'_>,
    ) -> Result<(Self, Revivals<L::Guest>), ThreadError> {
        let (orders, mut ordered) = handoff(1);
        let (mut thread, revivals) = handoff(1);
        let failure = Failure::default();
        let own = failure.clone();
        let (alive, over) = channel();
        let work = move || {
            while let Ok(Some(start)) = ordered.wait(None) {
                if let Err(error) = loader.load(start, &mut thread) {
                    *lock(&own) = Some(error);
                    let _ = thread.give(Box::new(|_, _| false));
                }
            }
            // Last: who hears of the end finds its devices free.
            drop(loader);
            drop::<Sender<()>>(alive);
        };
        let (name, kind) = L::THREAD;
        spawn(name, kind, Box::new(work))?;
        let loading = Loading(over);
        Ok((Self { orders, failure, starts: L::STARTS, loading }, revivals))
    }

    /// No guest is started any more. What is being loaded may hold devices still.
    #[must_use]
    pub fn end(self) -> Loading {
        self.loading
    }

    /// Orders the guest to be loaded and its thread to go on. The thread must have told of its end. If it
    /// cannot be loaded the thread tells so, and [`failure`](Self::failure) says why.
    pub fn start(&mut self, start: Start) {
        // There is room: a thread that has told of its end has taken all earlier words.
        let _ = self.orders.give(start);
    }

    /// Why the guest could not be loaded, if its thread has told so.
    #[must_use]
    pub fn failure(&self) -> Option<LoadError> {
        lock(&self.failure).take()
    }

    /// Which starts the guest can have.
    #[must_use]
    pub fn starts(&self) -> Starts {
        self.starts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boot::{StartMode, StartReason};

    /// Takes as long as it is told to.
    struct Slow(Receiver<()>);

    impl Loader for Slow {
        type Guest = ();
        const THREAD: (&str, Kind) = ("plc-loader", Kind::PlcLoader);
        const STARTS: Starts = Starts::ColdAndWarm;

        fn load(&mut self, _: Start, _: &mut Giver<Revival<()>>) -> Result<(), LoadError> {
            let _ = self.0.recv();
            Ok(())
        }
    }

    #[test]
    fn who_ends_a_run_can_wait_for_what_is_being_loaded() {
        let spawn = |_: &str, _, work: Box<dyn FnOnce() + Send>| {
            std::thread::spawn(work);
            Ok(())
        };
        let (go, waits) = channel();
        let (mut restart, _revivals) = Restart::new(Slow(waits), &spawn).unwrap();
        restart.start(Start { mode: StartMode::Cold, reason: StartReason::Operator });
        let loading = restart.end();
        assert!(!loading.wait_within(Duration::ZERO));
        go.send(()).unwrap();
        assert!(loading.wait_within(Duration::from_secs(60)));
    }
}
