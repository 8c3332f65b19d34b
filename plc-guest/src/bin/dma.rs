//! A guest whose device copies memory: inside the guest's memory it has to, outside it must not.
//!
//! The device is QEMU's `edu`, whose registers are the first memory of devices and whose interrupt has
//! the vector 64. In turns it copies a buffer of the guest's to itself and from there to another
//! buffer, then tries the same with addresses that are not the guest's: the one behind its last, and
//! some at which the host's kernel is. What it "reads" there comes back to the guest, who looks
//! whether it is anything. The first guest ends itself with a copy under way.

#![no_std]
#![no_main]

use core::ptr;

use takt_abi::{memory, start};
use takt_plc_guest::console::print;
use takt_plc_guest::cycle::{self, Cycle, Program};
use takt_plc_guest::mmio::Register;
use takt_plc_guest::{entry, interrupt, pages, port};

const VECTOR: u8 = 64;
/// Registers of `edu` (QEMU's `docs/specs/edu.txt`).
const STATUS: u64 = 0x24;
const ACKNOWLEDGE: u64 = 0x64;
const SOURCE: u64 = 0x80;
const DESTINATION: u64 = 0x88;
const COUNT: u64 = 0x90;
const COMMAND: u64 = 0x98;
/// Bits of the command: go, from the device to memory, and interrupt at the end.
const RUN: u32 = 1;
const TO_MEMORY: u32 = 1 << 1;
const THEN_INTERRUPT: u32 = 1 << 2;
/// Why it interrupts when a copy has ended.
const COPIED: u32 = 0x100;
/// Where the device sees its own buffer.
const OWN_BUFFER: u32 = 0x4_0000;

const WORDS: usize = 256;
const BYTES: u32 = 4 * WORDS as u32;
/// What the device is told to write where it must not.
const FOREIGN: u32 = 0xdead_beef;
/// Behind the guest's 4 MiB; where a kernel without address randomisation lies; and further up.
const OUTSIDE: [u32; 6] = [4 << 20, 16 << 20, 20 << 20, 32 << 20, 64 << 20, 255 << 20];

const NO_REGISTER: u32 = 2;
/// Copies after which the first guest ends itself.
const FIRST_LIFE: u32 = 1;

static mut HERE: [u32; WORDS] = [0; WORDS];
static mut THERE: [u32; WORDS] = [0; WORDS];

struct Registers {
    status: Register<u32>,
    acknowledge: Register<u32>,
    source: Register<u32>,
    destination: Register<u32>,
    count: Register<u32>,
    command: Register<u32>,
}

/// What is under way.
#[derive(Clone, Copy)]
enum Step {
    /// A copy that the guest before this one has left.
    Settle,
    /// `HERE` to the device.
    Out,
    /// The device to `THERE`, which is the same then.
    Back,
    /// The device to an address outside.
    WriteOutside,
    /// An address outside to the device.
    ReadOutside,
    /// What the device has read there, to `THERE`.
    Look,
}

struct Dma {
    first: bool,
    registers: Registers,
    step: Step,
    round: u32,
    copies: u32,
    /// Rounds in which the copy was like the original, and was not.
    good: u32,
    bad: u32,
    outside: u32,
    /// Words that were something.
    leaked: u32,
    /// Interrupts for another reason.
    wrong: u32,
}

impl Dma {
    fn copy(&mut self, step: Step, source: u32, destination: u32, how: u32) {
        let Registers { source: from, destination: to, count, command, .. } = &self.registers;
        from.write(source);
        to.write(destination);
        count.write(BYTES);
        command.write(how | RUN | THEN_INTERRUPT);
        self.step = step;
        self.copies += 1;
        if self.first && self.copies > FIRST_LIFE {
            port::exit(0);
        }
    }

    fn begin(&mut self) {
        self.round += 1;
        fill(&raw mut HERE, |index| self.round << 16 | index);
        fill(&raw mut THERE, |_| 0);
        self.copy(Step::Out, address(&raw const HERE), OWN_BUFFER, 0);
    }

    fn outside(&self) -> u32 {
        OUTSIDE[self.outside as usize / 2 % OUTSIDE.len()]
    }

    fn next(&mut self) {
        match self.step {
            Step::Settle => self.begin(),
            Step::Out => {
                self.copy(Step::Back, OWN_BUFFER, address(&raw const THERE), TO_MEMORY);
            }
            Step::Back => {
                let same = (0..).zip(words(&raw const THERE));
                let same = same.into_iter().all(|(index, word)| word == self.round << 16 | index);
                self.good += u32::from(same);
                self.bad += u32::from(!same);
                self.copy(Step::WriteOutside, OWN_BUFFER, self.outside(), TO_MEMORY);
            }
            Step::WriteOutside => {
                self.outside += 1;
                self.copy(Step::ReadOutside, self.outside(), OWN_BUFFER, 0);
            }
            Step::ReadOutside => {
                self.outside += 1;
                fill(&raw mut THERE, |_| FOREIGN);
                self.copy(Step::Look, OWN_BUFFER, address(&raw const THERE), TO_MEMORY);
            }
            Step::Look => {
                // What is left of the copy inside is no secret; all else would be.
                let own = |(index, word): &(u32, u32)| *word == self.round << 16 | *index;
                let seen = (0..).zip(words(&raw const THERE)).filter(|pair| !own(pair));
                self.leaked += seen.filter(|(_, word)| *word != 0).count() as u32;
                print(format_args!(
                    "good {}, bad {}, outside {}, leaked {}, wrong {}",
                    self.good, self.bad, self.outside, self.leaked, self.wrong,
                ));
                self.begin();
            }
        }
    }
}

impl Program for Dma {
    fn scan(&mut self, _: &Cycle) {
        let taken = interrupt::taken(VECTOR);
        if matches!(self.step, Step::Settle) {
            if self.registers.command.read() & RUN == 0 {
                self.registers.acknowledge.write(self.registers.status.read());
                interrupt::arm(VECTOR);
                self.next();
            }
        } else if taken {
            self.wrong += u32::from(self.registers.status.read() != COPIED);
            self.registers.acknowledge.write(COPIED);
            interrupt::arm(VECTOR);
            self.next();
        }
    }
}

/// Where the device sees it: memory is mapped one to one.
fn address(buffer: *const [u32; WORDS]) -> u32 {
    buffer as usize as u32
}

fn fill(buffer: *mut [u32; WORDS], word: impl Fn(u32) -> u32) {
    for (index, place) in (0..).zip(0..WORDS) {
        // SAFETY: inside the array; volatile, since the device reads and writes it too.
        unsafe { ptr::write_volatile(buffer.cast::<u32>().add(place), word(index)) };
    }
}

fn words(buffer: *const [u32; WORDS]) -> impl Iterator<Item = u32> {
    // SAFETY: as for `fill`.
    (0..WORDS).map(move |place| unsafe { ptr::read_volatile(buffer.cast::<u32>().add(place)) })
}

fn main() -> ! {
    let register = |offset| match Register::<u32>::at(memory::DEVICES + offset) {
        Some(register) => register,
        None => port::exit(NO_REGISTER),
    };
    cycle::run(Dma {
        first: pages::information().start_condition == start::NORMAL,
        registers: Registers {
            status: register(STATUS),
            acknowledge: register(ACKNOWLEDGE),
            source: register(SOURCE),
            destination: register(DESTINATION),
            count: register(COUNT),
            command: register(COMMAND),
        },
        step: Step::Settle,
        round: 0,
        copies: 0,
        good: 0,
        bad: 0,
        outside: 0,
        leaked: 0,
        wrong: 0,
    })
}

entry!(main);
