//! Semaphores, queues, mailboxes and event flags.
//!
//! They are created from the image of a program before it starts, and only tasks of that program can
//! name them, so that no program can keep another waiting.
//!
//! **Semaphores** follow the immediate priority ceiling protocol (Sha, Rajkumar and Lehoczky 1990, in
//! the form that POSIX calls `PTHREAD_PRIO_PROTECT`): who takes one runs at its ceiling, the most urgent
//! priority of those that use it, until it is given back. As tasks do not wait while they hold one,
//! a semaphore is always free when a task that may take it runs. So taking never waits, no deadlock
//! can be built, and a task is delayed by at most one critical section of a less urgent one. Three
//! rules make that so, and each is an error if it is broken: a task more urgent than the ceiling may
//! not take the semaphore, a task may not take what it holds, and who holds one may not wait.
//!
//! Programs do not trust each other. So a ceiling is never more urgent than the program's own most urgent task, a freewheeling
//! task without a budget may take none, and an initialisation, beside which no task of its program runs, is not raised.
//!
//! **Queues** hand a message to the most urgent waiting task directly, so that no third task can take it in
//! between.

use crate::scheduler::Scheduler;
use crate::task::{ProgramId, Release, State, TaskId, Wait, Wake};
use crate::time::{Instant, Span};
use core::ops::Range;
use takt_program::call::Error;
use takt_program::limit;

/// Place of an object in the scheduler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectId(pub u8);

impl ObjectId {
    const fn index(self) -> usize {
        self.0 as usize
    }
}

/// Longest wait of a call: an hour. A longer one is refused, so that a wait without end cannot be
/// written by mistake.
pub const WAIT_MAX: Span = Span(limit::WAIT_NS);

/// A kernel object.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Object {
    /// Mutual exclusion.
    Semaphore {
        /// The most urgent priority of its users.
        ceiling: u8,
        /// Who has it.
        holder: Option<TaskId>,
    },
    /// Messages, first in, first out.
    Queue {
        /// Messages that it has room for.
        depth: u32,
        /// Slot of the oldest.
        first: u32,
        /// Messages in it.
        count: u32,
    },
    /// The newest message.
    Mailbox {
        /// It has been written.
        written: bool,
        /// Tasks that have read it since, a bit for each.
        seen: u64,
    },
    /// 32 flags.
    Flags(u32),
}

impl Object {
    /// A free semaphore.
    #[must_use]
    pub const fn semaphore(ceiling: u8) -> Self {
        Self::Semaphore { ceiling, holder: None }
    }

    /// An empty queue.
    #[must_use]
    pub const fn queue(depth: u32) -> Self {
        Self::Queue { depth, first: 0, count: 0 }
    }

    /// An empty mailbox.
    #[must_use]
    pub const fn mailbox() -> Self {
        Self::Mailbox { written: false, seen: 0 }
    }

    /// As it was created.
    pub(crate) const fn fresh(self) -> Self {
        match self {
            Self::Semaphore { ceiling, .. } => Self::semaphore(ceiling),
            Self::Queue { depth, .. } => Self::queue(depth),
            Self::Mailbox { .. } => Self::mailbox(),
            Self::Flags(_) => Self::Flags(0),
        }
    }
}

/// Where a message that is sent goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sent {
    /// Into this slot of the queue.
    Slot(u32),
    /// To this task, which was waiting and is ready now.
    To(TaskId),
}

/// Where a message that is received comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// Out of this slot of the queue.
    Slot(u32),
    /// There is none: the task waits.
    Waits,
}

/// What a look at flags leads to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// They are as wanted: those of the wanted flags that are set.
    Flags(u32),
    /// They are not: the task waits.
    Waits,
}

impl<const T: usize, const P: usize, const O: usize> Scheduler<T, P, O> {
    /// The object that a program knows by this number.
    ///
    /// # Errors
    /// [`Error::BadId`].
    pub fn object_of(&self, program: ProgramId, number: u64) -> Result<ObjectId, Error> {
        let Range { start, end } =
            self.programs.get(program.index()).ok_or(Error::BadId)?.objects.clone();
        if number < u64::from(end - start) {
            Ok(ObjectId(start + number as u8))
        } else {
            Err(Error::BadId)
        }
    }

    fn object(&mut self, id: ObjectId) -> Result<&mut Object, Error> {
        self.objects.get_mut(id.index()).ok_or(Error::BadId)
    }

    fn caller(&self) -> Result<TaskId, Error> {
        self.running.ok_or(Error::NotAllowed)
    }

