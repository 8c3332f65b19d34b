//! What the partition file maps to inputs and outputs: channels, registers, other programs, simulated values.
//!
//! Every read and write is one pass over the mappings of one program. There are at most 255, a message has at most 4
//! KiB, and a register that is an I/O port costs an exit, once for all of its bits.

use super::PROGRAMS;
use super::memory::Area;
use super::ports::Ports;
use super::process::Process;
use super::program::Program;
use core::ops::Range;
use takt_abi::io::{EVENT, IoTable, Mapping, OUTPUT, flag, kind};
use takt_abi::memory::IO_TABLE;
use takt_abi::{MAGIC, VERSION};
use takt_kernel::process_image::{
    WORD, clear, is_read_by, is_written_by, places, put, read, read_channel, simulated, write,
};
use takt_kernel::time::{Clock, Instant};
use takt_plc_guest::mmio::Register;
use takt_plc_guest::{cycle, io};

/// The mappings of all programs.
#[derive(Debug)]
pub struct Io {
    all: &'static [Mapping],
    /// Which of them belong to each program.
    of: [Range<u8>; PROGRAMS],
}

impl Io {
    /// There are none.
    pub const NONE: Self = Self { all: &[], of: [const { 0..0 }; PROGRAMS] };

    /// Those of the host's table, if that is of the version that is known here.
    pub fn open(ports: &mut Ports) -> Option<Self> {
        // SAFETY: the host provides the pages as read-only memory at this address to a guest that has programs, and
        // fills them before the guest starts, never again; every bit pattern is a table.
        let table = unsafe { &*(IO_TABLE as *const IoTable) };
        if (table.magic, table.version) != (MAGIC, VERSION) {
            return None;
        }
        let all = table.mappings.get(..table.count as usize).unwrap_or(&[]);
        let place_of = |program: u8| all.partition_point(|m| m.program < program) as u8;
        for mapping in
            all.iter().filter(|m| matches!(m.kind, kind::FIELD | kind::VALID | kind::AGE))
        {
            ports.open_for_io(mapping.place);
        }
        let of = core::array::from_fn(|p| place_of(p as u8)..place_of(p as u8 + 1));
        Some(Self { all, of })
    }

    fn of(&self, program: u8) -> &'static [Mapping] {
        let range = self.of.get(usize::from(program)).cloned().unwrap_or(0..0);
        self.all.get(usize::from(range.start)..usize::from(range.end)).unwrap_or(&[])
    }

    /// The vector of the interrupt that releases a task, if one does.
    pub fn vector(&self, program: u8, task: u16) -> Option<u8> {
        let releases = |m: &&Mapping| {
            (m.direction, m.kind) == (EVENT, kind::INTERRUPT) && u16::from(m.task) == task
        };
        self.of(program).iter().find(releases).and_then(|m| u8::try_from(m.place).ok())
    }

    /// Reads the inputs of a job into its program's image.
    pub fn read(&self, job: Job, programs: &[Option<Program>; PROGRAMS], ports: &mut Ports) {
        let Some(process) = process(programs, job.program.into()) else { return };
        // SAFETY: the kernel's own images are seen by no program, and used in this module only from its entry to its
        // return; the outputs that are read are another area.
        let image = unsafe { process.input.slice() };
        for place in places(self.of(job.program)) {
            let mut wanted = place.iter().filter(|m| is_read_by(m, job.task)).peekable();
            let Some(first) = wanted.peek().copied() else { continue };
            match first.kind {
                kind::FIELD | kind::VALID | kind::AGE => {
                    let newest = ports.newest(first.place, cycle::now(), &job.clock);
                    wanted.for_each(|m| read_channel(m, &newest, image));
                }
                kind::PORT | kind::REGISTER => {
                    let register = read_register(first);
                    wanted.for_each(|m| read(m, &register, image));
                }
                kind::PROGRAM => {
                    let output = process_of(programs, first.place);
                    // SAFETY: as above.
                    let outputs = unsafe { output.slice() };
                    wanted.for_each(|m| read(m, outputs, image));
                }
                _ => wanted.for_each(|m| {
                    if let Some(value) = simulated(m, job.released) {
                        put(m, value, image);
                    }
                }),
            }
        }
    }

    /// Writes the outputs of a job from its program's image.
    pub fn write(&self, job: Job, process: &Process, ports: &mut Ports) {
        self.write_places(job.program, process, ports, |m| is_written_by(m, job.task));
    }

    /// A program has stopped: its outputs take the values that the partition file wants.
    pub fn stop(&self, program: u8, process: &Process, ports: &mut Ports) {
        let is_zeroed = |m: &Mapping| m.direction == OUTPUT && m.flags & flag::ZERO != 0;
        // SAFETY: as in `read`; it is not used beyond this loop.
        let image = unsafe { process.output.slice() };
        self.of(program).iter().filter(|m| is_zeroed(m)).for_each(|m| clear(m, image));
        self.write_places(program, process, ports, is_zeroed);
    }

    /// Writes each place of which a mapping is wanted, with the values of all of its mappings.
    fn write_places(
        &self,
        program: u8,
        process: &Process,
        ports: &mut Ports,
        wanted: impl Fn(&Mapping) -> bool,
    ) {
        // SAFETY: as in `read`.
        let image = unsafe { process.output.slice() };
        for place in places(self.of(program)) {
            let Some(first) = place.iter().find(|m| wanted(m)) else { continue };
            match first.kind {
                kind::FIELD => ports.write_for_io(first.place, cycle::now(), |message| {
                    place.iter().for_each(|m| write(m, image, message));
                }),
                kind::PORT | kind::REGISTER => {
                    let mut register = [0; WORD];
                    place.iter().for_each(|m| write(m, image, &mut register));
                    write_register(first, register);
                }
                _ => {}
            }
        }
    }
}

