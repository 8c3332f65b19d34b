//! Orders from Takt while the PLC runs, the answers, and samples of what is watched.
//!
//! A step is one order or one part of a sample, taken in a window in which no task is ready or will be, with time left
//! for the longest of them: so no release and no job ever waits for an order. If there is no such window, because a job
//! never ends, orders are taken beside it ([`idle`](super::idle)). Orders come from Takt and are checked all
//! the same, as a program's calls are. What cannot be answered because Takt has not taken the answers before is
//! counted.

use super::kernel::Kernel;
use super::memory::Area;
use super::program::Program;
use takt_abi::live::{
    ANSWERS, Answer, Buffer, MESSAGE_BYTES, ORDERS, ORDERS_DEPTH, Order, PAYLOAD_BYTES, Point,
    ProgramRecord, ProgramState, RANGES_EACH_PART, Range, Refusal, STEP_TICKS, SampleHead,
    TASKS_EACH, TaskRecord, TaskState, decode_order,
};
use takt_abi::program::PROGRAMS_MAX;
use takt_channel::Tsc;
use takt_kernel::forces::Forces;
use takt_kernel::scheduler::Phase;
use takt_kernel::task::{ProgramId, State, TaskId, Wait};
use takt_kernel::time::Span;
use takt_kernel::watch::Watch;
use takt_plc_guest::channel::{self, Receiver, Sender};
use takt_plc_guest::cycle;

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
    /// What is looked at.
    pub watch: Watch,
    /// Number of the next part of the sample.
    part: u16,
    /// What an operator keeps.
    pub forces: Forces,
}

impl Live {
    /// Before the start.
    pub const CLOSED: Self = Self {
        ends: None,
        buffer: [0; MESSAGE_BYTES],
        dropped: 0,
        taken: (0, 0),
        watch: Watch::NOTHING,
        part: 0,
        forces: Forces::NONE,
    };

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

