//! What the kernel answers: claims of a guest, all of them.

use super::bytes::{Reader, Writer};
use super::change::ChangeRecord;
use super::{Buffer, MESSAGE_BYTES};
use crate::program::{PROGRAMS_MAX, TASKS_MAX};

const REPLY: u16 = 1;
const PROGRAMS: u16 = 2;
const TASKS: u16 = 3;
const CHANGE: u16 = 17;

/// Most tasks of one answer.
pub const TASKS_EACH: usize = 8;
const _: () = assert!(TASKS_MAX.is_multiple_of(TASKS_EACH));

/// An answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(clippy::large_enum_variant, reason = "a kernel has no heap for the large ones")]
pub enum Answer {
    /// The order was carried out, or refused.
    Reply(Result<(), Refusal>),
    /// How the programs stand.
    Programs {
        /// In the order of the program table.
        programs: [ProgramRecord; PROGRAMS_MAX],
        /// How many of them there are.
        count: u8,
        /// How many tasks all of them have, initialisations included.
        tasks: u8,
        /// Values that are forced.
        forced: u16,
        /// Answers that the guest could not send, because Takt had not taken those before.
        dropped: u64,
    },
    /// How some tasks stand.
    Tasks {
        /// Place of the first in the kernel's order.
        first: u8,
        /// How many of `tasks` there are.
        count: u8,
        /// The tasks.
        tasks: [TaskRecord; TASKS_EACH],
    },
    /// How the change of a program stands.
    Change(ChangeRecord),
}

/// Why an order was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Refusal {
    /// It is none that this kernel knows.
    Unknown = 1,
    /// There is no such program.
    NoProgram = 2,
    /// The program has no such place, or none that can be written.
    NoPlace = 3,
    /// There is no room for one more.
    Full = 4,
    /// The point is not forced.
    NotForced = 5,
    /// Another change is under way, or there is none to go on with.
    NotNow = 16,
    /// Values of the program are forced: in another version their places can be those of other values.
    Forced = 17,
    /// The program changes to another version, or has one on trial: its places do not hold.
    Changing = 18,
}

impl Refusal {
    const ALL: [Self; 8] = [
        Self::Unknown,
        Self::NoProgram,
        Self::NoPlace,
        Self::Full,
        Self::NotForced,
        Self::NotNow,
        Self::Forced,
        Self::Changing,
    ];
}

/// What a program does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum ProgramState {
    /// It does not run.
    #[default]
    Stopped = 0,
    /// Its initialisation runs, or its state is being set up.
    Starting = 1,
    /// Its tasks are released.
    Running = 2,
    /// An error has stopped it.
    Faulted = 3,
}

/// How a program stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ProgramRecord {
    /// What it does.
    pub state: ProgramState,
    /// SHA-256 of its image.
    pub hash: [u8; 32],
}

/// What a task does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum TaskState {
    /// Its program does not run, or has not begun.
    #[default]
    Dormant = 0,
    /// It waits for a release, or in a call.
    Waiting = 1,
    /// It has work to do.
    Ready = 2,
    /// It has stopped its program by an error.
    Faulted = 3,
}

/// How a task stands. Spans are nanoseconds; a smallest span is `u64::MAX` before the first measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TaskRecord {
    /// Place of its program in the program table.
    pub program: u8,
    /// What it does.
    pub state: TaskState,
    /// Its number in the image; `None` is the initialisation.
    pub number: Option<u16>,
    /// Complete jobs.
    pub jobs: u64,
    /// Jobs that were not complete at their deadline.
    pub misses: u64,
    /// Releases that were lost.
    pub overruns: u64,
    /// Jobs that the kernel has ended.
    pub skipped: u64,
    /// Shortest execution of a job.
    pub executed_min: u64,
    /// Longest execution of a job.
    pub executed_max: u64,
    /// Execution of all jobs.
    pub executed: u64,
    /// Longest time from a release to the end of its job.
    pub response_max: u64,
    /// Longest time from a release to the start of its job.
    pub start_max: u64,
    /// Shortest time from a job's end to its deadline.
    pub slack_min: u64,
    /// Times that the processor was given to it.
    pub switches: u64,
}

const NO_NUMBER: u16 = u16::MAX;

