//! The programs' ports: ends of channels of the partition, by name.
//!
//! A port of a program is the partition's port of the same name. It belongs to the program that comes first in
//! the partition file; for another one, and where kind, direction or size differ, it is closed, which
//! is said at the start, and its calls are refused.

use takt_abi::{direction, port_kind};
use takt_channel::{
    Counters, ReadError, ReceiveError, ReturnCode, Sample, SendError, Ticks, Tsc, Validity,
};
use takt_kernel::process_image::Newest;
use takt_kernel::time::Clock;
use takt_plc_guest::channel::{self, Input, Output, Receiver, Sender};
use takt_plc_guest::console::print;
use takt_program::call::Error;
use takt_program::{Direction, Port, limit};

/// Most ports of a partition.
pub const PORTS: usize = takt_abi::PORTS_MAX;
/// Whose ports are those that the partition file maps to inputs and outputs. They belong to no program.
const OF_IO: u8 = u8::MAX;

/// An open port.
#[derive(Debug)]
enum End {
    Output(Output),
    /// Of which outputs are written, with the length of its messages.
    Mapped(Output, usize),
    Sender(Sender),
    Input(Input),
    /// With the length of its longest message.
    Receiver(Receiver, usize),
}

/// What a port has for a task that waits at it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum News {
    None,
    /// A sample, which is told once.
    Came,
    /// A message of a queue, which may have been told before.
    Waiting,
}

/// A port that is open.
#[derive(Debug)]
struct Open {
    program: u8,
    /// As the program knows it.
    number: u8,
    /// In the host's table.
    place: u8,
    end: End,
}

/// The open ports of all programs.
#[derive(Debug)]
pub struct Ports {
    ends: [Option<Open>; PORTS],
    /// Of which losses were printed last.
    told: usize,
    buffer: [u8; limit::MESSAGE_BYTES as usize],
}

impl Ports {
    /// None is open.
    pub const CLOSED: Self =
        Self { ends: [const { None }; PORTS], told: 0, buffer: [0; limit::MESSAGE_BYTES as usize] };

    /// Opens a port of a program, by its number there.
    pub fn open(&mut self, program: u8, number: u8, port: &Port<'_>) -> Result<(), ReturnCode> {
        let slot = self.ends.iter_mut().find(|end| end.is_none());
        let slot = slot.ok_or(ReturnCode::InvalidConfig)?;
        let place = channel::ports().iter().position(|p| name_of(p) == port.name);
        let place = place.ok_or(ReturnCode::InvalidConfig)?;
        let (name, bytes) = (port.name, port.message_bytes);
        let end = match (channel::ports()[place].kind, port.direction) {
            (port_kind::SAMPLING, Direction::In) => End::Input(channel::input(name, bytes)?),
            (port_kind::SAMPLING, Direction::Out) => End::Output(channel::output(name, bytes)?),
            (_, Direction::In) => End::Receiver(channel::receiver(name, bytes)?, bytes as usize),
            (_, Direction::Out) => End::Sender(channel::sender(name, bytes)?),
        };
        *slot = Some(Open { program, number, place: place as u8, end });
        Ok(())
    }

    /// Opens a port of the partition for inputs and outputs, by its place in the host's table, if it is not open.
    pub fn open_for_io(&mut self, place: u64) {
        let Some(port) = usize::try_from(place).ok().and_then(|p| channel::ports().get(p)) else {
            return;
        };
        if self.end(OF_IO, place).is_some() {
            return;
        }
        let Some(slot) = self.ends.iter_mut().find(|end| end.is_none()) else { return };
        let name = name_of(port);
        let end = match port.direction {
            direction::SOURCE => channel::output(name, port.maximum)
                .map(|output| End::Mapped(output, port.maximum as usize)),
            _ => channel::input(name, port.maximum).map(End::Input),
        };
        // The host's table is right; a port that cannot be opened has no messages.
        let place = place as u8;
        *slot = end.ok().map(|end| Open { program: OF_IO, number: place, place, end });
    }

