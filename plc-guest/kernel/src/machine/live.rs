//! Orders from Takt while the PLC runs, and the answers.
//!
//! A step is one order, taken in a window in which no task is ready or will be, with time left for the longest of them:
//! so no release and no job ever waits for an order. Orders come from Takt and are checked all the same, as a
//! program's calls are. What cannot be answered because Takt has not taken the answers before is counted.

use super::kernel::Kernel;
use super::program::Program;
use takt_abi::live::{
    ANSWERS, Answer, Buffer, MESSAGE_BYTES, ORDERS, Order, ProgramRecord, ProgramState, Refusal,
    TASKS_EACH, TaskRecord, TaskState, decode_order,
};
use takt_abi::program::PROGRAMS_MAX;
use takt_channel::Tsc;
use takt_kernel::scheduler::Phase;
use takt_kernel::task::{State, TaskId};
use takt_plc_guest::channel::{self, Receiver, Sender};
use takt_plc_guest::cycle;

/// Time that a step may take, in ticks: 20 us at 1 GHz, 4 us at 5 GHz.
const STEP_TICKS: u64 = 20_000;
/// Orders that are taken in one window.
const ORDERS_EACH_WINDOW: u8 = 4;

/// The ends of both queues.
#[derive(Debug)]
pub struct Live {
    ends: Option<(Receiver, Sender)>,
    buffer: Buffer,
    /// Answers that had no room.
    dropped: u64,
    /// Orders that have been taken in the window of this release.
    taken: (u64, u8),
}

impl Live {
    /// Before the start.
    pub const CLOSED: Self =
        Self { ends: None, buffer: [0; MESSAGE_BYTES], dropped: 0, taken: (0, 0) };

    /// Opens both ends. Without them there are no orders, and the programs run all the same.
    pub fn open(&mut self) {
        let bytes = MESSAGE_BYTES as u32;
        let ends = (channel::receiver(ORDERS, bytes), channel::sender(ANSWERS, bytes));
        if let (Ok(orders), Ok(answers)) = ends {
            self.ends = Some((orders, answers));
        }
    }

    /// The next order, if this window may take one.
    fn take(&mut self, release: u64) -> Option<Result<(u32, Order), Option<u32>>> {
        if self.taken.0 != release {
            self.taken = (release, 0);
        }
        let (orders, _) = self.ends.as_mut()?;
        if self.taken.1 >= ORDERS_EACH_WINDOW {
            return None;
        }
        let received = orders.receive(&mut self.buffer).ok()?;
        self.taken.1 += 1;
        Some(decode_order(received.bytes))
    }

    fn answer(&mut self, number: u32, answer: &Answer) {
        let Some((_, answers)) = self.ends.as_mut() else { return };
        let message = answer.encode(number, &mut self.buffer);
        let sent = message.is_some_and(|m| answers.send(m, Tsc(cycle::now())).is_ok());
        if !sent {
            self.dropped = self.dropped.saturating_add(1);
        }
    }
}

impl Kernel {
    /// Carries out one order, if there is one, and time for it. True if there was.
    pub fn serve_order(&mut self, release: u64, end_tsc: u64) -> bool {
        if end_tsc.saturating_sub(cycle::now()) < STEP_TICKS {
            return false;
        }
        let Some(order) = self.live.take(release) else { return false };
        match order {
            Ok((number, order)) => {
                let answer = self.obey(order);
                self.live.answer(number, &answer);
            }
            Err(Some(number)) => {
                self.live.answer(number, &Answer::Reply(Err(Refusal::Unknown)));
            }
            Err(None) => {}
        }
        true
    }

    fn obey(&self, order: Order) -> Answer {
        match order {
            Order::Status { part: 0 } => self.programs_status(),
            Order::Status { part } => self.tasks_status((usize::from(part) - 1) * TASKS_EACH),
        }
    }

    fn programs_status(&self) -> Answer {
        let mut programs = [ProgramRecord::default(); PROGRAMS_MAX];
        let mut count = 0;
        for (record, program) in programs.iter_mut().zip(self.programs.iter().flatten()) {
            count += 1;
            *record =
                ProgramRecord { state: self.program_state(program), hash: program.image.hash() };
        }
        let tasks = self.scheduler.ids().count() as u8;
        Answer::Programs { programs, count, tasks, dropped: self.live.dropped }
    }

    fn program_state(&self, program: &Program) -> ProgramState {
        let mut tasks = self.scheduler.ids().map(|id| self.scheduler.task(id));
        let faulted = tasks
            .any(|task| task.settings().program == program.id && task.state() == State::Faulted);
        match self.scheduler.phase(program.id) {
            _ if program.is_loading() => ProgramState::Starting,
            Phase::Starting => ProgramState::Starting,
            Phase::Running => ProgramState::Running,
            Phase::Stopped if faulted => ProgramState::Faulted,
            Phase::Stopped => ProgramState::Stopped,
        }
    }

    fn tasks_status(&self, first: usize) -> Answer {
        let mut tasks = [TaskRecord::default(); TASKS_EACH];
        let mut count = 0;
        for (record, id) in tasks.iter_mut().zip(self.scheduler.ids().skip(first)) {
            count += 1;
            *record = self.task_record(id);
        }
        Answer::Tasks { first: first.min(usize::from(u8::MAX)) as u8, count, tasks }
    }

    fn task_record(&self, id: TaskId) -> TaskRecord {
        let (place, task) = (self.places[id.index()], self.scheduler.task(id));
        let figures = task.statistics();
        TaskRecord {
            program: place.program,
            state: match task.state() {
                State::Dormant => TaskState::Dormant,
                State::Waiting(_) => TaskState::Waiting,
                State::Ready => TaskState::Ready,
                State::Faulted => TaskState::Faulted,
            },
            number: place.number,
            jobs: figures.jobs,
            misses: figures.misses,
            overruns: figures.overruns,
            skipped: figures.skipped,
            executed_min: figures.executed_min.0,
            executed_max: figures.executed_max.0,
            executed: figures.executed.0,
            response_max: figures.response_max.0,
            start_max: figures.start_max.0,
            slack_min: figures.slack_min.0,
            switches: figures.switches,
        }
    }
}