/// A job whose inputs are read or whose outputs are written.
#[derive(Clone, Copy, Debug)]
pub struct Job {
    pub program: u8,
    /// None for the initialisation.
    pub task: Option<u16>,
    pub released: Instant,
    pub clock: Clock,
}

fn process(programs: &[Option<Program>; PROGRAMS], number: u64) -> Option<&Process> {
    let program = programs.get(usize::try_from(number).ok()?)?;
    program.as_ref().map(|program| &program.process)
}

fn process_of(programs: &[Option<Program>; PROGRAMS], number: u64) -> Area {
    process(programs, number).map_or(Area::NONE, |process| process.output)
}

fn read_register(mapping: &Mapping) -> [u8; WORD] {
    let (kind, place) = (mapping.kind, mapping.place);
    let port = place as u16;
    let value = match (kind, mapping.width) {
        (kind::PORT, 1) => io::inb(port).into(),
        (kind::PORT, 2) => io::inw(port).into(),
        (kind::PORT, 4) => io::inl(port).into(),
        (kind::REGISTER, 1) => Register::<u8>::at(place).map_or(0, |r| r.read().into()),
        (kind::REGISTER, 2) => Register::<u16>::at(place).map_or(0, |r| r.read().into()),
        (kind::REGISTER, 4) => Register::<u32>::at(place).map_or(0, |r| r.read().into()),
        (kind::REGISTER, 8) => Register::<u64>::at(place).map_or(0, |r| r.read()),
        _ => 0u64,
    };
    value.to_le_bytes()
}

fn write_register(mapping: &Mapping, value: [u8; WORD]) {
    let value = u64::from_le_bytes(value);
    let (place, port) = (mapping.place, mapping.place as u16);
    match (mapping.kind, mapping.width) {
        (kind::PORT, 1) => io::outb(port, value as u8),
        (kind::PORT, 2) => io::outw(port, value as u16),
        (kind::PORT, 4) => io::outl(port, value as u32),
        (kind::REGISTER, 1) => Register::<u8>::at(place).iter().for_each(|r| r.write(value as u8)),
        (kind::REGISTER, 2) => {
            Register::<u16>::at(place).iter().for_each(|r| r.write(value as u16));
        }
        (kind::REGISTER, 4) => {
            Register::<u32>::at(place).iter().for_each(|r| r.write(value as u32));
        }
        (kind::REGISTER, 8) => Register::<u64>::at(place).iter().for_each(|r| r.write(value)),
        _ => {}
    }
}
