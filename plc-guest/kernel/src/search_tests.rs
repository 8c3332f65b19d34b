//! Every state of small systems: up to four tasks and three objects.
//!
//! The search leaves time out. A release, the end of a time-out and the end of a job may happen at any
//! moment, so whatever periods, offsets and execution times do, it is among the sequences that are
//! searched. In each state the running task may make every call that there is; states that differ only in
//! counters are one.
//!
//! What must hold in every state:
//! - *mutual exclusion*: no two tasks hold a semaphore, and scheduler and semaphore agree on who does;
//! - *no deadlock*: a holder is ready, and taking a semaphore never finds it taken by another;
//! - *inversion is bounded*: from its release on, a job sees at most one critical section of less urgent
//!   tasks run before it;
//! - *no lost wake-up*: no task waits for what is there.
//!
//! All priorities and every choice of users of the objects are taken. With TAKT_TEST_LONG there is one more
//! system, the largest.

use crate::objects::{Object, ObjectId, Received, Seen, Sent};
use crate::scheduler::Scheduler;
use crate::task::{ProgramId, Release, Settings, State, TaskId, Wait, Wake};
use crate::time::{Instant, Span};
use std::collections::HashSet;
use takt_program::call::Error;

const OBJECTS: usize = 3;
const NOW: Instant = Instant(0);
const LONG: Span = Span(1_000);
/// Flags that are used.
const ONE: u32 = 1;
const BOTH: u32 = 3;

/// What a task has seen of less urgent ones since it became ready.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
enum Blocked {
    Never,
    By(TaskId),
    Once,
}

#[derive(Clone)]
struct Model<const T: usize> {
    scheduler: Scheduler<T, 1, OBJECTS>,
    blocked: [Blocked; T],
}

/// What is searched: priorities, and who uses which object.
#[derive(Clone, Debug)]
struct System<const T: usize> {
    priorities: [u8; T],
    objects: [(Kind, u8); OBJECTS],
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Kind {
    None,
    Semaphore,
    Queue,
    Flags,
}

#[derive(Clone, Copy, Debug)]
enum Step {
    Signal(TaskId),
    TimeOut(TaskId),
    End,
    Skip,
    Take(ObjectId),
    Give(ObjectId),
    Send(ObjectId),
    Receive(ObjectId),
    Set(ObjectId, u32),
    Clear(ObjectId, u32),
    Await(ObjectId, bool),
}

impl<const T: usize> System<T> {
    fn uses(&self, task: TaskId, object: usize) -> bool {
        self.objects[object].1 >> task.0 & 1 != 0
    }

    fn start(&self) -> Model<T> {
        let mut scheduler = Scheduler::new();
        let objects = self.objects.iter().map(|(kind, users)| match kind {
            Kind::Semaphore => {
                let users = self.priorities.iter().enumerate().filter(|(i, _)| users >> i & 1 != 0);
                Object::semaphore(users.map(|(_, priority)| *priority).min().unwrap_or(0))
            }
            Kind::Queue => Object::queue(2),
            Kind::None | Kind::Flags => Object::Flags(0),
        });
        let program = scheduler.add_program(objects).expect("there is room");
        for priority in self.priorities {
            let settings = Settings {
                program,
                release: Release::Event { minimum: Span::ZERO },
                priority,
                deadline: Span::ZERO,
                budget: Span::ZERO,
                sensitivity: 0,
            };
            scheduler.add_task(settings).expect("there is room");
        }
        scheduler.start(ProgramId(0), NOW);
        Model { scheduler, blocked: [Blocked::Never; T] }
    }

