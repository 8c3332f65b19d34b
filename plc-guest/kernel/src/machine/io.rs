//! What the partition file maps to inputs and outputs: channels, CAN objects, registers, other programs, simulated values.
//!
//! Every read and write is one pass over the mappings of one program. There are at most 255, a message has at most 4
//! KiB, and a register that is an I/O port costs an exit, once for all of its bits. Of a CAN controller a job makes at most
//! 16 accesses before it for each frame that it may take, and 15 behind it for each that it may hand over.
//!
//! A pass that does not fit into the rest of its window stops at the window's end, and goes on when it has the processor
//! again: a more urgent task's release waits for one place at most, or for one frame of a CAN controller.

use super::PROGRAMS;
use super::memory::Area;
use super::ports::Ports;
use super::process::Process;
use super::program::Program;
use core::ops::Range;
use takt_abi::can::{self, CONTROLLERS_MAX};
use takt_abi::io::{EVENT, IoTable, Mapping, OUTPUT, flag, kind};
use takt_abi::memory::IO_TABLE;
use takt_abi::{MAGIC, VERSION};
use takt_kernel::can::Can;
use takt_kernel::process_image::{
    WORD, clear, is_read_by, is_written_by, places, put, read, read_newest, simulated, write,
};
use takt_kernel::time::{Clock, Instant};
use takt_plc_guest::console::print;
use takt_plc_guest::mmio::Register;
use takt_plc_guest::{cycle, io, pages};
use takt_sja1000::Registers;

/// Time that a frame may take behind all jobs, in ticks: 15 accesses.
const SENDING_TICKS: u64 = 80_000;

/// The mappings of all programs.
#[derive(Debug)]
pub struct Io {
    all: &'static [Mapping],
    /// Which of them belong to each program.
    of: [Range<u8>; PROGRAMS],
    can: Can<Card>,
    controllers: &'static [can::Controller],
    /// The window in which a controller took no frame behind all jobs.
    refused: [u64; CONTROLLERS_MAX],
}

impl Io {
    /// There are none.
    pub const NONE: Self = Self {
        all: &[],
        of: [const { 0..0 }; PROGRAMS],
        can: Can::NONE,
        controllers: &[],
        refused: [u64::MAX; CONTROLLERS_MAX],
    };

    /// Those of the host's table, if that is of the version that is known here. CAN controllers are started; one that
    /// does not is told, and the programs run without it.
    pub fn open(ports: &mut Ports, ticks_per_s: u64) -> Option<Self> {
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
        let mut can = Can::new(&table.objects, ticks_per_s);
        let there = table.controllers.iter().take_while(|c| c.kind != 0).count();
        let controllers = &table.controllers[..there];
        for (number, settings) in controllers.iter().enumerate() {
            if let Err(error) = can.start(number, settings, Card(*settings)) {
                print(format_args!("CAN {}: {error}", name(settings)));
            }
        }
        Some(Self { all, of, can, controllers, ..Self::NONE })
    }

    /// How many CAN controllers there are.
    pub fn controllers(&self) -> usize {
        self.controllers.len()
    }

    /// Prints how a CAN controller gets on with its bus.
    pub fn print_controller(&mut self, number: usize) {
        let Some(name) = self.controllers.get(number).map(name) else { return };
        match self.can.look(number, cycle::now()) {
            None => print(format_args!("CAN {name}: not started")),
            Some((state, f, overruns)) => print(format_args!(
                "CAN {name}: {state}, received {}, sent {}, foreign {}, short {}, replaced {}, \
                 overruns {overruns}, bus-offs {}",
                f.received, f.sent, f.foreign, f.short, f.replaced, f.bus_offs
            )),
        }
    }