impl Answer {
    /// Writes it, with the number of its order.
    #[must_use]
    pub fn encode<'b>(&self, number: u32, buffer: &'b mut Buffer) -> Option<&'b [u8]> {
        let mut to = Writer::new(buffer);
        let kind = match self {
            Answer::Reply(_) => REPLY,
            Answer::Programs { .. } => PROGRAMS,
            Answer::Tasks { .. } => TASKS,
            Answer::Change(_) => CHANGE,
        };
        to.u16(kind);
        to.u16(0);
        to.u32(number);
        match self {
            Answer::Reply(result) => to.u16(result.map_or_else(|refusal| refusal as u16, |()| 0)),
            Answer::Programs { programs, count, tasks, forced, dropped } => {
                to.u8(*count);
                to.u8(*tasks);
                to.u16(*forced);
                to.u64(*dropped);
                for program in programs.iter().take(usize::from(*count)) {
                    to.u8(program.state as u8);
                    to.bytes(&program.hash);
                }
            }
            Answer::Tasks { first, count, tasks } => {
                to.u8(*first);
                to.u8(*count);
                tasks.iter().take(usize::from(*count)).for_each(|task| task.write(&mut to));
            }
            Answer::Change(record) => record.write(&mut to),
        }
        to.end()
    }
}

/// Reads an answer and its number; `None` if the message is no answer.
#[must_use]
pub fn decode_answer(message: &[u8]) -> Option<(u32, Answer)> {
    let mut from = Reader(message.get(..message.len().min(MESSAGE_BYTES + 1))?);
    let (kind, zero, number) = (from.u16()?, from.u16()?, from.u32()?);
    if zero != 0 {
        return None;
    }
    let answer = match kind {
        REPLY => match from.u16()? {
            0 => Answer::Reply(Ok(())),
            code => {
                let refusal = Refusal::ALL.into_iter().find(|refusal| *refusal as u16 == code)?;
                Answer::Reply(Err(refusal))
            }
        },
        PROGRAMS => {
            let (count, tasks, forced) = (from.u8()?, from.u8()?, from.u16()?);
            let dropped = from.u64()?;
            let mut programs = [ProgramRecord::default(); PROGRAMS_MAX];
            for program in programs.get_mut(..usize::from(count))? {
                program.state = program_state(from.u8()?)?;
                program.hash = from.array()?;
            }
            Answer::Programs { programs, count, tasks, forced, dropped }
        }
        TASKS => {
            let (first, count) = (from.u8()?, from.u8()?);
            let mut tasks = [TaskRecord::default(); TASKS_EACH];
            for task in tasks.get_mut(..usize::from(count))? {
                *task = TaskRecord::read(&mut from)?;
            }
            Answer::Tasks { first, count, tasks }
        }
        CHANGE => Answer::Change(ChangeRecord::read(&mut from)?),
        _ => return None,
    };
    from.end((number, answer))
}

fn program_state(code: u8) -> Option<ProgramState> {
    use ProgramState as S;
    [S::Stopped, S::Starting, S::Running, S::Faulted].into_iter().find(|state| *state as u8 == code)
}

fn task_state(code: u8) -> Option<TaskState> {
    use TaskState as S;
    [S::Dormant, S::Waiting, S::Ready, S::Faulted].into_iter().find(|state| *state as u8 == code)
}

impl TaskRecord {
    fn write(&self, to: &mut Writer<'_>) {
        to.u8(self.program);
        to.u8(self.state as u8);
        to.u16(self.number.unwrap_or(NO_NUMBER));
        let words = [
            self.jobs,
            self.misses,
            self.overruns,
            self.skipped,
            self.executed_min,
            self.executed_max,
            self.executed,
            self.response_max,
            self.start_max,
            self.slack_min,
            self.switches,
        ];
        words.into_iter().for_each(|word| to.u64(word));
    }

    fn read(from: &mut Reader<'_>) -> Option<Self> {
        Some(Self {
            program: from.u8()?,
            state: task_state(from.u8()?)?,
            number: Some(from.u16()?).filter(|number| *number != NO_NUMBER),
            jobs: from.u64()?,
            misses: from.u64()?,
            overruns: from.u64()?,
            skipped: from.u64()?,
            executed_min: from.u64()?,
            executed_max: from.u64()?,
            executed: from.u64()?,
            response_max: from.u64()?,
            start_max: from.u64()?,
            slack_min: from.u64()?,
            switches: from.u64()?,
        })
    }
}

#[cfg(test)]
#[path = "answer_tests.rs"]
mod tests;