    /// All that can happen in a state.
    fn steps(&self, model: &Model<T>) -> Vec<Step> {
        let mut steps = Vec::new();
        for id in model.scheduler.ids() {
            match model.scheduler.task(id).state() {
                State::Waiting(Wait::Release) => steps.push(Step::Signal(id)),
                State::Waiting(_) => steps.push(Step::TimeOut(id)),
                _ => {}
            }
        }
        let Some(running) = model.scheduler.running() else {
            return steps;
        };
        steps.extend([Step::End, Step::Skip]);
        for place in (0..OBJECTS).filter(|place| self.uses(running, *place)) {
            let id = ObjectId(place as u8);
            match self.objects[place].0 {
                Kind::Semaphore => steps.extend([Step::Take(id), Step::Give(id)]),
                Kind::Queue => steps.extend([Step::Send(id), Step::Receive(id)]),
                Kind::Flags => steps.extend([
                    Step::Set(id, ONE),
                    Step::Set(id, BOTH),
                    Step::Clear(id, ONE),
                    Step::Await(id, true),
                    Step::Await(id, false),
                ]),
                Kind::None => {}
            }
        }
        steps
    }
}

impl<const T: usize> Model<T> {
    /// Does one step, and gives the processor to whom it belongs then.
    fn after(&self, step: Step) -> Self {
        let mut next = self.clone();
        let s = &mut next.scheduler;
        let before = s.running();
        match step {
            Step::Signal(id) => s.signal(id, NOW),
            Step::TimeOut(id) => s.wake(id, Wake::TimedOut),
            Step::End => {
                s.end(NOW);
            }
            Step::Skip => s.skip(before.expect("somebody runs"), NOW),
            Step::Take(id) => {
                let own = s.task(before.expect("somebody runs")).held >> id.0 & 1 != 0;
                // The priorities are right, so what else could refuse it?
                assert_eq!(s.take(id), if own { Err(Error::Ceiling) } else { Ok(()) });
            }
            Step::Give(id) => {
                let own = s.task(before.expect("somebody runs")).held >> id.0 & 1 != 0;
                assert_eq!(s.give(id), if own { Ok(()) } else { Err(Error::NotAllowed) });
            }
            Step::Send(id) => match s.send(id) {
                Ok(Sent::To(receiver)) => assert_eq!(s.task(receiver).state(), State::Ready),
                Ok(Sent::Slot(slot)) => assert!(slot < 2),
                Err(error) => assert_eq!(error, Error::Full),
            },
            Step::Receive(id) => match s.receive(id, NOW, LONG) {
                Ok(Received::Slot(slot)) => assert!(slot < 2),
                Ok(Received::Waits) => {}
                Err(error) => assert_eq!(error, Error::Ceiling),
            },
            Step::Set(id, mask) => s.set_flags(id, mask).expect("they are flags"),
            Step::Clear(id, mask) => s.clear_flags(id, mask).expect("they are flags"),
            Step::Await(id, all) => match s.wait_flags(id, BOTH, all, NOW, LONG) {
                Ok(Seen::Flags(flags)) => assert!(flags != 0),
                Ok(Seen::Waits) => {}
                Err(error) => assert_eq!(error, Error::Ceiling),
            },
        }
        s.pick();
        next.watch();
        next
    }

    /// Follows which critical sections delay whom.
    fn watch(&mut self) {
        let s = &self.scheduler;
        for id in s.ids() {
            let blocked = &mut self.blocked[id.index()];
            if s.task(id).state() != State::Ready || s.running() == Some(id) {
                *blocked = Blocked::Never;
                continue;
            }
            // A section has ended when its task holds nothing any more.
            if let Blocked::By(holder) = *blocked
                && s.task(holder).held == 0
            {
                *blocked = Blocked::Once;
            }
            let Some(running) = s.running() else {
                panic!("a task is ready and none runs");
            };
            let rank = |id| (s.task(id).settings.priority, id);
            if rank(running) < rank(id) {
                continue;
            }
            assert!(s.task(running).held != 0, "a less urgent task runs, without a semaphore");
            match *blocked {
                // It had begun before the task was ready: otherwise this task would have been run,
                // without a semaphore, in the state in which it took the first.
                Blocked::Never => *blocked = Blocked::By(running),
                Blocked::By(holder) => assert_eq!(holder, running, "a second section"),
                Blocked::Once => panic!("a second section"),
            }
        }
    }

