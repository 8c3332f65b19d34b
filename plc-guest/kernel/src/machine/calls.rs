//! What programs ask for.
//!
//! Numbers, pointers and lengths come from a program and may be anything. A pointer is looked up in the
//! areas of that program, with the right that the call needs, before a byte is touched, and memory is then reached
//! by its physical address: no call can make the kernel fault. Every call takes a bounded time: the largest
//! copy is one message.

use super::context::Context;
use super::kernel::Kernel;
use super::memory::Area;
use takt_abi::live::ChangeReason;
use takt_abi::program as table;
use takt_kernel::objects::{ObjectId, Received, Seen, Sent};
use takt_kernel::task::{ProgramId, TaskId};
use takt_kernel::time::Span;
use takt_plc_guest::console::{Line, print};
use takt_plc_guest::cycle;
use takt_program::ObjectKind;
use takt_program::call::{Call, Error, FRESH};
use takt_program::limit;

/// Before each message in memory: its length.
const HEADER: u64 = 16;

/// The arguments of a call.
struct Arguments {
    /// The calling task, whose memory pointers name.
    task: TaskId,
    first: u64,
    second: u64,
    third: u64,
    fourth: u64,
}

impl Arguments {
    const fn of(task: TaskId, context: &Context) -> Self {
        Self {
            task,
            first: context.registers.rdi,
            second: context.registers.rsi,
            third: context.registers.rdx,
            fourth: context.registers.r10,
        }
    }
}

/// The result of a call that is over; none while its task waits, or if it makes the call again.
type Answer = Result<Option<i64>, Error>;
const DONE: Answer = Ok(Some(0));

impl Kernel {
    /// The running task has made a call.
    #[inline(always)]
    pub fn call(&mut self, task: TaskId) {
        let registers = &self.contexts[task.index()].registers;
        let (number, first, second) = (registers.rax, registers.rdi, registers.rsi);
        let call = u32::try_from(number).ok().and_then(Call::from_code);
        let answer = match call {
            None => Err(Error::BadNumber),
            Some(Call::Stop) => return self.stop(task, first),
            Some(Call::SemaphoreTake | Call::SemaphoreGive | Call::FlagsSet | Call::FlagsClear) => {
                self.short_call(task, call, first, second)
            }
            Some(call) => {
                let answer = self.answer(task, call);
                self.charge_work(task, self.stamp, self.entered);
                answer
            }
        };
        let result = match answer {
            Ok(None) => return,
            Ok(Some(result)) => result,
            Err(error) => error.result(),
        };
        self.contexts[task.index()].registers.rax = result as u64;
    }

    /// A call on an object that never waits and copies nothing.
    #[inline(always)]
    fn short_call(&mut self, task: TaskId, call: Option<Call>, first: u64, second: u64) -> Answer {
        let program = ProgramId(self.places[task.index()].program);
        let id = self.scheduler.object_of(program, first)?;
        let mask = u32::try_from(second).map_err(|_| Error::NotAllowed);
        match call {
            Some(Call::SemaphoreTake) => self.scheduler.take(id)?,
            Some(Call::SemaphoreGive) => self.scheduler.give(id)?,
            Some(Call::FlagsSet) => self.scheduler.set_flags(id, mask?)?,
            _ => self.scheduler.clear_flags(id, mask?)?,
        }
        DONE
    }

    #[inline(never)]
    fn answer(&mut self, task: TaskId, call: Call) -> Answer {
        let a = &Arguments::of(task, &self.contexts[task.index()]);
        let program = ProgramId(self.places[task.index()].program);
        match call {
            // These are no calls that come here.
            Call::End
            | Call::Stop
            | Call::SemaphoreTake
            | Call::SemaphoreGive
            | Call::FlagsSet
            | Call::FlagsClear => return Err(Error::BadNumber),
            Call::Time => return Ok(Some(self.now().0 as i64)),
            Call::Log => return self.log(program, task, a.first, a.second),
            Call::ChannelRead => return self.channel_read(program, a),
            Call::ChannelWrite => return self.channel_write(program, a),
            Call::QueueSend => self.queue_send(program, self.object(program, a)?, a)?,
            Call::QueueReceive => return self.queue_receive(program, self.object(program, a)?, a),
            Call::MailboxWrite => self.mailbox_write(program, self.object(program, a)?, a)?,
            Call::MailboxRead => return self.mailbox_read(program, self.object(program, a)?, a),
            Call::FlagsWait => {
                let object = self.object(program, a)?;
                let all = match a.third {
                    0 => false,
                    1 => true,
                    _ => return Err(Error::NotAllowed),
                };
                let timeout = Span(a.fourth);
                let now = self.entered();
                let mask = u32::try_from(a.second).map_err(|_| Error::NotAllowed)?;
                return match self.scheduler.wait_flags(object, mask, all, now, timeout)? {
                    Seen::Flags(flags) => Ok(Some(i64::from(flags))),
                    Seen::Waits => Ok(None),
                };
            }
        }
        DONE
    }