    /// The running task takes a semaphore. It never waits.
    ///
    /// # Errors
    /// [`Error::Ceiling`] if a rule of the protocol is broken; [`Error::NotAllowed`] for a freewheeling task without a budget;
    /// [`Error::BadId`].
    pub fn take(&mut self, id: ObjectId) -> Result<(), Error> {
        let caller = self.caller()?;
        let settings = self.tasks[caller.index()].settings;
        let own = settings.urgency();
        let Object::Semaphore { ceiling, holder } = self.object(id)? else {
            return Err(Error::BadId);
        };
        // Nothing ends its job, and it would come before the tasks of other programs until then.
        if settings.release == Release::Freewheeling && settings.budget == Span::ZERO {
            return Err(Error::NotAllowed);
        }
        if holder.is_some() || own < *ceiling {
            return Err(Error::Ceiling);
        }
        *holder = Some(caller);
        let ceiling = *ceiling;
        let bit = self.bit(id, caller);
        let task = &mut self.tasks[caller.index()];
        task.held |= bit;
        self.out_of_rank |= task.bit();
        task.effective = task.effective.min(ceiling);
        Ok(())
    }

    /// The running task gives a semaphore back.
    ///
    /// # Errors
    /// [`Error::NotAllowed`] if it does not hold it; [`Error::BadId`].
    pub fn give(&mut self, id: ObjectId) -> Result<(), Error> {
        let caller = self.caller()?;
        match self.object(id)? {
            Object::Semaphore { holder, .. } if *holder == Some(caller) => *holder = None,
            Object::Semaphore { .. } => return Err(Error::NotAllowed),
            _ => return Err(Error::BadId),
        }
        self.tasks[caller.index()].held &= !self.bit(id, caller);
        self.settle(caller);
        Ok(())
    }

    /// Works out at which priority a task runs from what it holds.
    fn settle(&mut self, id: TaskId) {
        let task = &self.tasks[id.index()];
        let held = self.own(id).iter().enumerate().filter(|(n, _)| task.held >> n & 1 != 0);
        let ceilings = held.filter_map(|(_, object)| match object {
            Object::Semaphore { ceiling, .. } => Some(*ceiling),
            _ => None,
        });
        let effective = ceilings.fold(task.settings.urgency(), u8::min);
        self.tasks[id.index()].effective = effective;
        self.holds_nothing_more(id);
    }

    /// A task that holds nothing any more is at its rank again, if it ever is.
    fn holds_nothing_more(&mut self, id: TaskId) {
        let task = &self.tasks[id.index()];
        if task.held == 0 && task.settings.release != Release::Start {
            self.out_of_rank &= !task.bit();
        }
    }

    /// Gives back all that a task holds: its job is over.
    #[inline]
    pub(crate) fn give_all(&mut self, id: TaskId) {
        if self.tasks[id.index()].held != 0 {
            self.give_held(id);
        }
    }

    #[inline(never)]
    fn give_held(&mut self, id: TaskId) {
        let held = core::mem::take(&mut self.tasks[id.index()].held);
        self.settle(id);
        let range = self.places(id);
        let own = self.objects[range].iter_mut().enumerate();
        for (_, object) in own.filter(|(n, _)| held >> n & 1 != 0) {
            *object = object.fresh();
        }
    }

    fn places(&self, id: TaskId) -> Range<usize> {
        let program = self.tasks[id.index()].settings.program;
        let Range { start, end } = self.programs[program.index()].objects;
        usize::from(start)..usize::from(end)
    }

    /// The objects of a task's program.
    fn own(&self, id: TaskId) -> &[Object] {
        &self.objects[self.places(id)]
    }

    /// The bit of an object in the set of those that a task holds: its number in the program.
    fn bit(&self, id: ObjectId, task: TaskId) -> u64 {
        1 << (id.index() - self.places(task).start)
    }

    /// The running task sends a message, which the caller of this has to copy.
    ///
    /// # Errors
    /// [`Error::Full`], [`Error::BadId`].
    pub fn send(&mut self, id: ObjectId) -> Result<Sent, Error> {
        let Object::Queue { depth, first, count } = *self.object(id)? else {
            return Err(Error::BadId);
        };
        let mut waiting = self.in_call;
        while let Some(receiver) = self.first_of(waiting) {
            if self.tasks[receiver.index()].state == State::Waiting(Wait::Message(id.0)) {
                self.wake(receiver, Wake::Message);
                return Ok(Sent::To(receiver));
            }
            waiting &= waiting - 1;
        }
        if count >= depth {
            return Err(Error::Full);
        }
        *self.object(id)? = Object::Queue { depth, first, count: count + 1 };
        Ok(Sent::Slot((first + count) % depth))
    }