    /// Hands over a frame that found a controller busy, in time that no task needs; false if there is none, or the
    /// controller has refused one in this window.
    pub fn send_waiting(&mut self, release: u64, end_tsc: u64) -> bool {
        let now = cycle::now();
        let due = |n: &usize| self.refused[*n] != release && self.can.waits(*n);
        let Some(number) = (0..self.controllers.len()).find(due) else { return false };
        if end_tsc.saturating_sub(now) < SENDING_TICKS {
            return false;
        }
        if !self.can.send_one(number, now) {
            self.refused[number] = release;
        }
        true
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

    /// Reads the inputs of a job into its program's image. False if the window has ended before that.
    pub fn read(
        &mut self,
        job: Job,
        pass: &mut Pass,
        programs: &[Option<Program>; PROGRAMS],
        ports: &mut Ports,
    ) -> bool {
        let Some(process) = process(programs, job.program.into()) else { return true };
        // SAFETY: the kernel's own images are seen by no program, and used in this module only from its entry to its
        // return; the outputs that are read are another area.
        let image = unsafe { process.input.slice() };
        let mut polled = [false; CONTROLLERS_MAX];
        for (at, place) in places(self.of(job.program)).enumerate().skip(pass.next) {
            if pass.stops_at(at) {
                return false;
            }
            let mut wanted = place.iter().filter(|m| is_read_by(m, job.task)).peekable();
            let Some(first) = wanted.peek().copied() else { continue };
            match first.kind {
                kind::FIELD | kind::VALID | kind::AGE => {
                    let newest = ports.newest(first.place, cycle::now(), &job.clock);
                    wanted.for_each(|m| read_newest(m, &newest, image));
                }
                kind::CAN | kind::CAN_AGE | kind::CAN_COUNT => {
                    let (now, number) = (cycle::now(), self.can.controller(first.place));
                    // Once in a job, however many of its objects are read.
                    if let Some(polled) = polled.get_mut(number)
                        && !core::mem::replace(polled, true)
                        && !self.can.receive(number, now, || pass.is_over())
                    {
                        return false;
                    }
                    let newest = self.can.newest(first.place, now, &job.clock);
                    wanted.for_each(|m| read_newest(m, &newest, image));
                }
                kind::PORT | kind::REGISTER => {
                    let register = read_register(first.kind, first.width, first.place);
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
        true
    }

    /// Writes the outputs of a job from its program's image. False if the window has ended before that. CAN objects that
    /// wait then are sent in time that no task needs.
    pub fn write(
        &mut self,
        job: Job,
        pass: &mut Pass,
        process: &Process,
        ports: &mut Ports,
    ) -> bool {
        let mut buses = [false; CONTROLLERS_MAX];
        let wanted = |m: &Mapping| is_written_by(m, job.task);
        let done = self.write_places(job.program, pass, process, ports, wanted, &mut buses);
        for number in (0..CONTROLLERS_MAX).filter(|number| buses[*number]) {
            self.can.send(number, cycle::now(), || pass.is_over());
        }
        done
    }

    /// A program has stopped: its outputs take the values that the partition file wants. False if the window has ended
    /// before that. CAN objects are sent in time that no task needs: this time is no task's.
    pub fn stop(
        &mut self,
        program: u8,
        pass: &mut Pass,
        process: &Process,
        ports: &mut Ports,
    ) -> bool {
        let is_zeroed = |m: &Mapping| m.direction == OUTPUT && m.flags & flag::ZERO != 0;
        // SAFETY: as in `read`; it is not used beyond this loop.
        let image = unsafe { process.output.slice() };
        self.of(program).iter().filter(|m| is_zeroed(m)).for_each(|m| clear(m, image));
        let mut buses = [false; CONTROLLERS_MAX];
        self.write_places(program, pass, process, ports, is_zeroed, &mut buses)
    }

    /// Writes each place of which a mapping is wanted, with the values of all of its mappings; CAN objects wait to be
    /// sent. Notes the controllers that have such ones.
    fn write_places(
        &mut self,
        program: u8,
        pass: &mut Pass,
        process: &Process,
        ports: &mut Ports,
        wanted: impl Fn(&Mapping) -> bool,
        buses: &mut [bool; CONTROLLERS_MAX],
    ) -> bool {
        // SAFETY: as in `read`.
        let image = unsafe { process.output.slice() };
        for (at, place) in places(self.of(program)).enumerate().skip(pass.next) {
            if pass.stops_at(at) {
                return false;
            }
            let Some(first) = place.iter().find(|m| wanted(m)) else { continue };
            match first.kind {
                kind::FIELD => ports.write_for_io(first.place, cycle::now(), |message| {
                    place.iter().for_each(|m| write(m, image, message));
                }),
                kind::CAN => {
                    self.can.put(first.place, cycle::now(), |data| {
                        place.iter().for_each(|m| write(m, image, data));
                    });
                    let number = self.can.controller(first.place);
                    buses.get_mut(number).into_iter().for_each(|bus| *bus = true);
                }
                kind::PORT | kind::REGISTER => {
                    let mut register = [0; WORD];
                    place.iter().for_each(|m| write(m, image, &mut register));
                    write_register(first.kind, first.width, first.place, register);
                }
                _ => {}
            }
        }
        true
    }
}

/// A pass over the places of a program, which ends with the window of this release.
#[derive(Clone, Copy, Debug)]
pub struct Pass {
    pub release: u64,
    /// The first place that is still to be read or written.
    pub next: usize,
}

impl Pass {
    fn is_over(&self) -> bool {
        pages::release() != self.release
    }

    /// True if it goes on at this place in another window.
    fn stops_at(&mut self, place: usize) -> bool {
        self.next = place;
        self.is_over()
    }
}

/// Where the registers of a CAN controller are.
#[derive(Debug)]
struct Card(can::Controller);

impl Card {
    fn place(&self, register: u8) -> u64 {
        self.0.place + u64::from(register) * u64::from(self.0.stride)
    }
}

impl Registers for Card {
    fn read(&mut self, register: u8) -> u8 {
        let [value, ..] = read_register(self.0.kind, 1, self.place(register));
        value
    }

    fn write(&mut self, register: u8, value: u8) {
        let value = u64::from(value).to_le_bytes();
        write_register(self.0.kind, 1, self.place(register), value);
    }
}

fn name(controller: &can::Controller) -> &str {
    let end = controller.name.iter().position(|byte| *byte == 0);
    let name = &controller.name[..end.unwrap_or(controller.name.len())];
    core::str::from_utf8(name).unwrap_or("?")
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

fn read_register(kind: u8, width: u8, place: u64) -> [u8; WORD] {
    let port = place as u16;
    let value = match (kind, width) {
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

fn write_register(kind: u8, width: u8, place: u64, value: [u8; WORD]) {
    let (value, port) = (u64::from_le_bytes(value), place as u16);
    match (kind, width) {
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
