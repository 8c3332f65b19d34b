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
//! # What KVM makes of it
//!
//! Without an interrupt controller `KVM_INTERRUPT` queues the vector as acknowledged already, and the next
//! entry delivers it *whatever the guest's interrupt flag says*. So [`before_entry`](Tick::before_entry) asks
//! `ready_for_interrupt_injection` first, and if that is 0 has KVM exit as soon as the guest can take it
//! (`Documentation/virt/kvm/api.rst`, "KVM_INTERRUPT" and "kvm_run"). The answer is that of the last
//! `KVM_RUN`: of this guest and not of one before a restart, since a guest has made an exit to ask for ticks.
//!
//! With the processor's own controller (a partition with device interrupts) the vector comes by its pin
//! LINT0, which is why that is open ([`apic`](crate::interrupts::apic)). A vector that waits there is kept by
//! KVM, and a second one refused (`EEXIST`): it is the same tick.
//!
//! A kick can take the thread out between the ioctl and the delivery. Then the next window, which follows an
//! unfinished one too, ticks while the first tick waits, and the guest may see two. It is told so.

use kvm_bindings::kvm_interrupt;
use kvm_ioctls::VcpuFd;
use vmm_sys_util::ioctl::ioctl_with_ref;

/// What kvm-ioctls has no call for.
mod request {
    use kvm_bindings::{KVMIO, kvm_interrupt};

    vmm_sys_util::ioctl_iow_nr!(KVM_INTERRUPT, KVMIO, 0x86, kvm_interrupt);
}

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

    /// Brings what is due, if the guest can take it.
    ///
    /// # Errors
    /// KVM's error number.
    pub fn before_entry(&mut self, vcpu: &mut VcpuFd) -> Result<(), i32> {
        let Some(vector) = self.due else { return Ok(()) };
        if vcpu.get_kvm_run().ready_for_interrupt_injection == 0 {
            self.request_window(vcpu, true);
            return Ok(());
        }
        self.request_window(vcpu, false);
        self.due = None;
        interrupt(vcpu, vector)
    }

    fn request_window(&mut self, vcpu: &mut VcpuFd, wanted: bool) {
        if self.requested != wanted {
            self.requested = wanted;
            vcpu.get_kvm_run().request_interrupt_window = u8::from(wanted);
        }
    }
}

fn interrupt(vcpu: &VcpuFd, vector: u8) -> Result<(), i32> {
    let argument = kvm_interrupt { irq: vector.into() };
    // SAFETY: the kernel reads the live argument.
    let result = unsafe { ioctl_with_ref(vcpu, request::KVM_INTERRUPT(), &argument) };
    if result == 0 {
        return Ok(());
    }
    match kvm_ioctls::Error::last().errno() {
        libc::EEXIST => Ok(()),
        errno => Err(errno),
    }
}
