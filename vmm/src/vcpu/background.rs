//! Running the partition that gets what the windows leave.

use super::Control;
use super::guest::{End, Guest, KvmFailure, Step};
use super::kick::Kickable;
use crate::health::{Answer, Reporter};

/// Runs the guest until it ends or is stopped. There is nothing to schedule: the thread is of the
/// ordinary class, so it runs exactly when no window's thread does.
pub fn run(
    kickable: &mut Kickable,
    guest: &mut impl Guest,
    control: &Control,
    health: &mut Reporter,
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
        match kickable.vcpu().run() {
            Ok(exit) => {
                let answer = Answer::to(exit, guest);
                if let Step::Ended(end) = health.conclude(answer, kickable.vcpu()) {
                    return end;
                }
            }
            Err(e) if matches!(e.errno(), libc::EINTR | libc::EAGAIN) => {}
            Err(e) => return End::Kvm(KvmFailure::Errno(e.errno())),
        }
    }
}
