//! Virtual processors and the threads that run them.
//!
//! ```text
//!            windowed partition                       background partition
//!
//!          +--> sleeping --------+                   +--> in the guest --+
//!          |       | release     | stop              |       | exit,     | stop,
//!     done,|       | - guard     |                   +-------+ signal    | end
//!     kick |       v             v                                       v
//!          +--- in the guest --> ended                                 ended
//!                  | exit   end of guest
//!                  +---> handled, back in
//! ```
//!
//! A windowed vCPU is taken out of its guest by its own doorbell ("done"), or by the kick at its
//! window's end ([`window_enforcer`]). Either way it sleeps to its next release, and the processor falls to
//! the background partition by itself, because nothing of a higher class is runnable.
//!
//! What the thread of a windowed vCPU may do between its start and its end is little: sleep, run
//! the guest, answer an exit, write one record into a ring. It does not allocate, log, or wait
//! for another thread.

pub mod background;
pub mod exit_count;
mod first_scan;
pub mod first_state;
pub mod guest;
mod guest_counter;
pub mod guest_timer;
pub mod kick;
pub mod linux;
pub mod plc;
pub mod port_access;
pub mod probe;
pub mod records;
pub mod thread;
pub mod tick;
pub mod window_enforcer;
pub mod windowed;

pub use takt_record as record;

use std::sync::atomic::{AtomicBool, AtomicI32, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::Thread;

use takt_scheduler::sleep::WakeUps;
use takt_scheduler::time::{Nanos, Tsc};

/// What other threads may know of a vCPU's thread and ask of it.
#[derive(Debug, Default)]
pub struct Control {
    /// When the thread was asked to end, as a TSC value; 0 if it was not.
    stop: AtomicU64,
    /// The same, to leave its guest.
    halt: AtomicU64,
    /// End of the window that is being run, as a TSC value; 0 outside a window.
    running_until: AtomicU64,
    /// When the window that is being run was ended by a kick, as a TSC value; 0 if it was not.
    kicked: AtomicU64,
    /// Kernel's id of the thread; 0 before it has one.
    thread: AtomicI32,
    /// The same thread, once it runs, for waking it where it waits without its guest.
    waits: OnceLock<Thread>,
    /// Whether its guest may still do something.
    guest: AtomicBool,
    /// What it was asked about its guest.
    probe: probe::Probe,
    wake_ups: WakeUps,
}

impl Control {
    /// Asks all these threads to end, whatever their guests do. All are asked before the first of
    /// them is kicked: what it does at its end would otherwise delay others that still think that
    /// they run.
    pub fn stop_all(controls: &[Arc<Control>]) {
        for control in controls {
            order(&control.stop);
        }
        for control in controls {
            control.kick();
            control.wake();
        }
    }

    /// The kernel's id of the thread; 0 before it has one.
    #[must_use]
    pub fn thread(&self) -> i32 {
        self.thread.load(Ordering::SeqCst)
    }

    /// The thread is about to run its guest. Must come before it looks whether it is to stop.
    pub fn enter_guest(&self) {
        self.guest.store(true, Ordering::SeqCst);
    }

    /// The guest has left for good, unless it is started anew, and its safe values are written.
    pub fn leave_guest(&self) {
        self.guest.store(false, Ordering::SeqCst);
    }

    /// Whether its guest may still do something. Once the thread has been asked to stop, this does
    /// not become true again for a guest that could.
    #[must_use]
    pub fn has_guest(&self) -> bool {
        self.guest.load(Ordering::SeqCst)
    }

    /// Asks this thread to leave its guest, whatever that does, and to wait for a new start.
    pub fn halt(&self) {
        order(&self.halt);
        self.kick();
        self.wake();
    }

    /// The thread is the calling one.
    pub(crate) fn is_this_thread(&self) {
        self.thread.store(kick::this_thread(), Ordering::SeqCst);
        self.waits.get_or_init(std::thread::current);
    }

    /// Has the thread look again, if it is parked: what it waits for may have come.
    pub fn wake(&self) {
        if let Some(thread) = self.waits.get() {
            thread.unpark();
        }
    }

    /// The thread has told of its end: nothing more is asked of it.
    pub fn halted(&self) {
        self.halt.store(0, Ordering::SeqCst);
    }

    /// How the thread's wake-ups have gone so far.
    #[must_use]
    pub fn wake_ups(&self) -> &WakeUps {
        &self.wake_ups
    }

    /// CPU time that the thread has used so far; `None` if there is no such thread.
    #[must_use]
    pub fn cpu_time(&self) -> Option<Nanos> {
        match self.thread.load(Ordering::SeqCst) {
            0 => None,
            thread => thread::cpu_time_of(thread),
        }
    }

    /// True if the guest shall run no more: the thread is to end or to wait.
    #[must_use]
    pub fn stopping(&self) -> bool {
        self.ending() || self.halt.load(Ordering::SeqCst) != 0
    }

    /// When the thread was first asked to leave its guest, if it was.
    #[must_use]
    pub fn asked_to_stop(&self) -> Option<Tsc> {
        let asked = [&self.stop, &self.halt].map(|order| order.load(Ordering::SeqCst));
        asked.into_iter().filter(|tsc| *tsc != 0).min().map(Tsc)
    }

    /// True once [`stop_all`](Self::stop_all) was called: the thread is to end.
    #[must_use]
    pub fn ending(&self) -> bool {
        self.stop.load(Ordering::SeqCst) != 0
    }

    /// Takes the thread out of its guest if the window it runs is over.
    pub fn end_window(&self, now: Tsc) {
        let until = self.running_until.load(Ordering::SeqCst);
        if until != 0 && until <= now.0 {
            self.kicked.store(now.0, Ordering::SeqCst);
            self.kick();
        }
    }

    /// Takes the thread out of its guest, to look for a reason to end.
    pub fn kick(&self) {
        kick::send(self.thread.load(Ordering::SeqCst));
    }

    /// Has the thread look at a clock that was found steered, if it sleeps and does not know. In its window it looks soon.
    pub fn tell_steered(&self) {
        if self.running_until.load(Ordering::SeqCst) == 0 && !self.wake_ups.distrusting() {
            self.kick();
        }
    }

    /// The thread enters a window. Must come before its last look at the clock.
    fn enter_window(&self, end: Tsc) {
        self.running_until.store(end.0, Ordering::SeqCst);
    }

    /// The thread has left the window that ends at `end`. Returns when it was kicked out; a kick
    /// that came through only after an earlier window is none of this one.
    fn leave_window(&self, end: Tsc) -> Option<Tsc> {
        self.running_until.store(0, Ordering::SeqCst);
        let kicked = Tsc(self.kicked.swap(0, Ordering::SeqCst));
        (kicked >= end).then_some(kicked)
    }
}

/// Notes that the thread is asked for this from now on, if it has not been before.
fn order(since: &AtomicU64) {
    let _ = since.compare_exchange(0, Tsc::now().0, Ordering::SeqCst, Ordering::SeqCst);
}
