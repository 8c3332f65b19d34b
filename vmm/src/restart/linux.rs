//! A Linux, in a machine that is new as well: what a guest can do to interrupt controllers, timers and
//! model-specific registers is more than anybody wants to undo one by one.

use std::time::Duration;

use super::{LoadError, Loader, Revival};
use crate::boot::Start;
use crate::handoff::{Giver, handoff};
use crate::life::Starts;
use crate::linux_machine::LinuxMachine;
use crate::sandbox::Kind;
use crate::vcpu::exit_count::ExitCount;
use crate::vcpu::linux::LinuxGuest;

/// How often the loader looks whether the partition's thread is gone. A thread that is there wakes it.
const LOOK: Duration = Duration::from_millis(100);

/// What loads the Linux on a board anew.
pub struct LinuxLoader(pub LinuxMachine);

impl Loader for LinuxLoader {
    type Guest = LinuxGuest;
    const THREAD: (&str, Kind) = ("loader", Kind::Loader);
    const STARTS: Starts = Starts::Cold;

    fn load(&mut self, _: Start, thread: &mut Giver<Revival<LinuxGuest>>) -> Result<(), LoadError> {
        let (vcpu, new) = self.0.start_anew()?;
        let (mut replace, mut replaced) = handoff(1);
        let exit_count = ExitCount::of(&vcpu);
        let revival: Revival<LinuxGuest> = Box::new(move |kickable, guest| {
            let _ = replace.give(kickable.replace(vcpu, exit_count));
            *guest = new;
            true
        });
        let _ = thread.give(revival);
        // With its processor a machine goes, which takes the kernel longer than the guest's
        // thread may be away from its windows. A thread that is gone replaces none.
        while let Ok(None) = replaced.wait(Some(LOOK)) {}
        Ok(())
    }
}
