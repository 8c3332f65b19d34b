//! Starting a guest anew.
//!
//! Clearing and loading memory takes longer than a window, and for a Linux longer than the event
//! thread may be away from its rings. So a PLC is loaded by the event thread and a Linux by a
//! thread of its own, both of the ordinary class. The partition's thread only sets registers, or
//! takes over another processor.
//!
//! Even that is time, and a deadline thread that is woken for it at some instant takes it from
//! whoever has a window then. So a thread with windows is not woken: it looks for the word in each
//! of its own windows ([`Windowed::next_window`](crate::vcpu::windowed::Windowed::next_window)).

use std::io;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::Builder;

use kvm_ioctls::VcpuFd;

use crate::board::Board;
use crate::boot::Start;
use crate::boot::long_mode::{self, StartError};
use crate::boot::plc::PlcImage;
use crate::channels::OwnRegion;
use crate::interrupts::apic;
use crate::memory::GuestMemory;
use crate::passthrough::vfio::Space;
use crate::run_error::RunError;
use crate::sandbox;
use crate::vcpu::exit_count::ExitCount;
use crate::vcpu::first_state::FirstState;
use crate::vcpu::kick::Kickable;
use crate::vcpu::linux::LinuxGuest;
use crate::vcpu::plc::PlcGuest;

/// Stack of the thread that loads a Linux. All memory is locked, so it costs what it may grow to.
const STACK: usize = 256 * 1024;

/// The word to a partition's thread that its guest has been loaded: what it has to do itself, which
/// is false if it failed.
pub type Revival<G> = Box<dyn FnOnce(&mut Kickable, &mut G) -> bool + Send>;

/// What is needed to start a guest anew. When it is dropped, the thread that waits for it ends.
pub enum Restart {
    /// A PLC.
    Plc(PlcRestart),
    /// A Linux.
    Linux(LinuxRestart),
}

impl Restart {
    /// Loads the guest and lets its thread go on. The thread must have told of its end.
    ///
    /// # Errors
    /// If the image of a PLC cannot be loaded, or a channel not prepared: neither happens for the
    /// first time then. A Linux fails later, see [`failure`](Self::failure).
    pub fn start(&self, start: Start) -> Result<(), RunError> {
        match self {
            Restart::Plc(plc) => plc.start(start),
            Restart::Linux(linux) => {
                linux.start();
                Ok(())
            }
        }
    }

    /// Why the guest could not be loaded, if its thread has told so.
    #[must_use]
    pub fn failure(&self) -> Option<RunError> {
        match self {
            Restart::Plc(_) => None,
            Restart::Linux(linux) => lock(&linux.failure).take(),
        }
    }
}

/// Starts a PLC anew, in its own machine.
pub struct PlcRestart {
    memory: GuestMemory,
    image: PlcImage,
    /// What the guest may have damaged and needs to be whole.
    channels: Vec<OwnRegion>,
    /// What may still write to the memory when the guest has ended.
    space: Option<Arc<Space>>,
    /// What the guest may have changed in the processor.
    processor: FirstState,
    thread: Sender<Revival<PlcGuest>>,
}

impl PlcRestart {
    /// For the guest of `image` in `memory`, on a processor that was `processor` when it was new; the
    /// other part is for its thread.
    #[must_use]
    pub fn new(
        memory: GuestMemory,
        image: PlcImage,
        channels: Vec<OwnRegion>,
        space: Option<Arc<Space>>,
        processor: FirstState,
    ) -> (Self, Receiver<Revival<PlcGuest>>) {
        let (thread, revivals) = channel();
        (Self { memory, image, channels, space, processor, thread }, revivals)
    }

