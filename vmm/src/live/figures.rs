//! How the programs and tasks of one partition stand, as its kernel has said last.
//!
//! Takt asks once in a while, part by part, and keeps the last answer: a client that asks for the status waits for no
//! guest. Names come from the images of the partition file, never from the guest.

use takt_abi::live::{Answer, Order, ProgramRecord, TASKS_EACH, TaskRecord};
use takt_scheduler::time::Nanos;

use super::link::Link;

/// From one look at a partition to the next.
const INTERVAL: Nanos = Nanos::from_millis(500);

/// What is known.
#[derive(Default)]
pub struct Figures {
    /// By place in the partition file; empty before the first answer.
    pub programs: Vec<ProgramRecord>,
    /// Of all programs, in the kernel's order.
    pub tasks: Vec<TaskRecord>,
    /// Answers that the kernel could not send.
    pub dropped: u64,
    /// Values that it says it keeps forced.
    pub forced: u16,
    /// When it is asked again.
    next: Nanos,
    /// Number of the last question.
    asked: u32,
}

impl Figures {
    /// Asks, if it is time.
    pub fn ask(&mut self, link: &mut Link, now: Nanos) {
        if now < self.next || !link.may_ask_again(self.asked) {
            return;
        }
        self.next = now.plus(INTERVAL);
        for part in 0..=self.tasks.len().div_ceil(TASKS_EACH) {
            // What is not sent is asked for the next time.
            self.asked = link.send(&Order::Status { part: part as u16 }).unwrap_or(self.asked);
        }
    }

    /// Takes what an answer says of them.
    pub fn take(&mut self, answer: &Answer) {
        match answer {
            Answer::Programs { programs, count, tasks, forced, dropped } => {
                self.forced = *forced;
                self.programs = programs.iter().take(usize::from(*count)).copied().collect();
                // Counted by a byte, so bounded.
                self.tasks.resize(usize::from(*tasks), TaskRecord::default());
                self.dropped = *dropped;
            }
            Answer::Tasks { first, count, tasks } => {
                let told = tasks.iter().take(usize::from(*count));
                let kept = self.tasks.iter_mut().skip(usize::from(*first));
                kept.zip(told).for_each(|(kept, told)| *kept = *told);
            }
            Answer::Reply(_) | Answer::Change(_) => {}
        }
    }

    /// A program runs another version, as is known sooner than it is told here.
    pub fn runs(&mut self, program: usize, hash: [u8; 32]) {
        if let Some(record) = self.programs.get_mut(program) {
            record.hash = hash;
        }
    }

    /// The guest has started anew: nothing is known of it.
    pub fn forget(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_that_were_not_announced_are_not_kept() {
        let mut figures = Figures::default();
        let tasks = [TaskRecord { jobs: 7, ..TaskRecord::default() }; TASKS_EACH];
        figures.take(&Answer::Tasks { first: 0, count: 8, tasks });
        assert!(figures.tasks.is_empty());
        let programs = [ProgramRecord::default(); takt_abi::program::PROGRAMS_MAX];
        figures.take(&Answer::Programs { programs, count: 2, tasks: 10, forced: 0, dropped: 1 });
        figures.take(&Answer::Tasks { first: 8, count: 8, tasks });
        figures.take(&Answer::Tasks { first: 255, count: 8, tasks });
        let jobs: Vec<u64> = figures.tasks.iter().map(|task| task.jobs).collect();
        assert_eq!(jobs, [0, 0, 0, 0, 0, 0, 0, 0, 7, 7]);
        assert_eq!((figures.programs.len(), figures.dropped), (2, 1));
    }
}