    /// The newest message at such a port.
    pub fn newest(&mut self, place: u64, now: u64, clock: &Clock) -> Newest<'_> {
        let Some((End::Input(input), buffer)) = self.end(OF_IO, place) else {
            return Newest::NONE;
        };
        let longest = input.status().maximum;
        match input.read(buffer, Tsc(now)) {
            // One that is not valid and has no age claims to be from the future, and is believed in nothing.
            Ok(Sample { validity: Validity::Invalid, age: Ticks(0), .. }) => Newest::NONE,
            // A message is a structure: a part of it is none.
            Ok(sample) if sample.bytes.len() == longest => Newest {
                message: Some(sample.bytes),
                valid: sample.validity == Validity::Valid,
                age: clock.span(sample.age.0).0,
                count: 0,
            },
            _ => Newest::NONE,
        }
    }

    /// Writes a message of full length, which is filled in from zeros, to such a port.
    pub fn write_for_io(&mut self, place: u64, now: u64, fill: impl FnOnce(&mut [u8])) {
        if let Some((End::Mapped(output, longest), buffer)) = self.end(OF_IO, place)
            && let Some(message) = buffer.get_mut(..*longest)
        {
            message.fill(0);
            fill(message);
            // It is as long as the longest.
            let _ = output.write(message, Tsc(now));
        }
    }

    /// Prints what the next of the open ports has lost that has lost something: a program that reads is not told.
    pub fn print_losses(&mut self) {
        for _ in 0..PORTS {
            self.told = (self.told + 1) % PORTS;
            let Some(open) = &mut self.ends[self.told] else { continue };
            let Counters { lost, hostile, unstable, .. } = match &mut open.end {
                End::Input(input) => input.status().counters,
                End::Receiver(receiver, _) => receiver.status().counters,
                End::Output(_) | End::Mapped(..) | End::Sender(_) => continue,
            };
            if (lost, hostile, unstable) != (0, 0, 0) {
                let port = channel::ports().get(usize::from(open.place)).map_or("?", name_of);
                print(format_args!(
                    "port {port}: lost {lost}, hostile {hostile}, unstable {unstable}"
                ));
                return;
            }
        }
    }

    fn end(&mut self, program: u8, number: u64) -> Option<(&mut End, &mut [u8])> {
        let mut open = self.ends.iter_mut().flatten();
        let found = open.find(|o| (o.program, u64::from(o.number)) == (program, number));
        found.map(|open| (&mut open.end, &mut self.buffer[..]))
    }

    /// Reads a message for which the program has so much room; it is valid until the next call. Its stamp is 0 if it is of
    /// a queue. That is not read where its longest message has no room, since a message that is taken is gone.
    pub fn read(
        &mut self,
        program: u8,
        number: u64,
        room: u64,
        now: u64,
    ) -> Result<(&[u8], u64), Error> {
        let (end, buffer) = self.end(program, number).ok_or(Error::BadId)?;
        match end {
            End::Input(input) => match input.read(buffer, Tsc(now)) {
                Ok(sample) if sample.bytes.len() as u64 > room => Err(Error::TooLong),
                Ok(sample) => Ok((sample.bytes, sample.stamp.0)),
                Err(ReadError::Buffer(_)) => Err(Error::TooLong),
                Err(_) => Err(Error::Empty),
            },
            End::Receiver(_, longest) if *longest as u64 > room => Err(Error::TooLong),
            End::Receiver(receiver, _) => match receiver.receive(buffer) {
                Ok(received) => Ok((received.bytes, 0)),
                Err(ReceiveError::Buffer(_)) => Err(Error::TooLong),
                Err(_) => Err(Error::Empty),
            },
            End::Output(_) | End::Mapped(..) | End::Sender(_) => Err(Error::NotAllowed),
        }
    }

    /// The buffer, for a message that is to be written.
    pub fn buffer(&mut self, bytes: usize) -> Option<&mut [u8]> {
        self.buffer.get_mut(..bytes)
    }

    /// Writes the first bytes of the buffer.
    pub fn write(&mut self, program: u8, number: u64, bytes: usize, now: u64) -> Result<(), Error> {
        let (end, buffer) = self.end(program, number).ok_or(Error::BadId)?;
        let message = buffer.get(..bytes).ok_or(Error::TooLong)?;
        match end {
            End::Output(output) => output.write(message, Tsc(now)).map_err(|_| Error::TooLong),
            End::Sender(sender) => match sender.send(message, Tsc(now)) {
                Ok(()) => Ok(()),
                Err(SendError::Full) => Err(Error::Full),
                Err(SendError::Length(_)) => Err(Error::TooLong),
            },
            End::Mapped(..) | End::Input(..) | End::Receiver(..) => Err(Error::NotAllowed),
        }
    }

    /// What there is at a port that is new. `seen` is the stamp of the newest sample that the task knows which waits for
    /// it: several may wait at one port, and each of them is told of each message.
    pub fn news(&mut self, program: u8, number: u64, seen: &mut u64) -> News {
        let Some((end, _)) = self.end(program, number) else { return News::None };
        match end {
            End::Receiver(receiver, _) => match receiver.status().waiting {
                0 => News::None,
                _ => News::Waiting,
            },
            // Messages are long, and looked for before each job.
            End::Input(input) => match input.newest_stamp() {
                Ok(stamp) if core::mem::replace(seen, stamp.0) != stamp.0 => News::Came,
                _ => News::None,
            },
            End::Output(_) | End::Mapped(..) | End::Sender(_) => News::None,
        }
    }
}

fn name_of(port: &takt_abi::Port) -> &str {
    let end = port.name.iter().position(|byte| *byte == 0).unwrap_or(port.name.len());
    core::str::from_utf8(&port.name[..end]).unwrap_or("?")
}
