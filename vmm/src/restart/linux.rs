//! A Linux, in a machine that is new as well: what a guest can do to interrupt controllers, timers and
//! model-specific registers is more than anybody wants to undo one by one.

use std::time::Duration;

use super::{LoadError, Loader, Revival};
use crate::boot::Start;
use crate::handoff::{Giver, Taker, handoff};
use crate::life::Starts;
use crate::linux_machine::{LinuxMachine, Processor};
use crate::sandbox::Kind;
use crate::vcpu::exit_count::ExitCount;
use crate::vcpu::linux::LinuxGuest;

/// How often the loader looks whether the partition's thread is gone. A thread that is there wakes it.
const LOOK: Duration = Duration::from_millis(100);

/// What loads the Linux on a board anew.
pub struct LinuxLoader {
    /// The board.
    pub machine: LinuxMachine,
    /// The threads of its further processors.
    pub further: Vec<Giver<Revival<LinuxGuest>>>,
}

impl Loader for LinuxLoader {
    type Guest = LinuxGuest;
    const THREAD: (&str, Kind) = ("loader", Kind::Loader);
    const STARTS: Starts = Starts::Cold;

    fn load(&mut self, _: Start, thread: &mut Giver<Revival<LinuxGuest>>) -> Result<(), LoadError> {
        let (first, further) = self.machine.start_anew()?;
        // The first last: when it runs, and may end, all others are there to end with it.
        for (processor, thread) in further.into_iter().zip(&mut self.further) {
            pass_on(processor, thread);
        }
        pass_on(first, thread);
        Ok(())
    }
}

/// Gives a thread its new processor, and waits until it has it.
fn pass_on((vcpu, new): Processor, thread: &mut Giver<Revival<LinuxGuest>>) {
    let (mut replace, mut replaced) = handoff(1);
    let exit_count = ExitCount::of(&vcpu);
    let revival: Revival<LinuxGuest> = Box::new(move |kickable, guest| {
        *guest = new;
        let _ = replace.give(kickable.replace(vcpu, exit_count));
        true
    });
    let _ = thread.give(revival);
    // With its last processor a machine goes, which takes the kernel longer than the guest's
    // thread may be away from its windows.
    wait_for(&mut replaced, thread);
}

/// Waits for what a thread gives back. One that is gone gives nothing, and leaves its word in the ring, with the end that would.
fn wait_for<B, W>(back: &mut Taker<B>, thread: &Giver<W>) {
    while !thread.is_gone() && matches!(back.wait(Some(LOOK)), Ok(None)) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_that_has_gone_without_its_word_is_not_waited_for() {
        let (mut thread, words) = handoff(1);
        let (replace, mut replaced) = handoff::<()>(1);
        assert!(thread.give(replace).is_ok());
        drop(words);
        wait_for(&mut replaced, &thread);
    }
}
