//! The kernel's calls, simulated: what a call gives when each job runs to its end before the next begins.
//!
//! Nothing can arrive while a job waits, so a wait for what is not there ends at once with "timed out".

use std::collections::VecDeque;

use takt_program::call::{Call, Error, FRESH};
use takt_program::{Direction, Image, ObjectKind, limit};

use super::caller::{Caller, Who};
use super::memory::Memory;

/// What a call leads to.
pub enum Outcome {
    /// The program goes on with this in `rax`.
    Result(i64),
    /// The job is done.
    End,
    /// The program stops itself, with this code.
    Stop(u64),
}

enum Object {
    Semaphore { ceiling: u8, holder: Option<Who> },
    Queue { bytes: u64, depth: usize, messages: VecDeque<Vec<u8>> },
    Mailbox { bytes: u64, value: Option<Vec<u8>>, seen: Vec<Who> },
    Flags(u32),
}

struct Port {
    direction: Direction,
    bytes: u64,
    /// Written by one side and not read by the other.
    messages: VecDeque<Vec<u8>>,
}

/// Messages that wait at a port. Of what the program writes the oldest are dropped then: most tests read none.
const MESSAGES: usize = 1024;

/// The objects of a program and its log.
pub struct Kernel {
    objects: Vec<Object>,
    ports: Vec<Port>,
    /// Lines that may be logged, and since when.
    lines: (u32, u64),
    /// Lines logged and not taken yet.
    pub log: Vec<String>,
}