    /// What decides what can happen next. States with the same key are the same.
    fn key(&self) -> Vec<u8> {
        let s = &self.scheduler;
        let mut key = Vec::with_capacity(4 * T + 2 * OBJECTS);
        for id in s.ids() {
            let task = s.task(id);
            let (state, detail) = match task.state() {
                State::Dormant | State::Faulted => (0, 0),
                State::Waiting(Wait::Release) => (1, 0),
                State::Ready => (2, 0),
                State::Waiting(Wait::Message(place)) => (3, place),
                State::Waiting(Wait::Flags { object, all, .. }) => (4, object << 1 | u8::from(all)),
            };
            let blocked = match self.blocked[id.index()] {
                Blocked::Never => 0xff,
                Blocked::Once => 0xfe,
                Blocked::By(holder) => holder.0,
            };
            key.extend([state, detail, task.held as u8, blocked]);
        }
        for place in 0..OBJECTS as u8 {
            key.extend(match s.object_at(ObjectId(place)) {
                Object::Queue { first, count, .. } => [first as u8, count as u8],
                Object::Flags(flags) => [flags as u8, 0],
                // The holder is known.
                Object::Semaphore { .. } | Object::Mailbox { .. } => [0, 0],
            });
        }
        key
    }
}

/// What must hold between any two steps, in a system of any size.
pub fn check<const T: usize, const P: usize, const O: usize>(s: &Scheduler<T, P, O>) {
    for program in s.programs() {
        let objects = s.programs[program.index()].objects.clone();
        let mut seen = 0;
        for task in s.ids().map(|id| s.task(id)).filter(|task| task.settings.program == program) {
            assert_eq!(task.held & seen, 0, "two tasks hold a semaphore");
            seen |= task.held;
            assert!(task.held == 0 || task.state() == State::Ready, "a holder waits");
        }
        for (number, place) in objects.enumerate() {
            if let Object::Semaphore { holder, .. } = s.object_at(ObjectId(place)) {
                assert_eq!(holder.is_some(), seen >> number & 1 != 0);
                assert!(holder.is_none_or(|id| s.task(id).held >> number & 1 != 0));
            }
        }
    }
    for id in s.ids() {
        match s.task(id).state() {
            State::Waiting(Wait::Message(place)) => {
                let queue = s.object_at(ObjectId(place));
                assert!(matches!(queue, Object::Queue { count: 0, .. }), "a lost wake-up");
            }
            State::Waiting(Wait::Flags { object, mask, all }) => {
                let Object::Flags(flags) = s.object_at(ObjectId(object)) else {
                    panic!("waits for flags that are none");
                };
                let set = flags & mask;
                assert!(if all { set != mask } else { set == 0 }, "a lost wake-up");
            }
            _ => {}
        }
    }
}

/// Goes through all states; returns how many there are.
fn search<const T: usize>(system: &System<T>) -> usize {
    let start = system.start();
    let mut seen = HashSet::from([start.key()]);
    let mut open = vec![start];
    while let Some(model) = open.pop() {
        for step in system.steps(&model) {
            let next = model.after(step);
            check(&next.scheduler);
            if seen.insert(next.key()) {
                open.push(next);
            }
        }
    }
    seen.len()
}

/// All priorities of `T` tasks, up to renaming: each is that of the one before, or the next.
fn priorities<const T: usize>() -> Vec<[u8; T]> {
    let choices = 1 << (T - 1);
    let priorities = (0..choices).map(|choice: u32| {
        let mut next = 10;
        core::array::from_fn(|task| {
            next += if task > 0 { (choice >> (task - 1) & 1) as u8 } else { 0 };
            next
        })
    });
    priorities.collect()
}

/// Searches every system with these kinds of objects. Returns how many states that were.
fn search_all<const T: usize>(kinds: [Kind; OBJECTS]) -> usize {
    let everybody = (1u8 << T) - 1;
    let mut states = 0;
    for priorities in priorities::<T>() {
        for first in 3..=everybody {
            for second in 1..=everybody {
                for third in 1..=everybody {
                    let users = [first, second, third];
                    // The same with objects of one kind exchanged is the same, and an object of one
                    // task alone is none.
                    let ordered =
                        (0..2).all(|i| kinds[i] != kinds[i + 1] || users[i] <= users[i + 1]);
                    let needed = (0..OBJECTS).all(|i| match kinds[i] {
                        Kind::None => users[i] == 1,
                        _ => users[i].count_ones() > 1,
                    });
                    if ordered && needed {
                        let objects = core::array::from_fn(|i| (kinds[i], users[i]));
                        states += search(&System { priorities, objects });
                    }
                }
            }
        }
    }
    states
}

#[test]
fn three_semaphores_of_four_tasks() {
    let states = search_all::<4>([Kind::Semaphore; 3]);
    assert!(states > 100_000, "{states}");
}

#[test]
fn a_semaphore_a_queue_and_flags_of_three_tasks() {
    let states = search_all::<3>([Kind::Semaphore, Kind::Queue, Kind::Flags]);
    assert!(states > 100_000, "{states}");
}

#[test]
fn a_semaphore_and_a_queue_of_four_tasks() {
    let states = search_all::<4>([Kind::Semaphore, Kind::Queue, Kind::None]);
    assert!(states > 100_000, "{states}");
}

#[test]
fn a_semaphore_a_queue_and_flags_of_four_tasks() {
    if std::env::var_os("TAKT_TEST_LONG").is_some() {
        let states = search_all::<4>([Kind::Semaphore, Kind::Queue, Kind::Flags]);
        assert!(states > 10_000_000, "{states}");
    }
}
