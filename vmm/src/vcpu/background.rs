//! Running the partition that gets what the windows leave.

use std::sync::Mutex;

use kvm_ioctls::VcpuExit;
use takt_scheduler::time::Timebase;

use super::Control;
use super::guest::{End, Guest, KvmFailure, Step};
use super::guest_timer;
use super::kick::Kickable;
use crate::handoff::lock;
use crate::health::{Answer, Reporter};

/// Runs one processor of the guest until it ends or is stopped. There is nothing to schedule: the thread is of the
/// ordinary class, so it runs exactly when no window's thread does.
///
/// A processor that the guest has not started yet is here too: KVM waits for the guest's word in the call.
pub fn run(
    kickable: &mut Kickable,
    guest: &mut impl Guest,
    control: &Control,
    health: &Mutex<Reporter>,
    base: &Timebase,
) -> End {
    loop {
        kickable.clear();
        if control.stopping() {
            return End::Stopped;
        }
        if let Some(end) = guest.ended_from_outside() {
            return end;
        }
        control.look_if_asked(kickable);
        if let Err(end) = guest_timer::look_again(guest, kickable.vcpu(), base) {
            return end;
        }
        match kickable.vcpu().run() {
            Ok(VcpuExit::X86Wrmsr(write)) => {
                let write = guest_timer::take(write);
                if let Err(end) = guest_timer::write(guest, kickable.vcpu(), write, base) {
                    return end;
                }
            }
            Ok(exit) => {
                let answer = Answer::to(exit, guest);
                if let Step::Ended(end) = lock(health).conclude(answer, kickable.vcpu()) {
                    return end;
                }
            }
            Err(e) if matches!(e.errno(), libc::EINTR | libc::EAGAIN) => {}
            Err(e) => return End::Kvm(KvmFailure::Errno(e.errno())),
        }
    }
}