    /// The object that a call names first.
    #[inline]
    fn object(&self, program: ProgramId, a: &Arguments) -> Result<ObjectId, Error> {
        self.scheduler.object_of(program, a.first)
    }

    #[inline(never)]
    fn queue_send(&mut self, program: ProgramId, id: ObjectId, a: &Arguments) -> Result<(), Error> {
        let ObjectKind::Queue { message_bytes, .. } = self.kind(program, a.first)? else {
            return Err(Error::BadId);
        };
        let message = self.message(a.task, a.second, a.third, message_bytes)?;
        match self.scheduler.send(id)? {
            Sent::Slot(slot) => self.slot(program, a.first, message_bytes, slot).put(message),
            Sent::To(receiver) => {
                // The receiver's buffer was looked at when it began to wait, and is large enough.
                let context = &mut self.contexts[receiver.index()];
                let buffer = context.registers.rsi;
                context.registers.rax = message.bytes();
                let to = self.memory(receiver, buffer, message.bytes(), true)?;
                to.copy_from(message);
            }
        }
        Ok(())
    }

    #[inline(never)]
    fn queue_receive(&mut self, program: ProgramId, id: ObjectId, a: &Arguments) -> Answer {
        let ObjectKind::Queue { message_bytes, .. } = self.kind(program, a.first)? else {
            return Err(Error::BadId);
        };
        let buffer = self.buffer(a.task, a.second, a.third, message_bytes)?;
        match self.scheduler.receive(id, self.entered(), Span(a.fourth))? {
            Received::Slot(slot) => {
                let length = self.slot(program, a.first, message_bytes, slot).get(buffer);
                Ok(Some(length))
            }
            Received::Waits => Ok(None),
        }
    }

    #[inline(never)]
    fn mailbox_write(
        &mut self,
        program: ProgramId,
        id: ObjectId,
        a: &Arguments,
    ) -> Result<(), Error> {
        let ObjectKind::Mailbox { bytes } = self.kind(program, a.first)? else {
            return Err(Error::BadId);
        };
        let message = self.message(a.task, a.second, a.third, bytes)?;
        self.scheduler.write(id)?;
        self.slot(program, a.first, bytes, 0).put(message);
        Ok(())
    }

    #[inline(never)]
    fn mailbox_read(&mut self, program: ProgramId, id: ObjectId, a: &Arguments) -> Answer {
        let ObjectKind::Mailbox { bytes } = self.kind(program, a.first)? else {
            return Err(Error::BadId);
        };
        let buffer = self.buffer(a.task, a.second, a.third, bytes)?;
        let fresh = self.scheduler.read(id)?;
        let length = self.slot(program, a.first, bytes, 0).get(buffer);
        Ok(Some(if fresh { length | FRESH } else { length }))
    }

    #[inline(never)]
    fn channel_read(&mut self, program: ProgramId, a: &Arguments) -> Answer {
        let to = self.memory(a.task, a.second, a.third, true)?;
        let read = self.ports.read(program.0, a.first, to.bytes(), cycle::now())?;
        let (message, stamp) = read;
        to.write(message);
        self.events.has_read(a.task, a.first, stamp);
        Ok(Some(message.len() as i64))
    }

    #[inline(never)]
    fn channel_write(&mut self, program: ProgramId, a: &Arguments) -> Answer {
        let from = self.message(a.task, a.second, a.third, limit::MESSAGE_BYTES)?;
        let bytes = from.bytes() as usize;
        from.read(self.ports.buffer(bytes).ok_or(Error::TooLong)?);
        self.ports.write(program.0, a.first, bytes, cycle::now())?;
        DONE
    }