    fn start(&self, start: Start) -> Result<(), RunError> {
        if let Some(space) = &self.space {
            space.stop()?;
        }
        let entry = self.image.reload(&self.memory, start.mode).map_err(RunError::Reload)?;
        for region in &self.channels {
            region.format(&self.memory)?;
        }
        long_mode::write_tables(self.memory.regions()).map_err(StartError::from)?;
        if let Some(space) = &self.space {
            space.resume()?;
        }
        let mut processor = self.processor.clone();
        let revival = move |kickable: &mut Kickable, guest: &mut PlcGuest| {
            guest.start_anew(start);
            // What the last exit has left to be done must not happen to the new guest.
            kickable.prime().is_ok()
                && processor.restore(kickable.vcpu()).is_ok()
                && long_mode::set_registers(kickable.vcpu(), entry).is_ok()
                && (!guest.has_interrupts() || apic::reset(kickable.vcpu()).is_ok())
        };
        // A thread that is gone has told of that too.
        let _ = self.thread.send(Box::new(revival));
        Ok(())
    }
}

/// Starts a Linux anew, in a machine that is new as well: what a guest can do to interrupt
/// controllers, timers and model-specific registers is more than anybody wants to undo one by one.
pub struct LinuxRestart {
    orders: Sender<()>,
    failure: Failure,
}

type Failure = Arc<Mutex<Option<RunError>>>;

impl LinuxRestart {
    /// For the Linux on this board; the other part is for its thread. The thread that loads it waits
    /// from now on: a run starts no threads later.
    ///
    /// # Errors
    /// If there is no such thread.
    pub fn new(
        board: Board,
        mode: sandbox::Mode,
    ) -> Result<(Self, Receiver<Revival<LinuxGuest>>), RunError> {
        let (orders, ordered) = channel();
        let (thread, revivals) = channel();
        let failure = Failure::default();
        let loader = Loader { board, thread, failure: failure.clone() };
        loader.spawn(mode, ordered)?;
        Ok((Self { orders, failure }, revivals))
    }

    fn start(&self) {
        // The thread takes orders for as long as this exists.
        let _ = self.orders.send(());
    }
}

/// What the thread that loads has. It is of the ordinary class.
struct Loader {
    board: Board,
    thread: Sender<Revival<LinuxGuest>>,
    failure: Failure,
}

impl Loader {
    /// Starts it, and waits until it is shut in.
    fn spawn(mut self, mode: sandbox::Mode, orders: Receiver<()>) -> Result<(), RunError> {
        const NAME: &str = "loader";
        let (report, reported) = channel();
        let run = move || {
            let ready = sandbox::enter(sandbox::Kind::Loader, mode, NAME, &[]);
            let failed = ready.is_err();
            if report.send(ready.map(drop)).is_ok() && !failed {
                orders.iter().for_each(|()| self.load());
            }
        };
        let host = |source| RunError::Host { what: "start a thread that loads Linux", source };
        Builder::new().name(NAME.to_owned()).stack_size(STACK).spawn(run).map_err(host)?;
        reported.recv().map_err(|_| host(io::Error::other("it has died")))??;
        Ok(())
    }

    fn load(&mut self) {
        match self.board.start_anew() {
            Ok((vcpu, new)) => {
                let (replace, replaced) = channel();
                let exit_count = ExitCount::of(&vcpu);
                let revival: Revival<LinuxGuest> = Box::new(move |kickable, guest| {
                    let _ = replace.send(kickable.replace(vcpu, exit_count));
                    *guest = new;
                    true
                });
                let _ = self.thread.send(revival);
                // With its processor a machine goes, which takes the kernel longer than the guest's
                // thread may be away from its windows. A thread that is gone replaces none.
                let _: Result<VcpuFd, _> = replaced.recv();
            }
            Err(error) => {
                *lock(&self.failure) = Some(error);
                let _ = self.thread.send(Box::new(|_, _| false));
            }
        }
    }
}

/// Nothing that happens under the lock leaves it half-done.
fn lock(failure: &Failure) -> MutexGuard<'_, Option<RunError>> {
    failure.lock().unwrap_or_else(PoisonError::into_inner)
}
