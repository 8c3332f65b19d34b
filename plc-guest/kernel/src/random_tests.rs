//! A million random calls.
//!
//! [`search_tests`](crate::search_tests) goes through every state of small systems. This is a large one: three
//! programs that are initialised, stop, fail and start anew, tasks of all kinds, time, and calls with any
//! number, object, mask and time-out. After each step all that the search demands must hold, and what else is
//! kept twice must agree. What calls do with pointers is not here: in the lab a program at ring 3 makes
//! random calls too (`tests/tests/nested/tasks_faults.rs`).

use crate::objects::{Object, Received, Sent, WAIT_MAX};
use crate::scheduler::{Phase, Scheduler};
use crate::search_tests::check;
use crate::task::{Class, ProgramId, Release, Settings, State, TaskId, Wait};
use crate::time::{Instant, Span};
use takt_program::call::{Call, Error};

const TASKS: usize = 12;
const PROGRAMS: usize = 3;
const OBJECTS: usize = 18;
const CALLS: u32 = 1_000_000;

type Kernel = Scheduler<TASKS, PROGRAMS, OBJECTS>;

/// Knuth's MMIX generator.
struct Random(u64);

impl Random {
    fn any(&mut self) -> u64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        self.0 ^ self.0 >> 32
    }

    fn below(&mut self, end: u64) -> u64 {
        (self.any() >> 8) % end
    }

    /// A number that programs might use, or any.
    fn number(&mut self, usual: u64) -> u64 {
        if self.below(16) == 0 { self.any() } else { self.below(usual) }
    }
}

fn start() -> Kernel {
    let mut s = Scheduler::new();
    for _ in 0..PROGRAMS {
        let objects = [
            Object::semaphore(3),
            Object::semaphore(0),
            Object::queue(1),
            Object::queue(5),
            Object::mailbox(),
            Object::Flags(0),
        ];
        let program = s.add_program(objects.into_iter()).expect("there is room");
        let releases = [
            Release::Start,
            Release::Cyclic { period: Span(1_000), offset: Span(100) },
            Release::Event { minimum: Span(700) },
            match program.0 {
                0 => Release::Freewheeling,
                _ => Release::Cyclic { period: Span(7_000), offset: Span::ZERO },
            },
        ];
        for (number, release) in (0..).zip(releases) {
            let settings = Settings {
                program,
                release,
                priority: number + program.0,
                deadline: Span(u64::from(number) * 900),
                budget: Span(u64::from(program.0) * 400),
                sensitivity: number.into(),
            };
            s.add_task(settings).expect("there is room");
        }
    }
    s
}

/// What a program asks for. False if there is no such call.
fn call(s: &mut Kernel, caller: TaskId, now: Instant, random: &mut Random) -> bool {
    let program = s.task(caller).settings().program;
    let number = random.number(16);
    let Some(call) = u32::try_from(number).ok().and_then(Call::from_code) else {
        return false;
    };
    let object = random.number(7);
    let id = match s.object_of(program, object) {
        Ok(id) => id,
        Err(error) => {
            assert_eq!((error, object < 6), (Error::BadId, false));
            return true;
        }
    };
    assert_eq!(u64::from(id.0), u64::from(program.0) * 6 + object, "an object of another program");
    let (mask, timeout) = (random.number(4) as u32, Span(random.number(2_000)));
    let kind = s.object_at(id);
    let right = match call {
        Call::SemaphoreTake => {
            let taken = s.take(id);
            // The most urgent task of the program has the priority behind its number.
            let declared = if object == 0 { 3 } else { 0 };
            let ceiling = declared.max(program.0 + 1);
            let holds = Object::Semaphore { ceiling, holder: Some(caller) };
            assert!(taken.is_err() || s.object_at(id) == holds);
            matches!(kind, Object::Semaphore { .. }) || taken == Err(Error::BadId)
        }
        Call::SemaphoreGive => match (s.give(id), kind) {
            (Ok(()), Object::Semaphore { holder, .. }) => holder == Some(caller),
            (answer, Object::Semaphore { .. }) => answer == Err(Error::NotAllowed),
            (answer, _) => answer == Err(Error::BadId),
        },
        Call::QueueSend => match (s.send(id), kind) {
            (Ok(Sent::Slot(slot)), Object::Queue { depth, count, .. }) => {
                slot < depth && count < depth
            }
            (Ok(Sent::To(receiver)), Object::Queue { count, .. }) => {
                count == 0 && s.task(receiver).state() == State::Ready
            }
            (Err(Error::Full), Object::Queue { depth, count, .. }) => count == depth,
            (answer, _) => answer == Err(Error::BadId),
        },
        Call::QueueReceive => match (s.receive(id, now, timeout), kind) {
            (Ok(Received::Slot(slot)), Object::Queue { first, count, .. }) => {
                slot == first && count > 0
            }
            (Ok(Received::Waits), Object::Queue { count, .. }) => count == 0 && timeout <= WAIT_MAX,
            (answer, Object::Queue { .. }) => answer != Err(Error::BadId),
            (answer, _) => answer == Err(Error::BadId),
        },
        Call::MailboxWrite => s.write(id).is_ok() == matches!(kind, Object::Mailbox { .. }),
        Call::MailboxRead => match kind {
            Object::Mailbox { written, .. } => s.read(id).is_ok() == written,
            _ => s.read(id) == Err(Error::BadId),
        },
        Call::FlagsSet => s.set_flags(id, mask).is_ok() == matches!(kind, Object::Flags(_)),
        Call::FlagsClear => s.clear_flags(id, mask).is_ok() == matches!(kind, Object::Flags(_)),
        Call::FlagsWait => {
            let answer = s.wait_flags(id, mask, random.below(2) == 0, now, timeout);
            answer.is_err() || (matches!(kind, Object::Flags(_)) && mask != 0)
        }
        Call::End => {
            s.end(now);
            true
        }
        Call::Stop => {
            s.stop(program);
            s.phase(program) == Phase::Stopped
        }
        Call::Time | Call::Log | Call::ChannelRead | Call::ChannelWrite => true,
    };
    assert!(right, "{call:?} of {kind:?}");
    true
}

