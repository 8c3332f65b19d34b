//! Who runs: fixed priorities, preemptive.
//!
//! All tasks are ranked together: by priority, those of one priority in the order in which they were added, which is
//! that of the programs and of the tasks in them. A holder of a semaphore comes before all of the semaphore's ceiling.
//! Tasks whose releases or execution nothing bounds come after all others, whatever their priority ([`Class`]). A job
//! of theirs need not end, so the most urgent freewheeling task and the initialisations share: the one whose job has
//! executed the least comes first. There is always one most urgent task, and what runs follows from the state alone.
//!
//! Sets of tasks are words with a bit for each rank, so the most urgent task of a set is its lowest bit, and
//! no entry looks at tasks that it does not concern.

use crate::scheduler::Scheduler;
use crate::task::{Class, TaskId, Wake};

/// What the processor is given to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Picked {
    /// The task.
    pub task: TaskId,
    /// Its job begins: it starts at its entry.
    pub begins: bool,
    /// The start of its job is still to be measured.
    pub starts: bool,
    /// The wait in a call that has ended, if one has.
    pub wake: Option<Wake>,
}

impl<const T: usize, const P: usize, const O: usize> Scheduler<T, P, O> {
    /// The most urgent task of a set of ranks.
    pub(crate) const fn first_of(&self, set: u64) -> Option<TaskId> {
        if set == 0 { None } else { Some(self.order[set.trailing_zeros() as usize % T]) }
    }

    /// Gives the processor to the most urgent ready task.
    #[inline]
    pub fn pick(&mut self) -> Option<Picked> {
        self.running = if self.ready & self.out_of_rank == 0 {
            self.first_of(self.ready)
        } else {
            self.first_out_of_rank()
        };
        let id = self.running?;
        let task = &mut self.tasks[id.index()];
        if self.last != id {
            self.last = id;
            task.statistics.switches += 1;
        }
        let begins = !core::mem::replace(&mut task.started, true);
        Some(Picked { task: id, begins, starts: !task.measured, wake: task.wake.take() })
    }

    /// The most urgent ready task, if one of them is not at its rank.
    fn first_out_of_rank(&self) -> Option<TaskId> {
        let task = |id: TaskId| &self.tasks[id.index()];
        let ready = || self.order.iter().copied().filter(|id| self.ready & task(*id).bit() != 0);
        let key = |id: &TaskId| {
            let task = task(*id);
            (task.class(), task.urgency(), task.held == 0, task.rank)
        };
        let best = ready().min_by_key(key)?;
        if task(best).class() != Class::Freewheeling {
            return Some(best);
        }
        // Neither of them need ever end.
        let starting = ready().filter(|id| task(*id).class() == Class::Initialisation);
        let shares = |id: &TaskId| task(*id).executed <= task(best).executed;
        Some(starting.min_by_key(key).filter(shares).unwrap_or(best))
    }
}
