//! A Linux program that is the worst driver that a disk or a network interface can have.
//!
//!     hostile-virtio SLOT SEED STEPS
//!
//! It takes the registers of a virtio device, by its number among them, whose own driver has to be unbound, and in
//! each step does one of what a driver may do at the wrong moment: reset it, hand it queues, write anything to any
//! register, or notify it of requests whose descriptors loop, wrap, point nowhere or into another
//! table. What the device may write to is a page of the program's own, or no memory at all, since
//! the machine is to survive, and its neighbours are what the test looks at. Nor may it write to the page of its own
//! registers, which it is told to, and which the program writes to.
//!
//! Exit status 0: all steps are done, and the registers that never change are as they were. The device is reset then, for
//! its driver.

mod memory;
mod registers;

use std::io;
use std::process::ExitCode;

use memory::{PAGE, Page};
use registers::{
    ACCEPTED, ACCEPTED_SELECT, AVAILABLE, DESCRIPTORS, NOTIFY, QUEUE_READY, QUEUE_SELECT,
    QUEUE_SIZE, STATUS, USED,
};
use takt_tests::random::Random;

/// `ACKNOWLEDGE`, `DRIVER`, `FEATURES_OK`, `DRIVER_OK`.
const STATUS_BITS: [u32; 4] = [1, 2, 8, 4];
/// Size of the queue that it asks for when it behaves.
const ENTRIES: u64 = 64;
/// Registers that no driver can change: what the device is, and its configuration.
const FIXED: [u64; 7] = [0, 4, 8, 0xc, 0x100, 0x104, 0xffc];
/// Descriptor flags.
const NEXT: u16 = 1;
const WRITE: u16 = 2;
const INDIRECT: u16 = 4;

struct Driver {
    registers: Page,
    descriptors: Page,
    available: Page,
    used: Page,
    data: Page,
    random: Random,
}

#[derive(Debug, Default)]
struct Done {
    resets: u64,
    queues: u64,
    notifications: u64,
    registers: u64,
    /// Requests that the device has said are done.
    answers: u64,
}

impl Driver {
    fn new(slot: u64, seed: u64) -> io::Result<Self> {
        Ok(Self {
            registers: Page::of_registers(slot)?,
            descriptors: Page::of_memory()?,
            available: Page::of_memory()?,
            used: Page::of_memory()?,
            data: Page::of_memory()?,
            random: Random::new(seed),
        })
    }

    fn step(&mut self, done: &mut Done) {
        match self.random.below(16) {
            0 => {
                self.reset();
                done.resets += 1;
            }
            1..=2 => {
                self.give_queue();
                done.queues += 1;
            }
            3 => {
                self.any_register();
                done.registers += 1;
            }
            _ => {
                let before = self.used.load::<u16>(2);
                self.request();
                done.notifications += 1;
                done.answers += u64::from(self.used.load::<u16>(2).wrapping_sub(before));
            }
        }
    }

    fn reset(&self) {
        self.registers.store(STATUS, 0_u32);
    }

    fn fixed(&self) -> [u32; FIXED.len()] {
        FIXED.map(|register| self.registers.load(register))
    }

    /// As section 3.1.1 wants it, but for what chance changes in one of four.
    fn give_queue(&mut self) {
        self.reset();
        let mut status = 0;
        for bit in STATUS_BITS {
            if bit == 8 {
                // All that is offered in the lower half but events, and the rest that only some devices have;
                // version 1 in the upper.
                for (select, mask) in [(0, 0x1000_0226), (1, 1)] {
                    self.registers.store(0x14, select);
                    let offered = self.registers.load::<u32>(0x10);
                    self.registers.store(ACCEPTED_SELECT, select);
                    self.registers.store(ACCEPTED, offered & mask);
                }
            }
            if bit == 4 {
                let size = if self.odd() { self.random.nasty(ENTRIES) } else { ENTRIES };
                // A network interface has two, and gets the same twice; a disk has no second.
                for queue in [0_u32, 1] {
                    self.registers.store(QUEUE_SELECT, queue);
                    self.registers.store(QUEUE_SIZE, size as u32);
                    for (register, page) in [
                        (DESCRIPTORS, self.descriptors),
                        (AVAILABLE, self.available),
                        (USED, self.used),
                    ] {
                        let at = if self.odd() { self.nowhere() } else { page.physical };
                        self.registers.store(register, at as u32);
                        self.registers.store(register + 4, (at >> 32) as u32);
                    }
                    self.registers.store(QUEUE_READY, 1_u32);
                }
            }
            status |= bit;
            self.registers.store(STATUS, status);
        }
        for page in [self.available, self.used] {
            page.store(0, 0_u32);
        }
    }