/// One thing that happens. True if it was a call.
fn step(s: &mut Kernel, now: &mut Instant, random: &mut Random) -> bool {
    let chosen = TaskId(random.below(TASKS as u64) as u8);
    let program = ProgramId(random.below(PROGRAMS as u64) as u8);
    match (random.below(32), s.running()) {
        (0, _) => {
            *now = now.after(Span(random.below(3_000)));
            s.advance(*now);
            let mut late = 0;
            while s.take_late().is_some() {
                late += 1;
                assert!(late <= TASKS, "a deadline is told twice");
            }
        }
        (1, _) => s.window(*now),
        (2 | 3, _) if matches!(s.task(chosen).settings().release, Release::Event { .. }) => {
            s.signal(chosen, *now);
        }
        (4, _) if s.phase(program) == Phase::Stopped => s.start(program, *now),
        (5, Some(_)) => drop(s.account(s.running().unwrap(), Span(random.below(500)))),
        // The kernel ends no initialisation but with its program.
        (6, Some(id)) if s.task(id).settings().release != Release::Start => s.skip(id, *now),
        (7, Some(id)) if random.below(64) == 0 => s.fail(id),
        (8, _) if random.below(64) == 0 && s.phase(program) == Phase::Running => {
            s.abandon(program, *now)
        }
        (_, Some(id)) => return call(s, id, *now, random),
        _ => {}
    }
    false
}

/// What is kept twice agrees, and the most urgent task runs.
fn agrees(s: &Kernel) {
    let (mut ready, mut in_call, mut out_of_rank) = (0, 0, 0);
    let mut event = Instant::NEVER;
    for id in s.ids() {
        let task = s.task(id);
        let bit = |is: bool| if is { task.bit() } else { 0 };
        let state = task.state();
        ready |= bit(state == State::Ready);
        in_call |= bit(matches!(state, State::Waiting(Wait::Message(_) | Wait::Flags { .. })));
        out_of_rank |= bit(task.held != 0 || task.settings().release == Release::Start);
        event = event.min(task.event());
        let stopped = s.phase(task.settings().program) == Phase::Stopped;
        assert!(!stopped || !task.is_active(), "a task of a stopped program has a job");
    }
    assert_eq!((s.ready, s.in_call, s.out_of_rank), (ready, in_call, out_of_rank));
    assert!(s.next_event() <= event, "time would pass over something");
    let rank = |id: TaskId| (s.task(id).class(), s.task(id).urgency(), s.task(id).held == 0, id);
    let ready = || s.ids().filter(|id| s.task(*id).state() == State::Ready);
    let mut most_urgent = ready().min_by_key(|id| rank(*id));
    // A freewheeling job and an initialisation share.
    if let Some(best) = most_urgent
        && s.task(best).class() == Class::Freewheeling
    {
        let starting = ready().filter(|id| s.task(*id).class() == Class::Initialisation);
        let first = starting.min_by_key(|id| rank(*id));
        let comes_first = |id: &TaskId| s.task(*id).executed <= s.task(best).executed;
        most_urgent = first.filter(comes_first).or(most_urgent);
    }
    assert_eq!(s.running(), most_urgent);
}

#[test]
fn a_million_random_calls_leave_a_whole_state() {
    let (mut s, mut now, mut random) = (start(), Instant(0), Random(1));
    let (mut calls, mut answered) = (0, 0u32);
    while calls < CALLS {
        let called = step(&mut s, &mut now, &mut random);
        calls += u32::from(called);
        s.pick();
        check(&s);
        agrees(&s);
        answered += u32::from(called && s.running().is_some());
    }
    // All that can happen did: jobs ended, were skipped and late, and budgets were used up.
    let all = |of: fn(&crate::statistics::Statistics) -> u64| -> u64 {
        s.ids().map(|id| of(s.task(id).statistics())).sum()
    };
    for count in [
        all(|one| one.jobs),
        all(|one| one.skipped),
        all(|one| one.misses),
        all(|one| one.over_budget),
        all(|one| one.overruns),
    ] {
        assert!(count > 1_000, "{count}");
    }
    assert!(answered > 100_000, "{answered}");
}