impl Kernel {
    pub fn new(image: &Image<'_>) -> Self {
        let object = |kind| match kind {
            ObjectKind::Semaphore { ceiling } => Object::Semaphore { ceiling, holder: None },
            ObjectKind::Queue { message_bytes, depth } => Object::Queue {
                bytes: message_bytes.into(),
                depth: depth as usize,
                messages: VecDeque::new(),
            },
            ObjectKind::Mailbox { bytes } => {
                Object::Mailbox { bytes: bytes.into(), value: None, seen: Vec::new() }
            }
            ObjectKind::Flags => Object::Flags(0),
        };
        let port = |port: takt_program::Port<'_>| Port {
            direction: port.direction,
            bytes: port.message_bytes.into(),
            messages: VecDeque::new(),
        };
        Self {
            objects: image.objects().map(|found| object(found.kind)).collect(),
            ports: image.ports().map(port).collect(),
            lines: (limit::LOG_LINES, 0),
            log: Vec::new(),
        }
    }

    /// Carries out the call `number` with the arguments from `rdi`, `rsi`, `rdx` and `r10`.
    pub fn call(
        &mut self,
        memory: &Memory,
        caller: &Caller,
        number: u64,
        arguments: [u64; 4],
    ) -> Outcome {
        let call = u32::try_from(number).ok().and_then(Call::from_code);
        let result = match call {
            None => Err(Error::BadNumber),
            Some(Call::End) => return Outcome::End,
            Some(Call::Stop) => return Outcome::Stop(arguments[0]),
            Some(Call::Time) => Ok(caller.now.cast_signed()),
            Some(Call::Log) => self.log(memory, caller, arguments),
            Some(Call::ChannelRead | Call::ChannelWrite) => self.channel(memory, call, arguments),
            Some(call) => self.object(memory, caller, call, arguments),
        };
        Outcome::Result(result.unwrap_or_else(Error::result))
    }

    /// Gives back what a job did not.
    pub fn job_ended(&mut self, caller: &Caller) {
        for object in &mut self.objects {
            if let Object::Semaphore { holder, .. } = object
                && *holder == Some(caller.who)
            {
                *holder = None;
            }
        }
    }

    fn log(
        &mut self,
        memory: &Memory,
        caller: &Caller,
        [at, bytes, ..]: [u64; 4],
    ) -> Result<i64, Error> {
        if bytes > limit::LOG_BYTES.into() {
            return Err(Error::TooLong);
        }
        let mut text = memory.get(at, bytes).ok_or(Error::BadPointer)?;
        text.iter_mut().filter(|byte| byte.is_ascii_control()).for_each(|byte| *byte = b' ');
        let (left, since) = self.lines;
        let more = caller.now.saturating_sub(since) / limit::LOG_STEP_NS;
        let left = left.saturating_add(u32::try_from(more).unwrap_or(u32::MAX));
        let left = left.min(limit::LOG_LINES).checked_sub(1).ok_or(Error::Full)?;
        self.lines = (left, since + more * limit::LOG_STEP_NS);
        self.log.push(String::from_utf8(text).unwrap_or_else(|_| "(not UTF-8)".to_owned()));
        Ok(0)
    }

    /// A call of the program. The other partition is the test: what it has given is read, each message once.
    fn channel(
        &mut self,
        memory: &Memory,
        call: Option<Call>,
        arguments: [u64; 4],
    ) -> Result<i64, Error> {
        match call {
            Some(Call::ChannelWrite) => {
                let port = self.write(memory, Direction::Out, arguments)?;
                if port.messages.len() > MESSAGES {
                    port.messages.pop_front();
                }
                Ok(0)
            }
            _ => self.read(memory, Direction::In, arguments),
        }
    }

    /// A message that the program has written, for the test: as its call to read one.
    pub fn take(&mut self, memory: &Memory, arguments: [u64; 4]) -> i64 {
        self.read(memory, Direction::Out, arguments).unwrap_or_else(Error::result)
    }

    /// A message of the test for the program: as its call to write one.
    pub fn give(&mut self, memory: &Memory, arguments: [u64; 4]) -> i64 {
        let full = self.waiting(arguments[0] as usize) >= MESSAGES;
        let given = match full {
            true => Err(Error::Full),
            false => self.write(memory, Direction::In, arguments).map(|_| 0),
        };
        given.unwrap_or_else(Error::result)
    }

    /// How many messages wait at a port.
    pub fn waiting(&self, port: usize) -> usize {
        self.ports.get(port).map_or(0, |port| port.messages.len())
    }

    fn port(&mut self, id: u64, direction: Direction) -> Result<&mut Port, Error> {
        let port = usize::try_from(id).ok().and_then(|id| self.ports.get_mut(id));
        port.filter(|port| port.direction == direction).ok_or(Error::BadId)
    }

    fn read(
        &mut self,
        memory: &Memory,
        direction: Direction,
        [id, at, bytes, _]: [u64; 4],
    ) -> Result<i64, Error> {
        let port = self.port(id, direction)?;
        if !memory.allows(at, bytes, true) {
            return Err(Error::BadPointer);
        }
        let message = port.messages.front().ok_or(Error::Empty)?;
        if message.len() as u64 > bytes {
            return Err(Error::TooLong);
        }
        memory.put(at, message);
        let length = message.len() as i64;
        port.messages.pop_front();
        Ok(length)
    }

    fn write(
        &mut self,
        memory: &Memory,
        direction: Direction,
        [id, at, bytes, _]: [u64; 4],
    ) -> Result<&mut Port, Error> {
        let port = self.port(id, direction)?;
        if !memory.allows(at, bytes, false) {
            return Err(Error::BadPointer);
        }
        if bytes > port.bytes {
            return Err(Error::TooLong);
        }
        port.messages.push_back(memory.get(at, bytes).ok_or(Error::BadPointer)?);
        Ok(port)
    }

    fn object(
        &mut self,
        memory: &Memory,
        caller: &Caller,
        call: Call,
        [id, a, b, c]: [u64; 4],
    ) -> Result<i64, Error> {
        let of_caller = |object: &Object| matches!(object, Object::Semaphore { holder, .. } if *holder == Some(caller.who));
        let holds = self.objects.iter().any(of_caller);
        let object = usize::try_from(id).ok().and_then(|id| self.objects.get_mut(id));
        match (call, object.ok_or(Error::BadId)?) {
            (Call::SemaphoreTake, Object::Semaphore { .. }) if caller.is_endless => {
                Err(Error::NotAllowed)
            }
            (Call::SemaphoreTake, Object::Semaphore { ceiling, holder }) => {
                if holder.is_some() || caller.urgency < *ceiling {
                    return Err(Error::Ceiling);
                }
                *holder = Some(caller.who);
                Ok(0)
            }
            (Call::SemaphoreGive, Object::Semaphore { holder, .. }) => {
                let held = *holder == Some(caller.who);
                if held {
                    *holder = None
                }
                held.then_some(0).ok_or(Error::NotAllowed)
            }
            (Call::QueueSend, Object::Queue { bytes, depth, messages }) => {
                let message = message(memory, a, b, *bytes)?;
                if messages.len() == *depth {
                    return Err(Error::Full);
                }
                messages.push_back(message);
                Ok(0)
            }
            (Call::QueueReceive, Object::Queue { bytes, messages, .. }) => {
                let room = buffer(memory, a, b, *bytes)?;
                let message = messages.pop_front().ok_or_else(|| waits(c, holds))?;
                Ok(deliver(memory, room, &message))
            }
            (Call::MailboxWrite, Object::Mailbox { bytes, value, seen }) => {
                *value = Some(message(memory, a, b, *bytes)?);
                seen.clear();
                Ok(0)
            }
            (Call::MailboxRead, Object::Mailbox { bytes, value, seen }) => {
                let room = buffer(memory, a, b, *bytes)?;
                let length = deliver(memory, room, value.as_ref().ok_or(Error::Empty)?);
                let fresh = !seen.contains(&caller.who);
                if fresh {
                    seen.push(caller.who);
                }
                Ok(length | if fresh { FRESH } else { 0 })
            }
            (Call::FlagsSet, Object::Flags(flags)) => {
                *flags |= mask(a)?;
                Ok(0)
            }
            (Call::FlagsClear, Object::Flags(flags)) => {
                *flags &= !mask(a)?;
                Ok(0)
            }
            (Call::FlagsWait, Object::Flags(flags)) => {
                let mask = mask(a)?;
                let found = *flags & mask;
                let enough = match b {
                    _ if mask == 0 => return Err(Error::NotAllowed),
                    0 => found != 0,
                    1 => found == mask,
                    _ => return Err(Error::NotAllowed),
                };
                enough.then_some(found.into()).ok_or_else(|| waits(c, holds))
            }
            _ => Err(Error::BadId),
        }
    }
}

fn message(memory: &Memory, at: u64, bytes: u64, limit: u64) -> Result<Vec<u8>, Error> {
    if bytes > limit {
        return Err(Error::TooLong);
    }
    memory.get(at, bytes).ok_or(Error::BadPointer)
}

/// Where a buffer with room for the longest message is.
fn buffer(memory: &Memory, at: u64, room: u64, longest: u64) -> Result<u64, Error> {
    if room < longest {
        return Err(Error::TooLong);
    }
    memory.allows(at, room, true).then_some(at).ok_or(Error::BadPointer)
}

fn deliver(memory: &Memory, at: u64, message: &[u8]) -> i64 {
    memory.put(at, message);
    (message.len() as u64).cast_signed()
}

fn mask(flags: u64) -> Result<u32, Error> {
    u32::try_from(flags).map_err(|_| Error::NotAllowed)
}

/// What a wait ends with, which nothing ends earlier.
fn waits(timeout: u64, holds_semaphore: bool) -> Error {
    match timeout {
        0 => Error::Empty,
        1..=limit::WAIT_NS if holds_semaphore => Error::Ceiling,
        1..=limit::WAIT_NS => Error::TimedOut,
        _ => Error::NotAllowed,
    }
}
