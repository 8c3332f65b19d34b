//! The decision: from looks at a processor to what is said of its kernel.
//!
//! Time is an argument. Looks in a row that are all of one suspicious kind make an episode; anything
//! that a kernel which lives does ends it: a look of another kind, an interrupt that was injected, a
//! byte on the console. An episode that has lasted long enough is told, and its end as well.

use takt_scheduler::time::Nanos;

use super::News;
use crate::report::{How, Stuck};
use crate::vcpu::probe::Sample;

/// How long an episode lasts until it is told.
pub const TIME: Nanos = Nanos::from_millis(2_000);
/// The same before the kernel was first active: a kernel unpacks itself with interrupts off, and where the
/// processor is emulated that takes seconds.
const TIME_AT_START: Nanos = Nanos::from_millis(10_000);
/// Fewest looks of an episode that is told.
const LOOKS: u32 = 8;

/// A look at a kernel.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// When, since the epoch.
    pub at: Nanos,
    /// Processor time that its thread has used so far.
    pub cpu: Nanos,
    /// Whether its console has shown something since the look before.
    pub printed: bool,
    /// What was seen.
    pub sample: Sample,
}

/// Judges one kernel.
#[derive(Debug)]
pub struct Judge {
    /// Whether KVM's injections are all the interrupts that a kernel gets.
    injections_are_counted: bool,
    alive: bool,
    episode: Option<Episode>,
}

/// Looks in a row that are all alike.
#[derive(Debug)]
struct Episode {
    how: How,
    since: Nanos,
    cpu: Nanos,
    injections: Option<u64>,
    looks: u32,
    told: bool,
}

impl Judge {
    /// A judge of a kernel that has not been active yet.
    pub fn new(injections_are_counted: bool) -> Self {
        Self { injections_are_counted, alive: false, episode: None }
    }

    /// The guest was started anew.
    pub fn restarted(&mut self) {
        (self.alive, self.episode) = (false, None);
    }

    /// True if it would be good to look again soon: a second look has confirmed the first, and it is not
    /// told yet.
    pub fn suspects(&self) -> bool {
        self.episode.as_ref().is_some_and(|episode| episode.looks >= 2 && !episode.told)
    }

    /// Takes a look into account.
    pub fn look(&mut self, look: &Look) -> Option<News> {
        let how = self.suspicion(&look.sample);
        self.alive |= look.printed || !look.sample.interrupts_off;
        let goes_on = |episode: &Episode| {
            !look.printed
                && how == Some(episode.how)
                && look.sample.injections == episode.injections
        };
        if let Some(episode) = self.episode.as_mut().filter(|episode| goes_on(episode)) {
            episode.looks = episode.looks.saturating_add(1);
            let long_enough =
                episode.long_enough(look, if self.alive { TIME } else { TIME_AT_START });
            let news = long_enough && !episode.told;
            episode.told |= news;
            let stuck = Stuck { how: episode.how, since_ns: episode.since.0 };
            return news.then_some(News::Stuck(stuck));
        }
        let ended = self.episode.take();
        self.episode = how.map(|how| Episode {
            how,
            since: look.at,
            cpu: look.cpu,
            injections: look.sample.injections,
            looks: 1,
            told: false,
        });
        ended
            .filter(|episode| episode.told)
            .map(|episode| News::GoesOn(look.at.less(episode.since)))
    }

    /// What a kernel that stayed like this would be; `None` for one that may well be idle.
    fn suspicion(&self, sample: &Sample) -> Option<How> {
        match (sample.interrupts_off, sample.halted) {
            (true, true) => Some(How::Halted),
            (true, false) => Some(How::Spinning),
            (false, true) => None,
            (false, false) => {
                let counted =
                    self.injections_are_counted && sample.injections.is_some_and(|n| n > 0);
                counted.then_some(How::Deaf)
            }
        }
    }
}

impl Episode {
    /// A kernel that spins must have had the processor for half of the time: one that gets none does
    /// nothing either.
    fn long_enough(&self, look: &Look, time: Nanos) -> bool {
        let used = look.cpu.less(self.cpu).0 >= time.0 / 2;
        self.looks >= LOOKS && look.at.less(self.since) >= time && (used || self.how == How::Halted)
    }
}

#[cfg(test)]
#[path = "judge_tests.rs"]
mod tests;