    fn send_sample(&mut self, head: &SampleHead, payload: &[u8]) -> bool {
        let Some((_, answers)) = self.ends.as_mut() else { return false };
        // A client that wants more than Takt takes leaves room for the answers to all orders that can wait.
        let queue = answers.status();
        if queue.depth.saturating_sub(queue.waiting) <= ORDERS_DEPTH {
            return false;
        }
        let fill = |to: &mut [u8]| to.copy_from_slice(&payload[..to.len()]);
        let message = head.encode(fill, &mut self.buffer);
        message.is_some_and(|message| answers.send(message, Tsc(cycle::now())).is_ok())
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

    fn obey(&mut self, order: Order) -> Answer {
        let reply = match order {
            Order::Status { part: 0 } => return self.programs_status(),
            Order::Status { part } => {
                return self.tasks_status((usize::from(part) - 1) * TASKS_EACH);
            }
            Order::WatchClear => {
                self.live.watch.clear();
                Ok(())
            }
            Order::WatchAdd(ranges) => ranges
                .iter()
                .try_for_each(|range| self.place(range).and_then(|_| self.live.watch.add(range))),
            Order::WatchBegin { serial, interval_ns } => {
                self.live.watch.begin(serial, Span(interval_ns));
                self.live.part = 0;
                Ok(())
            }
            Order::Write { point, value } => self.place(point.range).and_then(|area| {
                self.is_between_jobs(point.range.program)?;
                self.has_state(point.range.program)?;
                self.put(area, point, value);
                self.change.program_runs(point.range.program);
                self.apply_forces_again(point.range.program);
                Ok(())
            }),
            Order::Force { point, value } => self.place(point.range).and_then(|area| {
                self.is_between_jobs(point.range.program)?;
                self.live.forces.set(point, value)?;
                self.put(area, point, value);
                self.change.program_runs(point.range.program);
                self.apply_forces_again(point.range.program);
                Ok(())
            }),
            Order::Release { point } => self.live.forces.release(point),
            Order::ReleaseAll => {
                self.live.forces.clear();
                Ok(())
            }
            Order::Prepare { program, image_bytes, forward_bytes, back_bytes } => self
                .prepare_change(program, [image_bytes, forward_bytes, back_bytes].map(u64::from)),
            Order::Change { program, step } => return self.go_on_with_change(program, step),
        };
        Answer::Reply(reply)
    }

    /// Beside a job that may never end, a value of its own program would come into the middle of it.
    fn is_between_jobs(&self, program: u8) -> Result<(), Refusal> {
        let beside = self.scheduler.running().is_some();
        match beside && !self.scheduler.is_between_jobs(ProgramId(program)) {
            true => Err(Refusal::NotNow),
            false => Ok(()),
        }
    }

    /// A value that is written while the state is set up would be gone when it is. A forced one comes again with each job.
    fn has_state(&self, program: u8) -> Result<(), Refusal> {
        let found = self.programs.get(usize::from(program)).and_then(Option::as_ref);
        match found.is_some_and(Program::is_loading) {
            true => Err(Refusal::NotNow),
            false => Ok(()),
        }
    }

    /// Some bytes of a program, if it has them.
    fn area(&self, range: Range) -> Result<Area, Refusal> {
        let program = self.programs.get(usize::from(range.program)).and_then(Option::as_ref);
        let area = program.ok_or(Refusal::NoProgram)?.live_area(range.area);
        area.part(range.offset.into(), range.bytes.into()).ok_or(Refusal::NoPlace)
    }

    /// The same for an order, which has to mean the version that runs: none is taken of a program that changes.
    fn place(&self, range: Range) -> Result<Area, Refusal> {
        if self.change.is_unsettled(range.program) {
            return Err(Refusal::Changing);
        }
        self.area(range)
    }

    /// After a write between jobs, which may lie over a forced value: if all of them were in their places they are so again,
    /// and the next job need not put them there in the guard before its release. A job that waits in a call keeps what it has written.
    fn apply_forces_again(&self, program: u8) {
        if self.live.forces.is_settled(program) {
            self.apply_forces(program);
        }
    }

    /// Puts the forced values of a program into their places.
    #[inline(never)]
    pub fn apply_forces(&self, program: u8) {
        self.put_forced(self.live.forces.of(program));
    }

    /// Puts some of them there.
    pub fn put_forced(&self, forced: impl Iterator<Item = (Point, u64)>) {
        for (point, value) in forced {
            if let Ok(area) = self.area(point.range) {
                self.put(area, point, value);
            }
        }
    }

    /// Writes a value to its place.
    fn put(&self, area: Area, point: Point, value: u64) {
        let Range { program, area: kind, offset, bytes, .. } = point.range;
        let program = self.programs.get(usize::from(program)).and_then(Option::as_ref);
        if let (takt_abi::live::Area::State, Some(program)) = (kind, program) {
            program.state_is_written(offset.into(), bytes.into());
        }
        put(area, point, value);
    }

    /// Takes one part of a sample of what is watched, if one is due, and time for it. True if there was.
    pub fn take_sample(&mut self, release: u64, release_tsc: u64, end_tsc: u64) -> bool {
        // Intervals are those between releases: how long after its release a sample is made varies.
        let at = self.clock.instant(release_tsc);
        if end_tsc.saturating_sub(cycle::now()) < STEP_TICKS || !self.live.watch.is_due(release, at)
        {
            return false;
        }
        if self.live.watch.is_at_start() {
            self.live.part = 0;
        }
        let mut payload = [0; PAYLOAD_BYTES];
        let mut filled = 0;
        for _ in 0..RANGES_EACH_PART {
            let room = (PAYLOAD_BYTES - filled) as u16;
            let Some(piece) = self.live.watch.piece(room) else { break };
            let end = filled + usize::from(piece.bytes);
            if let (Ok(area), Some(place)) = (self.area(piece), payload.get_mut(filled..end)) {
                area.read(place);
            }
            filled = end;
        }
        let head = SampleHead {
            serial: self.live.watch.serial(),
            cycle: release,
            release_tsc,
            time_ns: self.clock.instant(release_tsc).0,
            missed: self.live.watch.missed(),
            part: self.live.part,
            last: self.live.watch.is_whole(),
            unsettled: self.unsettled(),
            bytes: filled as u16,
        };
        if !self.live.send_sample(&head, &payload) {
            self.live.watch.give_up_for_now();
        } else if head.last {
            self.live.watch.sent(at);
        } else {
            self.live.part += 1;
        }
        true
    }

    /// Programs that are in the middle of something, or have been left there, a bit for each.
    fn unsettled(&self) -> u16 {
        let loading = self.programs.iter().flatten().filter(|program| program.is_loading());
        let loading = loading.fold(0, |all, program| all | 1 << program.id.0);
        self.scheduler.ids().map(|id| self.scheduler.task(id)).fold(loading, |all, task| match task
            .state()
        {
            State::Waiting(Wait::Release) | State::Dormant if !task.was_cut() => all,
            _ => all | 1 << task.settings().program.0,
        })
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
        let (forced, dropped) = (self.live.forces.count(), self.live.dropped);
        Answer::Programs { programs, count, tasks, forced, dropped }
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
            executed: task.executed().0,
            response_max: figures.response_max.0,
            start_max: figures.start_max.0,
            slack_min: figures.slack_min.0,
            switches: figures.switches,
        }
    }
}

/// Writes a value to its place.
fn put(area: Area, point: Point, value: u64) {
    let bytes = value.to_le_bytes();
    match point.bit {
        None => area.write(&bytes),
        Some(bit) => {
            let mut byte = [0];
            area.read(&mut byte);
            let mask = 1 << (bit & 7);
            byte[0] = if value & 1 == 0 { byte[0] & !mask } else { byte[0] | mask };
            area.write(&byte);
        }
    }
}