    #[inline(never)]
    fn log(&mut self, program: ProgramId, task: TaskId, pointer: u64, bytes: u64) -> Answer {
        let from = self.message(task, pointer, bytes, limit::LOG_BYTES)?;
        let mut buffer = [0; limit::LOG_BYTES as usize];
        from.read(&mut buffer);
        blank_controls(&mut buffer);
        let now = self.now();
        let number = self.places[task.index()].number;
        let text = core::str::from_utf8(&buffer[..bytes as usize]).unwrap_or("(not UTF-8)");
        let Some(program) = &mut self.programs[program.index()] else {
            return Err(Error::NotAllowed);
        };
        let Some(mut dropped) = program.lines.take(now) else { return Err(Error::Full) };
        let line =
            Line::new(format_args!("{}.{}: {text}", program.name(), program.task_name(number)));
        if dropped > 0 {
            let untold =
                Line::new(format_args!("{}: {dropped} lines were too many", program.name()));
            if !self.window.is_over() {
                untold.print();
                dropped = 0;
            }
        }
        // As for the line of STOP.
        if self.window.is_over() {
            program.lines.give_back(dropped);
            self.contexts[task.index()].repeat_call();
            return Ok(None);
        }
        line.print();
        DONE
    }

    /// The program stops itself.
    #[inline(never)]
    fn stop(&mut self, task: TaskId, code: u64) {
        // An exit for a line would come before the release of the window that has begun.
        if self.window.is_over() {
            return self.contexts[task.index()].repeat_call();
        }
        let place = self.places[task.index()];
        if let Some(program) = &self.programs[usize::from(place.program)] {
            print(format_args!(
                "program {}, task {}: stops itself, code {code}",
                program.name(),
                program.task_name(place.number)
            ));
        }
        if self.trial_fails(task, ChangeReason::Fault) {
            return;
        }
        self.change.forget(place.program);
        self.scheduler.stop(ProgramId(place.program));
        self.stop_outputs(place.program);
    }

    fn kind(&self, program: ProgramId, number: u64) -> Result<ObjectKind, Error> {
        let program = self.programs[program.index()].as_ref().ok_or(Error::BadId)?;
        let object = program.image.objects().nth(number as usize).ok_or(Error::BadId)?;
        Ok(object.kind)
    }

    fn memory(&self, task: TaskId, at: u64, bytes: u64, write: bool) -> Result<Area, Error> {
        let place = self.places[task.index()];
        let program = self.programs[usize::from(place.program)].as_ref();
        let area = program.and_then(|program| program.memory(place.number, at, bytes, write));
        area.ok_or(Error::BadPointer)
    }

    /// A message of the program's, with at most so many bytes.
    fn message(&self, task: TaskId, at: u64, bytes: u64, most: u32) -> Result<Area, Error> {
        if bytes > u64::from(most) {
            return Err(Error::TooLong);
        }
        self.memory(task, at, bytes, false)
    }

    /// A buffer of the program's, with room for the longest message.
    fn buffer(&self, task: TaskId, at: u64, bytes: u64, most: u32) -> Result<Area, Error> {
        if bytes < u64::from(most) {
            return Err(Error::TooLong);
        }
        self.memory(task, at, bytes, true)
    }

    /// Where an object keeps a message.
    fn slot(&self, program: ProgramId, number: u64, message_bytes: u32, slot: u32) -> Slot {
        let area = self.programs[program.index()].as_ref().and_then(|p| {
            let each = table::queue_bytes(message_bytes, 0);
            p.messages.get(number as usize)?.part(u64::from(slot) * each, each)
        });
        Slot(area.unwrap_or(Area::NONE))
    }
}

/// A message in memory, behind its length.
struct Slot(Area);

impl Slot {
    fn put(&self, message: Area) {
        self.0.set_word(0, message.bytes());
        if let Some(to) = self.0.part(HEADER, message.bytes()) {
            to.copy_from(message);
        }
    }

    /// Copies the message; returns its length.
    fn get(&self, buffer: Area) -> i64 {
        let bytes = self.0.word(0);
        if let Some(from) = self.0.part(HEADER, bytes) {
            buffer.copy_from(from);
        }
        bytes as i64
    }
}

/// Blanks the control characters of a line: a line feed would begin another one that seems to be the kernel's or another
/// program's. U+0080 to U+009F, which have the lead byte 0xc2 in UTF-8, are such characters too (ECMA-48, section 5.3).
fn blank_controls(text: &mut [u8]) {
    let mut lead: Option<&mut u8> = None;
    for byte in text {
        match lead.take() {
            Some(lead) if (0x80..0xa0).contains(byte) => (*lead, *byte) = (b' ', b' '),
            _ if byte.is_ascii_control() => *byte = b' ',
            _ => lead = (*byte == 0xc2).then_some(byte),
        }
    }
}