    /// Anything but the addresses of rings: at those the device would write to the kernel's memory.
    fn any_register(&mut self) {
        let width = 1 << self.random.below(4);
        let offset = self.random.below(PAGE) / width * width;
        let offset = if self.random.below(2) == 0 { offset % 0x80 } else { offset };
        let value = self.random.nasty(0);
        let is_address = (DESCRIPTORS..USED + 8).contains(&offset);
        match width {
            1 => _ = self.registers.load::<u8>(offset),
            2 if !is_address => self.registers.store(offset, value as u16),
            4 if !is_address => self.registers.store(offset, value as u32),
            _ if !is_address => self.registers.store(offset, value),
            _ => {}
        }
    }

    /// A chain that begins well, so that the device reads on, and then is whatever chance makes it.
    fn request(&mut self) {
        for number in 0..PAGE / 16 {
            self.descriptor(number);
        }
        // Read, write, flush, and what does not exist; a sector of the disk or none.
        let kind = self.random.below(6) as u32;
        let sector = if self.odd() { self.random.nasty(8) } else { self.random.below(8) };
        self.data.store(0, kind);
        self.data.store(8, sector);
        if !self.odd() {
            let length = [0, 1, 512, 2048][self.random.below(4) as usize];
            let write = if kind == 1 { 0 } else { WRITE };
            self.describe(0, self.data.physical, 16, NEXT, 1);
            self.describe(1, self.data.physical + 512, length, NEXT | write, 2);
            self.describe(2, self.data.physical + 100, 1, WRITE, 0);
        }
        let index = self.available.load::<u16>(2);
        let more = if self.odd() { self.random.nasty(1) as u16 } else { 1 };
        for slot in 0..ENTRIES {
            let head = if self.odd() { self.random.nasty(3) as u16 } else { 0 };
            self.available.store(4 + 2 * slot, head);
        }
        self.available.store(2, index.wrapping_add(more));
        let queue = if self.odd() { self.random.below(3) as u32 } else { 0 };
        self.registers.store(NOTIFY, queue);
    }

    fn descriptor(&mut self, number: u64) {
        let flags = self.random.number() as u16 & (NEXT | WRITE | INDIRECT);
        let next = self.random.below(PAGE / 16 + 2) as u16;
        let offset = self.random.below(PAGE);
        if self.odd() {
            let length = self.random.nasty(16) as u32;
            let at = self.nowhere();
            self.describe(number, at, length, flags, next);
        } else if flags & INDIRECT != 0 {
            // Into the middle of itself.
            let at = self.descriptors.physical + offset / 16 * 16;
            let length = self.random.below(PAGE) as u32;
            self.describe(number, at, length, flags, next);
        } else {
            let length = self.random.below(PAGE - offset + 1) as u32;
            self.describe(number, self.data.physical + offset, length, flags, next);
        }
    }

    fn describe(&self, number: u64, at: u64, length: u32, flags: u16, next: u16) {
        self.descriptors.store(16 * number, at);
        self.descriptors.store(16 * number + 8, length);
        self.descriptors.store(16 * number + 12, flags);
        self.descriptors.store(16 * number + 14, next);
    }

    /// An address at which there is no memory that the device may write to, or from which it wraps.
    fn nowhere(&mut self) -> u64 {
        match self.random.below(4) {
            0 => u64::MAX - self.random.below(PAGE),
            1 => 1 << (40 + self.random.below(24)),
            2 => self.registers.physical + self.random.below(PAGE),
            _ => 0xd000_0000 + self.random.below(PAGE),
        }
    }

    fn odd(&mut self) -> bool {
        self.random.below(4) == 0
    }
}

fn main() -> ExitCode {
    let arguments: Vec<u64> = std::env::args().skip(1).flat_map(|word| word.parse()).collect();
    let [slot, seed, steps] = arguments[..] else {
        eprintln!("usage: hostile-virtio SLOT SEED STEPS");
        return ExitCode::from(64);
    };
    let mut driver = match Driver::new(slot, seed) {
        Ok(driver) => driver,
        Err(error) => {
            println!("hostile-virtio: {error}");
            return ExitCode::from(70);
        }
    };
    let mut done = Done::default();
    let before = driver.fixed();
    (0..steps).for_each(|_| driver.step(&mut done));
    driver.reset();
    let after = driver.fixed();
    if after != before {
        println!("hostile-virtio: registers {before:x?} have become {after:x?}");
        return ExitCode::FAILURE;
    }
    println!("hostile-virtio: slot {slot}, seed {seed}, {done:?}");
    ExitCode::SUCCESS
}
