//! The interrupt at a window's start, for a guest whose tasks may span windows.
//!
//! A guest with one scan is done before its window ends, sleeps in its last instruction, and is awake
//! before its next release. A guest that preempts is in the middle of a lesser task instead, and would go on
//! with it past the release. So the thread that runs it makes it take an interrupt first; the guest's
//! handler then waits for the release as ever. No timer is needed for it, and no exit.
//!
//! A guest asks for it ([`port::TICK`](takt_abi::port::TICK)), and it comes only after a window that the
//! guest has not given back: one that says "done" pays nothing.
//!
//! # A guest that cannot be interrupted
//!
//! A guest whose interrupt flag is clear is in its kernel, which looks for a new window by itself
//! ([`Information::release`](takt_abi::Information::release)) before it goes on with a task. It gets no tick: KVM would
//! bring it by an exit as soon as the flag is set, and that exit would come before the release, or behind it.
//!
//! # What KVM makes of it
//!
//! The vector is queued as acknowledged already, with the registers that `KVM_RUN` takes from the shared page
//! (`Documentation/virt/kvm/api.rst`, "KVM_CAP_SYNC_REGS"): a system call less than `KVM_INTERRUPT`, in the guard before
//! a release. The next entry delivers it *whatever the guest's interrupt flag says*. So
//! [`before_entry`](Tick::before_entry) asks `ready_for_interrupt_injection` first. That is 0 with the flag set too, if
//! another event is on its way into the guest. It must not be replaced, so KVM is to exit when it has come in. Both answers are
//! those of the last `KVM_RUN`: of this guest and not of one before a restart, since a guest has made an exit to ask for
//! ticks.
//!
//! With the processor's own controller (a partition with device interrupts) KVM says that a guest is ready only if its pin LINT0
//! is open, which is why it is ([`apic`](crate::interrupts::apic)).
//!
//! A kick can take the thread out before the delivery. Then the next window, which follows an unfinished one too, ticks when
//! the first tick has come in, and the guest sees two. It is told so.

use kvm_bindings::{kvm_vcpu_events, kvm_vcpu_events__bindgen_ty_2 as Queued};
use kvm_ioctls::{SyncReg, VcpuFd};

/// Whether the guest is to be interrupted before it goes on.
#[derive(Debug, Default)]
pub struct Tick {
    /// The last window ended before the guest was done.
    unfinished: bool,
    /// The vector that is still to be brought in this window.
    due: Option<u8>,
    /// KVM has been asked to exit as soon as the guest can be interrupted.
    requested: bool,
}

impl Tick {
    /// A window begins, of a guest that wants ticks with this vector, if any. One of an earlier window
    /// that could not be brought is this one.
    pub fn window(&mut self, vector: Option<u8>) {
        self.due = vector.filter(|_| self.unfinished);
    }

    /// The window is over. A guest that is done has no task that waits for the next tick.
    pub fn window_over(&mut self, vcpu: &mut VcpuFd, unfinished: bool) {
        self.unfinished = unfinished;
        self.due = None;
        self.request_window(vcpu, false);
    }

    /// The guest was started anew: it has left nothing unfinished.
    pub fn restarted(&mut self) {
        self.unfinished = false;
    }

    /// Brings what is due, if the guest is to be interrupted.
    pub fn before_entry(&mut self, vcpu: &mut VcpuFd) {
        let Some(vector) = self.due else { return };
        let run = vcpu.get_kvm_run();
        let (ready, open) = (run.ready_for_interrupt_injection != 0, run.if_flag != 0);
        let later = open && !ready;
        self.request_window(vcpu, later);
        if later {
            return;
        }
        self.due = None;
        if ready {
            let interrupt = Queued { injected: 1, nr: vector, ..Queued::default() };
            // A guest that is ready has nothing else of this under way.
            vcpu.sync_regs_mut().events = kvm_vcpu_events { interrupt, ..Default::default() };
            vcpu.set_sync_dirty_reg(SyncReg::VcpuEvents);
        }
    }

    fn request_window(&mut self, vcpu: &mut VcpuFd, wanted: bool) {
        if self.requested != wanted {
            self.requested = wanted;
            vcpu.get_kvm_run().request_interrupt_window = u8::from(wanted);
        }
    }
}