    /// The running task receives the oldest message, which the caller of this has to copy, or waits.
    ///
    /// # Errors
    /// [`Error::Empty`] if there is none and the time-out is zero; those of a wait; [`Error::BadId`].
    pub fn receive(
        &mut self,
        id: ObjectId,
        now: Instant,
        timeout: Span,
    ) -> Result<Received, Error> {
        let Object::Queue { depth, first, count } = *self.object(id)? else {
            return Err(Error::BadId);
        };
        if count == 0 {
            self.wait(Wait::Message(id.0), now, timeout)?;
            return Ok(Received::Waits);
        }
        *self.object(id)? = Object::Queue { depth, first: (first + 1) % depth, count: count - 1 };
        Ok(Received::Slot(first))
    }

    /// Replaces the message of a mailbox, which the caller of this has to copy.
    ///
    /// # Errors
    /// [`Error::BadId`].
    pub fn write(&mut self, id: ObjectId) -> Result<(), Error> {
        match self.object(id)? {
            mailbox @ Object::Mailbox { .. } => {
                *mailbox = Object::Mailbox { written: true, seen: 0 };
                Ok(())
            }
            _ => Err(Error::BadId),
        }
    }

    /// The running task looks at the message of a mailbox. True if it has not read it before.
    ///
    /// # Errors
    /// [`Error::Empty`] if nothing was ever written; [`Error::BadId`].
    pub fn read(&mut self, id: ObjectId) -> Result<bool, Error> {
        let reader = self.caller()?.bit();
        match self.object(id)? {
            Object::Mailbox { written: true, seen } => {
                let fresh = *seen & reader == 0;
                *seen |= reader;
                Ok(fresh)
            }
            Object::Mailbox { .. } => Err(Error::Empty),
            _ => Err(Error::BadId),
        }
    }

    /// Sets flags, and wakes all whose wish is fulfilled.
    ///
    /// # Errors
    /// [`Error::BadId`].
    #[inline]
    pub fn set_flags(&mut self, id: ObjectId, mask: u32) -> Result<(), Error> {
        let Object::Flags(flags) = self.object(id)? else {
            return Err(Error::BadId);
        };
        *flags |= mask;
        let flags = *flags;
        let mut waiting = self.in_call;
        while let Some(waiter) = self.first_of(waiting) {
            waiting &= waiting - 1;
            if let State::Waiting(Wait::Flags { object, mask, all }) =
                self.tasks[waiter.index()].state
                && object == id.0
                && fulfilled(flags, mask, all)
            {
                self.wake(waiter, Wake::Flags(flags & mask));
            }
        }
        Ok(())
    }

    /// Clears flags.
    ///
    /// # Errors
    /// [`Error::BadId`].
    pub fn clear_flags(&mut self, id: ObjectId, mask: u32) -> Result<(), Error> {
        match self.object(id)? {
            Object::Flags(flags) => {
                *flags &= !mask;
                Ok(())
            }
            _ => Err(Error::BadId),
        }
    }

    /// The running task waits until all or any of these flags are set.
    ///
    /// # Errors
    /// [`Error::NotAllowed`] for no flags; those of a wait; [`Error::BadId`].
    pub fn wait_flags(
        &mut self,
        id: ObjectId,
        mask: u32,
        all: bool,
        now: Instant,
        timeout: Span,
    ) -> Result<Seen, Error> {
        let Object::Flags(flags) = *self.object(id)? else {
            return Err(Error::BadId);
        };
        if mask == 0 {
            return Err(Error::NotAllowed);
        }
        if fulfilled(flags, mask, all) {
            return Ok(Seen::Flags(flags & mask));
        }
        self.wait(Wait::Flags { object: id.0, mask, all }, now, timeout)?;
        Ok(Seen::Waits)
    }

    fn wait(&mut self, wait: Wait, now: Instant, timeout: Span) -> Result<(), Error> {
        let caller = self.caller()?;
        if timeout == Span::ZERO {
            return Err(Error::Empty);
        }
        if timeout > WAIT_MAX {
            return Err(Error::NotAllowed);
        }
        if self.tasks[caller.index()].held != 0 {
            return Err(Error::Ceiling);
        }
        let task = &mut self.tasks[caller.index()];
        task.state = State::Waiting(wait);
        task.until = now.after(timeout);
        self.next = self.next.min(task.until);
        self.ready &= !task.bit();
        self.in_call |= task.bit();
        self.running = None;
        Ok(())
    }
}

const fn fulfilled(flags: u32, mask: u32, all: bool) -> bool {
    let set = flags & mask;
    set != 0 && (!all || set == mask)
}
