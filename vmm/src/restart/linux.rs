//! A Linux, in a machine that is new as well: what a guest can do to interrupt controllers, timers and
//! model-specific registers is more than anybody wants to undo one by one.

use std::sync::mpsc::{Sender, channel};

use kvm_ioctls::VcpuFd;

use super::{Loader, Revival};
use crate::board::Board;
use crate::boot::Start;
use crate::run_error::RunError;
use crate::sandbox::Kind;
use crate::vcpu::exit_count::ExitCount;
use crate::vcpu::linux::LinuxGuest;

/// What loads the Linux on a board anew.
pub struct LinuxLoader(pub Board);

impl Loader for LinuxLoader {
    type Guest = LinuxGuest;
    const THREAD: (&str, Kind) = ("loader", Kind::Loader);
    const RETAINS: bool = false;

    fn load(&mut self, _: Start, thread: &Sender<Revival<LinuxGuest>>) -> Result<(), RunError> {
        let (vcpu, new) = self.0.start_anew()?;
        let (replace, replaced) = channel();
        let exit_count = ExitCount::of(&vcpu);
        let revival: Revival<LinuxGuest> = Box::new(move |kickable, guest| {
            let _ = replace.send(kickable.replace(vcpu, exit_count));
            *guest = new;
            true
        });
        let _ = thread.send(revival);
        // With its processor a machine goes, which takes the kernel longer than the guest's
        // thread may be away from its windows. A thread that is gone replaces none.
        let _: Result<VcpuFd, _> = replaced.recv();
        Ok(())
    }
}
